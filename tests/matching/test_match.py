"""A match: its arrays from their pieces, on disk, inverted, composed, and as matrices."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import scipy.io
import torch
from dirty_shapes import dirtied

from homolog.core.errors import ArgumentError, DataError
from homolog.geometry import OperatorSettings, compute_operators
from homolog.maps import confidence, overlap
from homolog.matching import Match, align_parts, read_point_map, refine, smoothed
from homolog.matching.inputs import options_of
from homolog.pairs import PairOptions
from homolog.shapes import Shape, repair

ARRAYS = ("source_to_target", "target_to_source", "source_confidence", "target_confidence")


def assert_same(found: Match, expected: Match) -> None:
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


# ---- from the pieces


def as_given(indices, trust, own, other):
    """A map between clean points in the indices of the files: first of equal points, -1 for points left out."""
    first = {}
    for point, clean in enumerate(other.clean_index):
        first.setdefault(int(clean), point)
    there = np.array([first[int(end)] if end >= 0 else -1 for end in indices])
    kept = own.clean_index >= 0
    return np.where(kept, there[own.clean_index], -1), np.where(kept, trust[own.clean_index], 0.0)


def upper(shape):
    """What of a shape lies above a plane."""
    faces = shape.faces[(shape.points[shape.faces, 1] > -0.5).all(axis=1)]
    return repair(Shape(shape.points, faces)).shape


@pytest.mark.parametrize("partial", [None, "source", "target"])
@pytest.mark.parametrize("method", ["functional-map", "nearest-features"])
def test_all_arrays_are_those_of_the_pieces(build, blobs, method, partial):
    """Repairs on both sides; each confidence belongs to the map whose length it has."""
    shapes = {"source": blobs.source, "target": blobs.target}
    if partial is not None:
        shapes[partial] = upper(shapes[partial])
    source, target = map(dirtied, shapes.values())
    matcher = build(method)
    options = PairOptions(partial=partial)
    found = matcher.match(source.shape, target.shape, options)

    pair, _ = matcher.pair(source.shape, target.shape, options)
    assert (pair.x is pair.source) == (partial != "source")
    pair = align_parts(pair)
    refined = pair.maps or refine(pair, matcher.method_of("mesh", "mesh")(pair))
    maps = smoothed(pair, refined)
    at_x, at_y = pair.x.operators.points, pair.y.operators.points
    x_to_y, y_to_x = maps.x_to_y.clone(), maps.y_to_x
    x_trust = confidence(at_x, at_y, refined.x_to_y, refined.y_to_x).numpy()
    y_trust = confidence(at_y, at_x, refined.y_to_x, refined.x_to_y).numpy()
    if partial is not None:
        seen = overlap(pair.x.operators, pair.y.operators, y_to_x).numpy()
        x_to_y[~torch.from_numpy(seen)] = -1
        x_trust = x_trust * seen
        assert 0 < seen.sum() < len(seen)
    of_x = as_given(x_to_y.numpy(), x_trust, *((source, target) if pair.x is pair.source else (target, source)))
    of_y = as_given(y_to_x.numpy(), y_trust, *((target, source) if pair.x is pair.source else (source, target)))
    expected = dict(zip((pair.x is pair.source, pair.y is pair.source), (of_x, of_y), strict=True))
    for side, (indices, trust) in (("source", expected[True]), ("target", expected[False])):
        other = "target" if side == "source" else "source"
        np.testing.assert_array_equal(getattr(found, f"{side}_to_{other}"), indices)
        np.testing.assert_allclose(getattr(found, f"{side}_confidence"), trust, rtol=1e-6)
    assert found.source is source.shape and found.target is target.shape


# ---- what is given


@pytest.fixture
def given(make) -> Match:
    """Random maps between a mesh of 162 points and a cloud of 42; some points have no counterpart."""
    rng = np.random.default_rng(1)
    source = Shape(make.blob(2).points, make.blob(2).faces, name="mesh.off")
    target = Shape(make.sphere(1).points, name="cloud.xyz")
    forth, back = rng.integers(-1, 42, 162), rng.integers(-1, 162, 42)
    forth[[0, 9]], back[[0, 5]] = -1, -1
    trust = [np.where(indices < 0, 0, rng.random(len(indices))) for indices in (forth, back)]
    return Match(source, target, forth, back, *trust, method="by hand", warnings=("look!",), report={"answer": 42})


def test_confidences_are_one_where_there_is_a_counterpart_by_default(given):
    found = Match(given.source, given.target, given.source_to_target, given.target_to_source)
    np.testing.assert_array_equal(found.source_confidence, (given.source_to_target >= 0).astype(float))
    np.testing.assert_array_equal(found.target_confidence, (given.target_to_source >= 0).astype(float))
    assert found.method == "given" and found.quality is None and found.warnings == ()


def test_maps_may_be_tensors_or_lists(given):
    found = Match(given.source, given.target, torch.from_numpy(given.source_to_target), given.target_to_source.tolist())
    assert found.source_to_target.dtype == found.target_to_source.dtype == np.int64
    np.testing.assert_array_equal(found.target_to_source, given.target_to_source)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"source_to_target": np.zeros(5, int)}, r"source_to_target has shape \(5,\), but must .* \(162,\)"),
        ({"target_to_source": np.zeros(42)}, "target_to_source holds float64, but must hold whole numbers"),
        ({"target_to_source": np.full(42, 162)}, "holds 162, but must hold indices of the other shape, 0 to 161"),
        ({"target_to_source": np.full(42, -2)}, "holds -2, but must"),
        ({"source_to_target": np.full(162, 42)}, "holds 42, but must hold indices of the other shape, 0 to 41"),
        ({"target_confidence": np.zeros(162)}, r"target_confidence has shape \(162,\), but must .* \(42,\)"),
        ({"source_confidence": np.full(162, 7)}, "source_confidence holds 7, but must hold numbers from 0 to 1"),
        ({"target_confidence": np.full(42, -0.5)}, "target_confidence holds -0.5, but must hold numbers from 0 to 1"),
        ({"target_confidence": [np.nan] * 42}, "target_confidence holds nan, but must hold numbers from 0 to 1"),
        ({"target_confidence": ["much"] * 42}, "target_confidence holds <U4, but must hold numbers from 0 to 1"),
    ],
)
def test_arrays_that_do_not_fit_are_one_line(given, changes, said):
    arrays = {name: getattr(given, name) for name in ARRAYS}
    with pytest.raises(ArgumentError, match=said) as caught:
        Match(given.source, given.target, **{**arrays, **changes})
    assert "\n" not in str(caught.value)


def test_confidences_may_be_tensors_or_whole_numbers(given, tmp_path):
    trust = torch.rand(162, requires_grad=True), np.ones(42, int)
    found = Match(given.source, given.target, given.source_to_target, given.target_to_source, *trust)
    assert found.source_confidence.dtype == np.float32 and found.target_confidence.dtype == float
    found.save(tmp_path)
    assert_same(Match.load(tmp_path), found)


# ---- on disk


def test_a_folder_goes_round(given, tmp_path):
    paths = given.save(tmp_path / "result")
    assert [path.name for path in paths] == ["correspondence.npz", "source.ply", "target.ply", "report.json"]
    found = Match.load(tmp_path / "result")
    assert_same(found, given)
    assert (found.method, found.warnings, found.report["answer"]) == ("by hand", ("look!",), 42)
    np.testing.assert_array_equal(found.source.points, given.source.points)
    np.testing.assert_array_equal(found.source.faces, given.source.faces)
    assert found.target.faces is None
    again = found.save(tmp_path / "again")
    for one, other in zip(paths, again, strict=True):
        assert one.read_bytes() == other.read_bytes()


@pytest.mark.parametrize("partial", [None, "source"])
def test_figures_of_quality_go_round(build, blobs, tmp_path, partial):
    """Also where no report has them."""
    found = build("nearest-features").match(blobs.source, blobs.target, partial=partial)
    for number, each in enumerate((found, found.inverse(), replace(found, report={}))):
        each.save(tmp_path / str(number))
        assert Match.load(tmp_path / str(number)).quality == each.quality is not None


@pytest.mark.parametrize("suffix", [".mat", ".npz"])
def test_one_map_under_the_name_that_another_program_reads(given, tmp_path, suffix):
    (path,) = given.save(tmp_path / f"map{suffix}", name="p2p", base=1)
    stored = np.load(path) if suffix == ".npz" else scipy.io.loadmat(path)
    assert [name for name in stored if not name.startswith("__")] == ["p2p"]
    np.testing.assert_array_equal(np.ravel(stored["p2p"]), given.target_to_source + 1)
    with pytest.raises(ArgumentError, match=r"a word that a \.mat or \.npz calls its map"):
        given.save(tmp_path / "map.vts", name="p2p")


@pytest.mark.parametrize("words", [{"base": 1}, {"base": 0}, {"direction": "source_to_target"}])
def test_a_folder_has_neither_base_nor_direction(given, tmp_path, words):
    with pytest.raises(ArgumentError, match=r"base, direction and name are for files .*result is a folder"):
        given.save(tmp_path / "result", **words)
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("readers_here")
@pytest.mark.parametrize("direction", ["target_to_source", "source_to_target"])
@pytest.mark.parametrize("base", [None, 0, 1])
@pytest.mark.parametrize("suffix", [".txt", ".vts", ".map", ".mat", ".npz"])
def test_files_go_round_in_both_bases(given, tmp_path, suffix, base, direction):
    path = tmp_path / f"map{suffix}"
    assert given.save(path, base=base, direction=direction) == [path]
    expected = getattr(given, direction)
    np.testing.assert_array_equal(read_point_map(path, base=base, direction=direction), expected)
    first = {".txt": 0, ".npz": 0, ".vts": 1, ".map": 1, ".mat": 1}[suffix] if base is None else base
    # As other programs read them.
    if suffix in (".txt", ".vts", ".map"):
        stored = np.array([int(line) for line in path.read_text().split()])
    elif suffix == ".mat":
        stored = scipy.io.loadmat(path)[direction]
        assert stored.shape == (len(expected), 1)
        np.testing.assert_array_equal(read_point_map(path, direction=direction), expected)  # it says its base itself
        stored = stored[:, 0]
    else:
        with np.load(path) as arrays:
            stored = arrays[direction]
            np.testing.assert_array_equal(arrays["target_confidence"], given.target_confidence)
    np.testing.assert_array_equal(stored, expected + first)
    assert stored.min() == first - 1  # a point without a counterpart


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            {"path": "map.csv"},
            "the suffix '.csv', but a point map must have one of .npz, .mat, .txt, .vts, .map; without",
        ),
        ({"path": "map.txt", "base": 2}, "base is 2, but must be the first index, 0 or 1"),
        ({"path": "map.txt", "direction": "forth"}, "direction is 'forth', but must be one of"),
    ],
)
def test_files_that_cannot_be(given, tmp_path, options, said):
    path = tmp_path / options.pop("path")
    with pytest.raises(ArgumentError) as caught:
        given.save(path, **options)
    assert said in str(caught.value) and "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "text", ["1.5\n2\n", "one\n", "1 2\n3 4\n", "", "inf\n1\n", "nan\n", "1e300\n", "99999999999999999999\n"]
)
def test_files_that_are_no_maps_are_one_line(tmp_path, text):
    (tmp_path / "map.txt").write_text(text)
    with pytest.raises(DataError, match=r"map\.txt") as caught:
        read_point_map(tmp_path / "map.txt")
    assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("readers_here")
@pytest.mark.parametrize("suffix", [".mat", ".npz"])
def test_files_that_are_damaged_are_one_line(given, tmp_path, suffix):
    """Cut off anywhere, and of no content."""
    path = tmp_path / f"map{suffix}"
    given.save(path)
    whole = path.read_bytes()
    spoilt = [whole[: len(whole) * part // 8] for part in range(8)]
    for content in (*spoilt, bytes(len(whole))):
        path.write_bytes(content)
        with pytest.raises(DataError, match=rf"map\{suffix}") as caught:
            read_point_map(path)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", [".mat", ".npz"])
def test_bytes_that_cannot_be_unpacked_are_one_line(given, tmp_path, suffix):
    """Wherever they stand; or they are in an array that is not asked for, and the map is right."""
    path = tmp_path / f"map{suffix}"
    given.save(path)
    whole, expected, n_refused = path.read_bytes(), read_point_map(path), 0
    for start in range(len(whole) // 10, len(whole) - 40, len(whole) // 10):
        path.write_bytes(whole[:start] + b"\xff" * 40 + whole[start + 40 :])
        try:
            np.testing.assert_array_equal(read_point_map(path), expected)
        except DataError as error:
            assert path.name in str(error) and "\n" not in str(error)
            n_refused += 1
    assert n_refused


def test_a_result_whose_arrays_cannot_be_unpacked_is_one_line(given, tmp_path):
    given.save(tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    (tmp_path / "report.json").write_text(json.dumps({**report, "sha256": {}}))
    path = tmp_path / "correspondence.npz"
    whole = path.read_bytes()
    path.write_bytes(whole[:60] + b"\xff" * 40 + whole[100:])
    with pytest.raises(DataError, match="cannot be read as the arrays of a match"):
        Match.load(tmp_path)


@pytest.mark.usefixtures("readers_here")
@pytest.mark.parametrize("values", [np.full(3, 2**63, np.uint64), np.array([np.inf, 1, 2]), np.array([1e300, 1, 2])])
@pytest.mark.parametrize("suffix", [".mat", ".npz"])
def test_numbers_that_are_no_indices_are_named(tmp_path, suffix, values):
    write = np.savez if suffix == ".npz" else lambda path, **arrays: scipy.io.savemat(path, arrays)
    write(tmp_path / f"map{suffix}", target_to_source=values)
    with pytest.raises(DataError, match=r"holds (inf|9223372036854775808|1e\+300), but must hold one whole number"):
        read_point_map(tmp_path / f"map{suffix}")


@pytest.mark.usefixtures("readers_here")
@pytest.mark.parametrize("suffix", [".txt", ".vts", ".mat", ".npz"])
def test_maps_of_one_point_are_read(make, tmp_path, suffix):
    few = Shape(make.sphere(0).points[:1], name="point")
    path = tmp_path / f"map{suffix}"
    Match(make.sphere(0), few, np.zeros(12, int), [5]).save(path)
    assert read_point_map(path).tolist() == [5]
    assert read_point_map(path, direction="target_to_source").shape == (1,)


@pytest.mark.usefixtures("readers_here")
def test_a_number_beside_a_map_is_not_taken_for_it(tmp_path):
    scipy.io.savemat(tmp_path / "map.mat", {"matches": np.array([3, 1, 2]), "scale": 2.0})
    assert read_point_map(tmp_path / "map.mat").tolist() == [2, 0, 1]
    scipy.io.savemat(tmp_path / "map.mat", {"matches": np.array([3])})
    assert read_point_map(tmp_path / "map.mat").tolist() == [2]


# ---- what can be made of it


def test_the_inverse_of_the_inverse_is_the_same(given):
    inverse = given.inverse()
    assert (inverse.source, inverse.target) == (given.target, given.source)
    np.testing.assert_array_equal(inverse.source_to_target, given.target_to_source)
    np.testing.assert_array_equal(inverse.source_confidence, given.target_confidence)
    again = inverse.inverse()
    assert again.source is given.source and again.target is given.target
    assert_same(again, given)
    assert (again.method, again.warnings, again.report) == (given.method, given.warnings, given.report)


def test_the_report_of_the_inverse_speaks_of_the_other_sides(build, blobs, tmp_path):
    source, target = Shape(blobs.source.points, blobs.source.faces, name="source.off"), blobs.target
    matcher = build("nearest-features")
    plain = matcher.match(source, target, partial="source", as_cloud="target", source_up="z")
    plain = replace(plain, warnings=("the source seems turned against the target: give the source's up axis",))
    plain.inverse().save(tmp_path)
    found = Match.load(tmp_path)
    options = found.report["options"]
    assert (options["partial"], options["as_cloud"]) == ("target", "source")
    assert (options["source_up"], options["target_up"]) == ("y", "z")
    assert [found.report["inputs"][side]["name"] for side in ("source", "target")] == ["target", "source.off"]
    assert found.report["quality"] == {"source": None, "target": plain.report["quality"]["source"]}
    matched = {f"{side}_{name}": n for side in ("source", "target") for name, n in found.matched(side).items()}
    assert found.report["matched"] == matched
    assert found.warnings == ("the target seems turned against the source: give the target's up axis",)
    steps = [[step["name"] for step in one.report["timings"]] for one in (plain, found)]
    assert steps[0].index("repair target") == steps[1].index("repair source")
    again = plain.inverse().inverse()
    assert (again.report, again.warnings) == (plain.report, plain.warnings)


def identity(shape: Shape) -> Match:
    everything = np.arange(shape.n_points)
    return Match(shape, shape, everything, everything)


def test_composing_with_the_identity_changes_nothing(given):
    assert_same(given.compose(identity(given.target)), given)
    assert_same(identity(given.source).compose(given), given)


def test_composed_maps_go_by_way_of_the_shape_between(given, make):
    rng = np.random.default_rng(2)
    third = Shape(make.grid(5).points, name="grid")
    other = Match(given.target, third, rng.integers(-1, 25, 42), rng.integers(-1, 42, 25), rng.random(42))
    found = given.compose(other)
    assert found.source is given.source and found.target is third
    for point, between in enumerate(given.source_to_target):
        end = -1 if between < 0 else other.source_to_target[between]
        assert found.source_to_target[point] == end
        trust = given.source_confidence[point] * other.source_confidence[between] if end >= 0 else 0
        assert found.source_confidence[point] == pytest.approx(trust)
    for point, between in enumerate(other.target_to_source):
        assert found.target_to_source[point] == (-1 if between < 0 else given.target_to_source[between])
    with pytest.raises(ArgumentError, match="the other match begins at grid with 25 points, but must begin at cloud"):
        given.compose(identity(third))
    with pytest.raises(ArgumentError, match=r"other is a str, but must be a Match; make one with homolog\.match"):
        given.compose("result")


def test_a_matrix_takes_functions_to_the_target(given):
    matrix = given.to_matrix()
    assert matrix.shape == (42, 162)
    values = np.random.default_rng(0).random((162, 2))
    expected = np.where(given.target_to_source[:, None] < 0, 0, values[given.target_to_source])
    np.testing.assert_array_equal(matrix @ values, expected)


def test_the_functional_map_of_the_identity_is_the_identity(make):
    blob = make.blob(3)
    np.testing.assert_allclose(identity(blob).functional_map(30), np.eye(30), atol=1e-3)


def test_the_functional_map_takes_coefficients_from_source_to_target(make):
    """To a relabelled copy in need of repair, some of whose points have no counterpart."""
    blob = make.blob(3)
    order = np.random.default_rng(0).permutation(blob.n_points)
    copy = make.relabelled(blob, order)
    dirty = Shape(np.concatenate([copy.points, [[np.nan] * 3]]), copy.faces)
    back = np.append(order, -1)
    back[np.random.default_rng(1).permutation(blob.n_points)[:20]] = -1
    found = Match(blob, dirty, np.full(blob.n_points, -1), back).functional_map(12)
    wanted = OperatorSettings(n_eigenpairs=12)
    source, target = (compute_operators(repair(shape).shape, settings=wanted) for shape in (blob, dirty))
    heights = torch.tensor(blob.points[:, 1:2], dtype=torch.float32)
    carried = target.eigenvectors.double() @ torch.from_numpy(found) @ source.coefficients(heights).double()
    smooth = source.eigenvectors @ source.coefficients(heights)
    np.testing.assert_allclose(carried.numpy(), smooth.numpy()[order], atol=0.02 * float(smooth.std()))


def test_its_repr_is_short_and_says_what_it_is(given, build, blobs):
    assert repr(given).count("\n") < 5 and len(repr(given)) < 500
    assert "'mesh.off' -> 'cloud.xyz' by by hand" in repr(given) and "1 warning" in repr(given)
    for each in (build().match(blobs.source, blobs.target), *build().pair(blobs.source, blobs.target)[:1]):
        assert repr(each).count("\n") < 5
        assert "array(" not in repr(each) and "tensor(" not in repr(each)


@pytest.mark.usefixtures("readers_here")
@pytest.mark.parametrize("base", [7, -1, "a", 1.0, True, None])
@pytest.mark.parametrize("suffix", [".txt", ".vts", ".mat", ".npz"])
def test_the_first_index_is_checked_as_a_map_is_read(given, tmp_path, suffix, base):
    given.save(tmp_path / f"map{suffix}")
    if base is None:
        np.testing.assert_array_equal(read_point_map(tmp_path / f"map{suffix}", base=base), given.target_to_source)
        return
    with pytest.raises(ArgumentError, match=f"base is {base!r}, but must be the first index, 0 or 1"):
        read_point_map(tmp_path / f"map{suffix}", base=base)
    with pytest.raises(ArgumentError, match="direction is 'back', but must be one of target_to_source, source_to_"):
        read_point_map(tmp_path / f"map{suffix}", direction="back")
    expected = given.target_to_source
    usual = {".txt": 0, ".vts": 1, ".mat": 1, ".npz": 0}[suffix]
    np.testing.assert_array_equal(read_point_map(tmp_path / f"map{suffix}", base=np.int64(usual)), expected)


@pytest.mark.usefixtures("readers_here")
@pytest.mark.parametrize("base", [0, 1])
@pytest.mark.parametrize("suffix", [".mat", ".npz"])
def test_files_of_arrays_say_from_which_index_they_count(given, tmp_path, suffix, base):
    given.save(tmp_path / f"map{suffix}", base=base)
    for direction in ("target_to_source", "source_to_target"):
        found = read_point_map(tmp_path / f"map{suffix}", direction=direction)
        np.testing.assert_array_equal(found, getattr(given, direction))


def test_a_map_of_several_lengths_is_named(make):
    blob = make.blob(0)
    with pytest.raises(ArgumentError, match=r"^source_to_target is a list that is no array, but must be one map"):
        Match(blob, blob, [[1, 2], [3]], np.arange(12))


@pytest.mark.parametrize("text", ["-2\n0\n", "3\n-7\n"])
def test_numbers_below_none_are_no_indices(tmp_path, text):
    (tmp_path / "map.txt").write_text(text)
    with pytest.raises(DataError, match=r"map.txt holds -\d, but must hold indices from 0, or -1 for none$"):
        read_point_map(tmp_path / "map.txt")


@pytest.mark.parametrize("name", ["o.tsv", "o.npy", "result.v2"])
def test_a_suffix_that_is_not_known_is_told_with_those_that_are(given, tmp_path, name):
    said = rf"{name} has the suffix '\.\w+', but a point map must have one of .npz, .mat, .txt, .vts, .map; without"
    with pytest.raises(ArgumentError, match=said):
        given.save(tmp_path / name)


def test_a_folder_that_is_not_there_is_told(tmp_path):
    with pytest.raises(DataError, match=f"there is no folder {tmp_path / 'nope'}; give a folder that homolog match"):
        Match.load(tmp_path / "nope")
    (tmp_path / "file").touch()
    with pytest.raises(DataError, match="file is a file; give a folder"):
        Match.load(tmp_path / "file")
    for path in ("", None, 3):
        with pytest.raises(ArgumentError, match=f"path is {path!r}, but must be a path"):
            Match.load(path)


def test_the_functional_map_has_the_size_asked_for_or_none(make, monkeypatch):
    """No more than there are eigenfunctions on either shape, or points with a counterpart."""
    blob, few = make.blob(3), make.blob(0)
    for call, said in (
        (lambda: identity(few).functional_map(13), "k is 13, but the source, blob, has 12 points once repaired; give"),
        (lambda: Match(blob, few, np.zeros(642, int), np.arange(12)).functional_map(20), "but the target, blob, has"),
        (lambda: identity(blob).functional_map(0), "k is 0, but must be a whole number of at least 1"),
        (lambda: identity(blob).functional_map(2.5), "k is 2.5, but must be a whole number"),
        (
            lambda: Match(blob, blob, np.full(642, -1), np.where(np.arange(642) < 9, 5, -1)).functional_map(10),
            "k is 10, but only 9 points of the target, blob, have a counterpart",
        ),
    ):
        with pytest.raises(ArgumentError, match=said):
            call()
    with monkeypatch.context() as patch:
        patch.setattr("homolog.matching.result.compute_operators", None)  # it would take long for so many
        with pytest.raises(ArgumentError, match="k is 10000, but the source, blob, has 642 points"):
            identity(blob).functional_map(10_000)
    n = few.n_points
    largest = max(k for k in range(1, n) if compute_operators(few, settings=OperatorSettings(k)).n_eigenpairs == k)
    assert identity(few).functional_map(largest).shape == (largest, largest)
    assert identity(blob).functional_map(np.int64(7)).shape == (7, 7)


def test_composed_matches_keep_the_names_of_their_shapes(given, build, blobs, tmp_path):
    there = build().match(blobs.source, blobs.target)
    for match, names in (
        (there.compose(there.inverse()), ["source", "source"]),
        (identity(given.source).compose(given), ["mesh.off", "cloud.xyz"]),
        (given, ["mesh.off", "cloud.xyz"]),
    ):
        match.save(tmp_path)
        loaded = Match.load(tmp_path)
        assert [loaded.source.name, loaded.target.name] == names
        assert loaded.matched("source")["points_left_out"] == match.matched("source")["points_left_out"]


TEXTS = {
    "the source seems to be a mirror image; say so by mirror='source'": "the target seems to be a mirror image; say so "
    "by mirror='target'",
    "give source_up='z' or --target-up z": "give target_up='z' or --source-up z",
    "source_to_target is not target_confidence": "target_to_source is not source_confidence",
    "the source's area (target) is less.": "the target's area (source) is less.",
    "source.ply and /data/source/target.ply differ": None,
    r"C:\source\a.off lies apart": None,
    "weights 'source net' and \"the target\" are old": None,
    "my-source and source-2 are names": None,
    "resources are targeted": None,
    "the target of source scan is off": "the source of source scan is off",
}


@pytest.mark.parametrize("text", TEXTS)
def test_only_the_sides_are_exchanged_in_warnings(given, text):
    named = replace(given, source=replace(given.source, name="source scan"), warnings=(text,))
    (found,) = named.inverse().warnings
    assert found == (TEXTS[text] or text)
    assert named.inverse().inverse().warnings == (text,)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"source": "a.off"}, "source is a str, but must be a Shape"),
        ({"target": None}, "target is None, but must be a Shape"),
        ({"warnings": "look!"}, "warnings is 'look!', but must be a list of texts"),
        ({"report": []}, r"report is \[\], but must be a table"),
    ],
)
def test_what_makes_no_match_is_one_line(given, changes, said):
    with pytest.raises(ArgumentError, match=said):
        replace(given, **changes)
    with pytest.raises(ArgumentError, match="side is 'both', but must be one of source, target"):
        given.matched("both")


@pytest.mark.parametrize(
    ("word", "said"),
    [("partail", "; did you mean 'partial'?"), ("sourc_up", "; did you mean 'source_up'?"), ("q", "target_mask")],
)
def test_options_that_do_not_exist_are_named_with_the_nearest(word, said):
    with pytest.raises(ArgumentError) as caught:
        options_of(None, {word: "source"})
    assert f"an option is {word!r}, but must be one of as_cloud, partial" in str(caught.value)
    assert str(caught.value).endswith(said)


def test_the_inverse_of_two_parts_is_moved_the_other_way(tetrahedra):
    source, target = tetrahedra
    turn = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    landmarks = {"source": [0, 1], "target": [2, 3], "names": ["source of pain", "left target"], "axes": ["LPS", None]}
    options = {"partial": "both", "partial_scale": 0.001, "landmarks": landmarks, "source_up": "z", "target_up": "y"}
    report = {"options": options, "alignment": {"rotation": turn, "degrees": 90.0, "scale": 4.0}}
    match = Match(source, target, [0, 1, 2, 3], [3, 2, 1, 0], report=report)
    found = match.inverse().report
    assert found["alignment"] == {"rotation": np.transpose(turn).tolist(), "degrees": 90.0, "scale": 0.25}
    assert found["options"]["partial_scale"] == pytest.approx(1000)
    assert (found["options"]["source_up"], found["options"]["target_up"]) == ("y", "z")
    assert found["options"]["landmarks"] == {
        "source": [2, 3],
        "target": [0, 1],
        "names": ["source of pain", "left target"],
        "axes": [None, "LPS"],
    }
    assert match.inverse().inverse().report["alignment"] == report["alignment"]
    assert match.report == report


@pytest.fixture
def tetrahedra():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    return Shape(points, faces, name="one"), Shape(2 * points, faces, name="two")
