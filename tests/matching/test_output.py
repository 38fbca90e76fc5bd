"""What a match leaves on disk."""

import hashlib
import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import meshio
import numpy as np
import pytest
import trimesh

from homolog.core.errors import ArgumentError, DataError
from homolog.core.progress import Timings
from homolog.core.versions import versions
from homolog.matching import Match, matched_colours, position_colours, read_point_map, write_folder
from homolog.shapes import Shape, read_shape
from homolog.shapes.formats import formats
from homolog.transfer.inputs import read_original

NAMES = ["correspondence.npz", "source.ply", "target.ply", "report.json"]
GREY = [160, 160, 160]
INPUTS = {"source": {"name": "sphere"}, "target": {"name": "cloud"}}
REPORT = {"answer": 42, "inputs": INPUTS, "method": "nearest-features", "warnings": ["look!"]}
WRITTEN = {**REPORT, "versions": versions()}


@pytest.fixture
def shapes(make):
    """A sphere of 162 points and a cloud of 42, one of whose points is nowhere."""
    points = make.sphere(1).points * [3, 1, 2] + 0.1
    points[7] = np.nan
    return make.sphere(2), Shape(points, name="cloud")


@pytest.fixture
def found(shapes):
    rng = np.random.default_rng(0)
    n, m = (shape.n_points for shape in shapes)
    forth, back = rng.integers(0, m, n), rng.integers(0, n, m)
    forth[[3, 100]], back[7] = -1, -1
    return Match(
        *shapes,
        forth,
        back,
        np.where(forth < 0, 0, rng.random(n)),
        np.where(back < 0, 0, rng.random(m)),
        "nearest-features",
        ("look!",),
        report={"answer": 42},
    )


def colours_in(path):
    """Vertex colours of a binary PLY, read by hand."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    lines = head.decode().splitlines()
    n = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    vertex = lines[lines.index(f"element vertex {n}") + 1 :]
    assert [line.split()[2] for line in vertex[:6]] == ["x", "y", "z", "red", "green", "blue"]
    rows = np.frombuffer(body, np.dtype([("xyz", "<f8", 3), ("rgb", "u1", 3)]), count=n)
    return rows["rgb"].astype(int)


def test_saved_arrays(found, tmp_path):
    found.save(tmp_path / "maps.npz")
    with np.load(tmp_path / "maps.npz", allow_pickle=False) as stored:
        assert sorted(stored.files) == [
            "source_confidence",
            "source_to_target",
            "target_confidence",
            "target_to_source",
        ]
        for name in stored.files:
            np.testing.assert_array_equal(stored[name], getattr(found, name))
        assert stored["source_to_target"].dtype == stored["target_to_source"].dtype == np.int64
        assert stored["source_confidence"].dtype.kind == stored["target_confidence"].dtype.kind == "f"
    assert [path.name for path in tmp_path.iterdir()] == ["maps.npz"]


def test_a_real_match_saves_its_own_arrays(build, blobs, tmp_path):
    found = build("nearest-features").match(*blobs.of("mc"))
    found.save(tmp_path / "maps.npz")
    with np.load(tmp_path / "maps.npz") as stored:
        np.testing.assert_array_equal(stored["source_to_target"], found.source_to_target)
        assert stored["target_to_source"].shape == (blobs.target.n_points,)


def test_the_four_files(shapes, found, tmp_path):
    folder = tmp_path / "new" / "result"
    paths = write_folder(folder, found)
    assert paths == [folder / name for name in NAMES]
    assert sorted(path.name for path in folder.iterdir()) == sorted(NAMES)
    for path, given in zip(paths[1:3], shapes, strict=True):
        written = read_shape(path)
        finite = np.isfinite(given.points).all(axis=1)
        np.testing.assert_array_equal(written.points[finite], given.points[finite])
        assert written.modality == given.modality
        if given.faces is not None:
            np.testing.assert_array_equal(written.faces, given.faces)
    hashes = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in paths[:3]}
    assert json.loads(paths[3].read_text()) == {**WRITTEN, "sha256": hashes}


def test_a_result_is_read_back(shapes, found, tmp_path):
    assert found.save(tmp_path) == [tmp_path / name for name in NAMES]
    result = Match.load(tmp_path)
    assert result.report == WRITTEN
    assert (result.method, result.warnings) == ("nearest-features", ("look!",))
    for name in ("source_to_target", "target_to_source", "source_confidence", "target_confidence"):
        np.testing.assert_array_equal(getattr(result, name), getattr(found, name))
    finite = np.isfinite(shapes[1].points).all(axis=1)
    np.testing.assert_array_equal(result.target.points[finite], shapes[1].points[finite])
    np.testing.assert_array_equal(result.source.faces, shapes[0].faces)


@pytest.mark.parametrize("name", NAMES)
def test_a_folder_that_lacks_a_file_is_no_result(shapes, found, tmp_path, name):
    write_folder(tmp_path, found)
    (tmp_path / name).unlink()
    with pytest.raises(DataError, match=f"has no {name}, so that it is no result"):
        Match.load(tmp_path)


def without_hashes(folder):
    """A result of whose files the report says nothing, so that these themselves are looked at."""
    report = json.loads((folder / "report.json").read_text())
    del report["sha256"]
    (folder / "report.json").write_text(json.dumps(report))


def change_maps(folder, **changes):
    without_hashes(folder)
    with np.load(folder / "correspondence.npz") as stored:
        arrays = {**stored, **changes}
    np.savez(folder / "correspondence.npz", **{name: array for name, array in arrays.items() if array is not None})


@pytest.mark.parametrize("name", NAMES)
def test_files_of_two_results_are_not_taken_for_one(found, tmp_path, name):
    """As a process that is killed while files land leaves them."""
    found.save(tmp_path / "one")
    found.inverse().save(tmp_path / "other")
    shutil.copy(tmp_path / "other" / name, tmp_path / "one" / name)
    with pytest.raises(DataError, match=r"is not the file that report\.json belongs to.*; match again$"):
        Match.load(tmp_path / "one")


QUALITY = dict.fromkeys(("coverage", "cycle_error", "dirichlet_energy", "flipped_triangles", "confidence"), 0.5)


@pytest.mark.parametrize(
    "report",
    [
        "{",
        "[1]",
        '{"method": 3}',
        '{"method": "a", "deep": ' + "[" * 100 + "]" * 100 + "}",
        '{"method": "a", "deep": ' + "[" * 200_000,
        '{"method": "a", "deep": ' + '{"a":' * 100_000 + "1" + "}" * 100_001,
        '{"method": "a", "number": NaN}',
        '{"method": "a", "number": 1e999}',
        '{"method": "a", "number": ' + "9" * 10_000 + "}",
        b'{"method": "\xff"}',
        {"warnings": True},
        {"warnings": "look!"},
        {"warnings": [1]},
        {"inputs": []},
        {"inputs": {"source": 1.5}},
        {"inputs": {"source": {"file": 5}}},
        {"inputs": {"target": {"name": None}}},
        {"inputs": {"source": {"file": ["a"]}}},
        {"inputs": {"source": {"sha256": 1}}},
        {"inputs": {"source": {"points_left_out": "many"}}},
        {"inputs": {"source": {"points_left_out": -1}}},
        {"inputs": {"source": {"n_points": 7}}},
        {"inputs": {"target": {"n_points": "all"}}},
        {"inputs": {"target": {"points_left_out": 10**6}}},
        {"inputs": {"target": {"space": "RSA"}}},
        {"inputs": {"source": {"findings": "../../etc"}}},
        {"inputs": {"source": {"findings": [{"rule": "holes", "count": "2", "severity": "note", "action": "none"}]}}},
        {"inputs": {"source": {"findings": [{"rule": "holes"}]}}},
        {"inputs": {"source": {"n_faces": {}}}},
        {"inputs": {"source": {"n_clean_points": -1}}},
        {"inputs": {"target": {"modality": -1}}},
        {"inputs": {"target": {"usable": [[]]}}},
        {"inputs": {"target": {"extent": "far"}}},
        {"inputs": {"target": {"area": -1.0}}},
        {"inputs": {"target": {"n_components": 0.5}}},
        {"inputs": {"target": {"eigenpairs": [1]}}},
        {"orientation": {"margin": "x"}},
        {"orientation": {"ambiguous": 1}},
        {"orientation": {"misfit": None}},
        {"orientation": {"source": {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "degrees": "0"}}},
        {"alignment": {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "scale": 0}},
        {"choice": [{"misfit": 0.5}]},
        {"choice": [{"name": "people", "misfit": "little"}]},
        {"adapt": "no"},
        {"adaptation": {"kept": 1}},
        {"features": {"name": 3}},
        {"settings": []},
        {"timings": {}},
        {"timings": [{"name": "read", "seconds": "long", "process_peak_mb": 1.0}]},
        {"versions": ["0.1.0"]},
        {"orientation": []},
        {"orientation": {"source": {}}},
        {"orientation": {"source": {"rotation": [[1, 0, 0], [0, 1, 0]]}}},
        {"orientation": {"source": {"rotation": [[1, 0], [0, 1, 0], [0, 0, 1]]}}},
        {"orientation": {"target": {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}}},
        {"orientation": {"target": {"rotation": [[2, 0, 0], [0, 1, 0], [0, 0, 0.5]]}}},
        {"orientation": {"target": {"rotation": [[1, 0, 1e308], [0, 1, 0], [0, 0, 1]]}}},
        {"alignment": {"rotation": [[-1e200, 0, 0], [0, -1e200, 0], [0, 0, 1e200]]}},
        {"alignment": {"rotation": [[0, 0, 0], [0, 0, 0], [0, 0, 0]]}},
        {"alignment": {"rotation": "none"}},
        {"orientation": {"target": {"rotation": [[1e200, 0, 0], [0, 1e200, 0], [0, 0, 1e200]]}}},
        {"matched": []},
        {"matched": None},
        {"matched": {"source_points": 7}},
        {"matched": {"target_points": "all"}},
        {"matched": {"target_points": True}},
        {"matched": {"source_points_left_out": 10**17}},
        {"matched": {"source_points_left_out": 0.5}},
        {"matched": {"target_points_without_counterpart": 10**6}},
        {"matched": {"target_points_without_counterpart": -1}},
        {"matched": {"source_mean_confidence": 1.5}},
        {"matched": {"target_mean_confidence": None}},
        {"options": 7},
        {"options": {"source_up": ["y"]}},
        {"options": {"source_up": "up"}},
        {"options": {"partial": "source", "partial_scale": 0}},
        {"options": {"partial": "source", "partial_scale": "2"}},
        {"options": {"partial": 3}},
        {"options": {"as_cloud": {}}},
        {"quality": 1},
        {"quality": {"source": None, "target": None}},
        {"quality": {"source": QUALITY}},
        {"quality": {"source": QUALITY, "target": {**QUALITY, "coverage": 2}}},
        {"quality": {"source": QUALITY, "target": {**QUALITY, "coverage": "0.5"}}},
        {"quality": {"source": {"coverage": 1}, "target": None}},
        {"features": 3},
        {"choice": {}},
        {"choice": ["people"]},
        {"adaptation": [1]},
        {"device": 0},
        {"sha256": []},
        {"sha256": {"source.ply": 1}},
    ],
)
def test_reports_that_are_damaged_are_one_line(found, tmp_path, report):
    found.save(tmp_path)
    path = tmp_path / "report.json"
    if isinstance(report, dict):
        report = json.dumps({**json.loads(path.read_text()), **report})
    path.write_bytes(report.encode() if isinstance(report, str) else report)
    with pytest.raises(DataError, match=rf"^{path} (cannot be (read|used)|is damaged).*; match again$") as error:
        Match.load(tmp_path)
    assert "\n" not in str(error.value) and len(str(error.value)) < 400


@pytest.mark.parametrize("hashes", [None, {}, {"source.ply": ""}])
def test_files_that_nothing_ties_together_are_a_warning(found, tmp_path, hashes):
    found.save(tmp_path)
    path = tmp_path / "report.json"
    report = json.loads(path.read_text())
    known = report.pop("sha256")
    if hashes is not None:
        report["sha256"] = {name: known[name] for name in hashes}
    path.write_text(json.dumps(report))
    for _ in range(2):
        *before, last = Match.load(tmp_path).warnings
        assert before == ["look!"] and "does not say the hashes of the files beside it" in last


def test_rotations_that_are_some_are_read(found, tmp_path):
    turn = {"rotation": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], "degrees": 90.0}
    more = {"orientation": {"source": turn, "target": turn, "ambiguous": False}, "alignment": {**turn, "scale": 2.0}}
    replace(found, report=more).save(tmp_path)
    assert Match.load(tmp_path).report["orientation"]["source"] == turn


@pytest.mark.parametrize(
    ("versions", "writer"),
    [({}, "an older version of homolog"), ({"homolog": "0.0.1"}, r"homolog 0\.0\.1, where this is .*,")],
)
def test_a_report_of_an_older_version_says_what_is_missing(found, tmp_path, versions, writer):
    found.save(tmp_path)
    path = tmp_path / "report.json"
    report = {**json.loads(path.read_text()), "versions": versions}
    del report["method"]
    path.write_text(json.dumps(report))
    said = rf"^{path} cannot be used \(it has no entry 'method'; {writer} may have written it\); match again$"
    with pytest.raises(DataError, match=said):
        Match.load(tmp_path)


@pytest.mark.parametrize("suffix", [".npz", ".mat", ".txt", ".vts"])
def test_a_file_of_maps_is_no_match_but_makes_one(found, tmp_path, suffix):
    path = tmp_path / f"map{suffix}"
    found.save(path)
    with pytest.raises(DataError, match=r"map\.\w+ is a file of point maps, which holds no shapes; .*read_point_map"):
        Match.load(path)
    back = read_point_map(path)
    found.save(path, direction="source_to_target")
    forth = read_point_map(path, direction="source_to_target")
    again = Match(found.source, found.target, forth, back)
    np.testing.assert_array_equal(again.source_to_target, found.source_to_target)
    np.testing.assert_array_equal(again.target_to_source, found.target_to_source)
    (tmp_path / "notes.md").write_text("x")
    with pytest.raises(DataError, match=r"notes\.md is a file; give a folder"):
        Match.load(tmp_path / "notes.md")


def test_no_shape_is_replaced_by_its_own_result(found, tmp_path):
    """Whoever saves it, as the command refuses it."""
    given = tmp_path / "source.ply"
    given.write_text("precious")
    read = replace(found, report={"inputs": {"source": {"file": str(given)}}})
    with pytest.raises(ArgumentError, match=r"source\.ply is an input"):
        read.save(tmp_path)
    assert given.read_text() == "precious" and [path.name for path in tmp_path.iterdir()] == ["source.ply"]


def test_a_name_of_a_file_that_is_too_long_is_that_of_none(found, tmp_path):
    given = replace(found, report={"inputs": {"source": {"file": "y" * 5000}}})
    given.save(tmp_path)
    again = Match.load(tmp_path)
    again.save(tmp_path)
    with pytest.raises(DataError, match="the source of this match, is not there"):
        read_original(again, "source")


def test_further_inputs_are_passed_over(found, tmp_path):
    found.save(tmp_path)
    path = tmp_path / "report.json"
    report = json.loads(path.read_text())
    path.write_text(json.dumps({**report, "inputs": {**report["inputs"], "third": 5}}))
    inputs = Match.load(tmp_path).inverse().report["inputs"]
    assert (inputs["target"]["name"], inputs["third"]) == (report["inputs"]["source"]["name"], 5)


def test_points_that_a_changed_map_knows_are_not_left_out(found):
    n = found.source.n_points
    filled = replace(
        found, source_to_target=np.zeros(n, dtype=int), report={"inputs": {"source": {"points_left_out": 3}}}
    )
    told = filled.matched("source")
    assert (told["points_left_out"], told["points_without_counterpart"]) == (0, 0)


def test_a_report_may_tell_more_than_is_read(found, tmp_path):
    more = {"inputs": {"source": {"colour": None}}, "options": {"of_another_version": [1]}, "more": {"a": [None, 0.5]}}
    given = replace(found, report=more)
    given.save(tmp_path)
    told = Match.load(tmp_path).report
    assert told.pop("inputs") == {"source": {"name": "sphere", "colour": None}, "target": {"name": "cloud"}}
    ours = {"method": given.method, "warnings": ["look!"], "versions": versions()}
    assert told == {name: more[name] for name in ("options", "more")} | ours


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda folder: change_maps(folder, target_to_source=None), "no array 'target_to_source'"),
        (lambda folder: change_maps(folder, target_to_source=np.zeros(5, int)), "does not fit the shapes"),
        (lambda folder: change_maps(folder, target_to_source=np.full(42, 162)), "does not fit the shapes"),
        (lambda folder: change_maps(folder, source_to_target=np.full(162, -2)), "does not fit the shapes"),
        (lambda folder: change_maps(folder, source_confidence=np.zeros(3)), "does not fit the shapes"),
        (lambda folder: change_maps(folder, source_to_target=np.zeros(162)), "not those of a match"),
        (lambda folder: change_maps(folder, source_to_target=np.array([{}], object)), "cannot be read as the arrays"),
        (lambda folder: change_maps(folder, source_confidence=np.full(162, np.nan)), "must lie between 0 and 1"),
        (lambda folder: change_maps(folder, target_confidence=np.full(42, 7.0)), "must lie between 0 and 1"),
        (lambda folder: change_maps(folder, source_confidence=np.zeros(162, complex)), "not those of a match"),
        (lambda folder: change_maps(folder, source_confidence=np.zeros((162, 1))), "not those of a match"),
        (lambda folder: change_maps(folder, source_to_target=np.array(0)), "not those of a match"),
        (lambda folder: change_maps(folder, source_to_target=np.zeros(162, "m8[s]")), "not those of a match"),
        (lambda folder: change_maps(folder, source_to_target=np.zeros(162, [("x", "i4")])), "not those of a match"),
        (lambda folder: (folder / "correspondence.npz").write_bytes(b"PK"), "is not the file that report.json belongs"),
        (lambda folder: (folder / "source.ply").write_bytes(b"ply"), "is not the file that report.json belongs to"),
    ],
)
def test_results_that_are_spoilt_are_one_line(shapes, found, tmp_path, spoil, said):
    write_folder(tmp_path, found)
    spoil(tmp_path)
    with pytest.raises(DataError, match=said) as error:
        Match.load(tmp_path)
    assert "\n" not in str(error.value) and str(tmp_path) in str(error.value)


def test_arrays_of_other_types_become_the_usual_ones(shapes, found, tmp_path):
    """Not every library computes with the other byte order, or with other precisions."""
    write_folder(tmp_path, found)
    others = {"source_to_target": ">i4", "source_confidence": ">f8", "target_confidence": "g"}
    change_maps(tmp_path, **{name: getattr(found, name).astype(kind) for name, kind in others.items()})
    again = Match.load(tmp_path)
    for name in others:
        assert getattr(again, name).dtype in (np.int64, np.float64) and getattr(again, name).dtype.isnative
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))


def test_writing_is_a_step_of_the_report(shapes, found, tmp_path):
    heard = []
    timings = Timings(listener=heard.append)
    with timings.measure("map"):
        pass
    paths = write_folder(tmp_path, found, timings=timings)
    report = json.loads(paths[3].read_text())
    assert report["answer"] == 42
    assert [step["name"] for step in report["timings"]] == heard == ["map", "write"]
    assert report["timings"] == [asdict(step) for step in timings.finished]
    assert report["timings"][1]["seconds"] > 0


def broken(shape):
    """Points that are NaN, infinite or equal, and every kind of face that repair drops, amid the good ones."""
    n = shape.n_points
    points = np.concatenate([shape.points, [[np.nan, 0, 0], [np.inf, 1, -np.inf]], shape.points[:2]])
    bad = [[0, 1, n + 4], [-1, 0, 1], [0, 1, n], [n + 1, 1, 2], [3, 3, 4], [5, 5, 5], [0, n + 2, 5], shape.faces[0]]
    return Shape(points, np.concatenate([bad[:4], shape.faces, bad[4:]]), name="broken", allow_broken=True)


def test_other_programs_open_what_is_written_for_broken_meshes(shapes, found, tmp_path):
    good, n = shapes[0], shapes[0].n_points
    given = broken(good)
    more = replace(
        found,
        source=given,
        source_to_target=np.append(found.source_to_target, [-1, -1, *found.source_to_target[:2]]),
        source_confidence=np.append(found.source_confidence, np.zeros(4)),
    )
    paths = write_folder(tmp_path, more)
    ours, theirs, others = read_shape(paths[1]), trimesh.load(paths[1], process=False), meshio.read(paths[1])
    for points, faces in (
        (ours.points, ours.faces),
        (theirs.vertices, theirs.faces),
        (others.points, others.cells_dict["triangle"]),
    ):
        # The last face of all repeats the first one, which stays.
        np.testing.assert_array_equal(faces, good.faces)
        np.testing.assert_array_equal(points[:n], good.points)
        np.testing.assert_array_equal(points[n + 2 :], good.points[:2])
        centre = np.concatenate([good.points, good.points[:2]]).mean(axis=0)
        np.testing.assert_allclose(points[n : n + 2], [centre, centre])
    assert np.all(colours_in(paths[1])[n : n + 2] == GREY)
    np.testing.assert_array_equal(theirs.visual.vertex_colors[:, :3], colours_in(paths[1]))
    assert np.isnan(given.points[n, 0])
    cloud = meshio.read(paths[2])
    assert np.isfinite(cloud.points).all()
    assert len(cloud.points) == shapes[1].n_points
    assert trimesh.load(paths[2]).vertices.shape == cloud.points.shape


def test_a_mesh_without_a_usable_face_is_written_as_a_cloud(shapes, found, tmp_path):
    broken = Shape(shapes[0].points, [[0, 1, 999], [2, 2, 3]], allow_broken=True)
    paths = write_folder(tmp_path, replace(found, source=broken))
    written = read_shape(paths[1])
    assert written.faces is None
    np.testing.assert_array_equal(written.points, shapes[0].points)


def test_a_source_point_that_is_a_match_has_its_colour_even_without_a_counterpart(shapes, found):
    forth, back = found.source_to_target.copy(), found.target_to_source.copy()
    forth[5], back[0] = -1, 5
    source_colours, target_colours = matched_colours(replace(found, source_to_target=forth, target_to_source=back))
    assert np.array_equal(source_colours[5], target_colours[0])
    assert not np.array_equal(source_colours[5], GREY)


def test_same_colour_same_point(shapes, found, tmp_path):
    paths = write_folder(tmp_path, found)
    source, target = colours_in(paths[1]), colours_in(paths[2])
    asked, matched = found.target_to_source, found.target_to_source >= 0
    # A source point without a counterpart is grey itself, yet lends its colour to target points mapped to it.
    with_match = found.source_to_target >= 0
    both = matched & with_match[asked]
    assert both.sum() > 30
    np.testing.assert_array_equal(target[both], source[asked[both]])
    assert np.all(target[~matched] == GREY)
    assert np.all(source[~with_match] == GREY)
    assert len(np.unique(source, axis=0)) > 100


def test_colours_follow_the_position():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, -4], [np.inf, 0, 0], [0.5, 1, -2]])
    colours = position_colours(points)
    assert colours.dtype == np.uint8
    assert colours[:5].tolist() == [[40, 40, 255], [255, 40, 255], [40, 255, 255], [40, 40, 40], GREY]
    assert np.all(np.abs(colours[5].astype(int) - 147.5) <= 1)
    assert position_colours(points[:3])[:, 2].tolist() == [40, 40, 40]


def test_a_point_that_has_no_match_does_not_stretch_the_colours(shapes, found):
    stray = Shape(np.concatenate([shapes[0].points, [[1e6, 1e6, 1e6]]]))
    longer = replace(
        found,
        source=stray,
        source_to_target=np.append(found.source_to_target, -1),
        source_confidence=np.append(found.source_confidence, 0.0),
    )
    source, target = matched_colours(longer)
    expected = matched_colours(found)
    np.testing.assert_array_equal(source[:-1], expected[0])
    np.testing.assert_array_equal(target, expected[1])


def test_maps_are_saved_under_the_name_given(found, tmp_path):
    """A suffix in capitals counts, and none is added to it."""
    assert found.save(tmp_path / "maps.NPZ") == [tmp_path / "maps.NPZ"]
    assert [path.name for path in tmp_path.iterdir()] == ["maps.NPZ"]
    with np.load(tmp_path / "maps.NPZ") as saved:
        np.testing.assert_array_equal(saved["source_to_target"], found.source_to_target)


def test_matched_colours_have_one_row_per_point(shapes, found):
    source, target = matched_colours(found)
    assert source.shape == (162, 3)
    assert target.shape == (42, 3)
    assert source.dtype == target.dtype == np.uint8


def test_other_files_in_the_folder_stay(shapes, found, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "report.json").write_text("old")
    write_folder(tmp_path, found)
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert Match.load(tmp_path).report == WRITTEN


def test_out_is_a_file(shapes, found, tmp_path):
    (tmp_path / "out").write_text("precious")
    for folder in (tmp_path / "out", tmp_path / "out" / "below"):
        with pytest.raises(ArgumentError, match="cannot be made a folder") as caught:
            write_folder(folder, found)
        assert "\n" not in str(caught.value)
    assert (tmp_path / "out").read_text() == "precious"


class Stopped(BaseException):
    """Stands for Ctrl-C."""


def with_former_result(folder, before):
    folder.mkdir()
    for name in before:
        (folder / name).write_bytes(b"old " + name.encode())


def is_as_before(folder, before):
    assert sorted(path.name for path in folder.iterdir()) == sorted(before)
    for name in before:
        assert (folder / name).read_bytes() == b"old " + name.encode()


BEFORE = [[], NAMES, NAMES[1:3]]
ERRORS = [OSError(28, "No space left on device"), Stopped()]


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("broken", ["correspondence.npz", "source.ply"])
@pytest.mark.parametrize("before", BEFORE)
def test_writing_that_stops_leaves_all_as_it_was(shapes, found, tmp_path, monkeypatch, error, broken, before):
    """Amid the first file or the second: no file of the result changes, and no other trace is left."""
    with_former_result(tmp_path / "result", before)

    def half(place, *args, **kwargs):
        place.write_bytes(b"half") if isinstance(place, Path) else place.write(b"half")
        raise error

    if broken == "source.ply":
        ply = replace(formats()[".ply"], write=half, write_values=half)
        monkeypatch.setattr("homolog.shapes.writing.formats", lambda: {".ply": ply})
    else:
        monkeypatch.setattr("homolog.matching.result_files.np.savez_compressed", half)
    with pytest.raises(ArgumentError if isinstance(error, OSError) else Stopped):
        write_folder(tmp_path / "result", found)
    is_as_before(tmp_path / "result", before)


@pytest.mark.parametrize("links", [True, False])
@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("landed", range(4))
@pytest.mark.parametrize("before", BEFORE)
def test_landing_that_stops_is_undone(shapes, found, tmp_path, monkeypatch, error, landed, before, links):
    """All files are written, and the renaming stops at one of them; also where a file has no second name."""
    with_former_result(tmp_path / "result", before)
    rename, count = Path.replace, iter(range(100))

    def stopping(path, target):
        if next(count) == landed:
            raise error
        return rename(path, target)

    def refused(path, target):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(Path, "replace", stopping)
    if not links:
        monkeypatch.setattr(Path, "hardlink_to", refused)
    with pytest.raises(ArgumentError if isinstance(error, OSError) else Stopped) as caught:
        write_folder(tmp_path / "result", found)
    if isinstance(error, OSError):
        assert str(caught.value) == f"{tmp_path / 'result' / NAMES[landed]} cannot be written: No space left on device"
    is_as_before(tmp_path / "result", before)


@pytest.mark.parametrize("before", BEFORE)
@pytest.mark.parametrize("bad", [object(), float("nan")])
def test_a_report_that_json_cannot_hold_leaves_all_as_it_was(shapes, found, tmp_path, before, bad):
    with_former_result(tmp_path / "result", before)
    with pytest.raises((TypeError, ValueError)):
        write_folder(tmp_path / "result", replace(found, report={"bad": bad}))
    is_as_before(tmp_path / "result", before)


def test_a_result_takes_the_place_of_an_earlier_one(shapes, found, tmp_path):
    with_former_result(tmp_path / "result", NAMES)
    write_folder(tmp_path / "result", found)
    assert sorted(path.name for path in (tmp_path / "result").iterdir()) == sorted(NAMES)
    assert Match.load(tmp_path / "result").report == WRITTEN
    assert colours_in(tmp_path / "result" / "source.ply").shape == (162, 3)
