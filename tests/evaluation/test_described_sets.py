"""Sets of parts and of clouds by the protocol, against direct computation, with matchers told what to answer."""

import json
import weakref
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra

from homolog.core.errors import ArgumentError, DataError
from homolog.datasets import ShapeFolder
from homolog.evaluation import Detection, Protocol, evaluate
from homolog.matching import Match, Matcher
from homolog.pairs import MatcherSettings
from homolog.shapes import Shape, read_shape, stand_upright, upright_rotation, write_shape
from homolog.synthesis import ViewSettings, write_view_dataset

PARTS = Protocol(partial=True, pre_aligned=True)


@dataclass
class Ready:
    """What the stub preprocesses: the shape it was given."""

    shape: Shape
    modality: str

    @property
    def name(self):
        return Path(self.shape.name).stem


class Stub:
    """Answers by functions of the two prepared shapes: per target point a source point, and the other way."""

    settings = MatcherSettings()

    def __init__(self, back, forth=None):
        self.back, self.forth = back, forth
        self.prepared, self.frames, self.matched = [], [], []

    def preprocess(
        self,
        shape,
        *,
        as_cloud=False,
        scale=None,
        centre=None,
        orient="auto",
        partial=False,
        clutter="remove",
        proxy="auto",
    ):
        self.prepared.append(shape)
        self.frames.append((scale, centre))
        return Ready(shape, "cloud" if as_cloud else "mesh")

    def method_of(self, source, target, *, parts=False):
        return SimpleNamespace(name="nearest-features")

    def paired(self, source, target, options):
        return SimpleNamespace(source=source, target=target, options=options)

    def find(self, pair):
        source, target = pair.source, pair.target
        self.matched.append((source.name, target.name, pair.options.partial))
        back = np.asarray(self.back(source, target))
        forth = np.zeros(source.shape.n_points, int) if self.forth is None else self.forth(source, target)
        return Match(source.shape, target.shape, forth, back, np.zeros(len(forth)), np.ones(len(back)))


def distances_along_edges(shape):
    """Between all points, edges taken from the faces one by one, over the root of the area."""
    graph, area = np.zeros((shape.n_points, shape.n_points)), 0.0
    for corners in shape.faces:
        a, b, c = shape.points[corners]
        area += np.linalg.norm(np.cross(b - a, c - a)) / 2
        for i in range(3):
            p, q = corners[i], corners[i - 1]
            graph[p, q] = graph[q, p] = np.linalg.norm(shape.points[p] - shape.points[q])
    return dijkstra(graph) / np.sqrt(area)


def random_answer(source, target):
    seed = source.shape.n_points + target.shape.n_points
    return np.random.default_rng(seed).integers(0, source.shape.n_points, target.shape.n_points)


# ---- parts


def test_parts_are_scored_on_their_complete_shapes(parts_set):
    root, known = parts_set
    folder, stub = ShapeFolder.open(root, "shrec16_cuts"), Stub(random_answer)
    found = evaluate(stub, folder, PARTS)
    assert stub.matched == [(partner, name, "target") for name, (partner, *_) in sorted(known.items())]
    for pair in found.pairs:
        complete, part = (read_shape(folder.file(name)) for name in pair.pair)
        _, triangles, weights = known[pair.pair[1]]
        truth = [complete.faces[t][np.argmax(w)] for t, w in zip(triangles, weights, strict=True)]
        mapped = random_answer(Ready(complete, ""), Ready(part, ""))
        np.testing.assert_allclose(pair.errors, distances_along_edges(complete)[truth, mapped], rtol=1e-9)
    every = np.concatenate([pair.errors for pair in found.pairs])
    assert found.to_dict()["mean_geodesic_error"] == pytest.approx(100 * every.mean())
    assert found.to_dict()["unit"] == "sqrt(area) / 100"


def test_a_perfect_map_of_parts_has_no_error(parts_set):
    root, _ = parts_set
    folder = ShapeFolder.open(root, "shrec16_cuts")

    def truth(source, target):
        return folder.ground_truth().between(source.name, target.name).source

    assert np.all(evaluate(Stub(truth), folder, PARTS).errors == 0)


def test_parts_take_unit_and_place_of_their_complete_shapes_stood_upright(parts_set):
    root, _ = parts_set
    stub = Stub(random_answer)
    evaluate(stub, ShapeFolder.open(root, "shrec16_cuts"), PARTS)
    for shape, (scale, centre) in zip(stub.prepared, stub.frames, strict=True):
        name = Path(shape.name).stem
        place = "null" if name in ("cat", "dog") else "cuts"
        standing = stand_upright(read_shape(root / place / f"{name}.off"), "z")
        np.testing.assert_array_equal(shape.points, standing.points)
        if place == "cuts":
            partner = stand_upright(read_shape(root / "null" / f"{name.split('_')[1]}.off"), "z")
            a, b, c = (partner.points[partner.faces[:, i]] for i in range(3))
            assert scale == pytest.approx(np.sqrt(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2))
            np.testing.assert_allclose(centre, partner.points.mean(axis=0), atol=1e-9)
        else:
            assert scale is centre is None


def test_points_without_a_counterpart_are_counted_over_all_pairs(parts_set):
    root, known = parts_set
    folder = ShapeFolder.open(root, "shrec16_cuts")

    def every_third_is_missing(source, target):
        return np.where(np.arange(source.shape.n_points) % 3 == 0, -1, 0)

    found = evaluate(Stub(random_answer, every_third_is_missing), folder, PARTS)
    counts = np.zeros(3, int)
    for name, (partner, triangles, weights) in known.items():
        whole = read_shape(root / "null" / f"{partner}.off")
        edge = np.mean(
            [np.linalg.norm(whole.points[f[i]] - whole.points[f[i - 1]]) for f in whole.faces for i in range(3)]
        )
        places = [w @ whole.points[whole.faces[t]] for t, w in zip(triangles, weights, strict=True)]
        lacks = [min(np.linalg.norm(point - place) for place in places) > edge for point in whole.points]
        said = [number % 3 == 0 for number in range(whole.n_points)]
        own = sum(said), sum(lacks), sum(a and b for a, b in zip(said, lacks, strict=True))
        assert next(pair for pair in found.pairs if pair.pair[1] == name).missing == Detection(*own)
        counts += own
    precision, recall = counts[2] / counts[0], counts[2] / counts[1]
    figures = found.to_dict()["without_counterpart"]
    assert figures["precision"] == pytest.approx(precision)
    assert figures["recall"] == pytest.approx(recall)
    assert figures["f1"] == pytest.approx(2 * precision * recall / (precision + recall))
    assert [figures[key] for key in ("found", "true", "both")] == counts.tolist()


def test_a_map_from_the_partial_shape_says_nothing_of_points_that_it_lacks(parts_set):
    root, _ = parts_set
    folder = ShapeFolder.open(root, "shrec16_cuts")
    found = evaluate(None, folder, PARTS, match=lambda source, target: np.zeros(target.n_points, dtype=int))
    figures = found.to_dict()
    assert found.missing is None and "without_counterpart" not in figures
    assert figures["doubtful_pairs"] is None and figures["least_confident_fifth_error_share"] is None


def test_whole_shapes_have_no_such_figures(parts_set):
    root, _ = parts_set
    found = evaluate(Stub(random_answer), ShapeFolder.open(root, "shrec16_cuts"), Protocol())
    assert found.missing is None
    assert "without_counterpart" not in found.to_dict()


def test_common_points_tell_what_a_part_lacks(tmp_path, make):
    """Of five common points of the complete shape, two are -1 on the part; the match says so of one, and of another."""
    (tmp_path / "off").mkdir()
    (tmp_path / "corres").mkdir()
    for name, lines in (("a", "5 6 7 8 9"), ("b", "1 -1 3 4 -1")):
        write_shape(tmp_path / "off" / f"{name}.off", make.sphere(1))
        (tmp_path / "corres" / f"{name}.vts").write_text(lines.replace(" ", "\n"))
    (tmp_path / "pairs.txt").write_text("a,b\n")

    def forth(source, target):
        found = np.zeros(42, int)
        found[[5, 7, 20]] = -1  # common points 2 and 4 of five, and a point of which nothing is known
        return found

    found = evaluate(Stub(lambda s, t: np.zeros(42, int), forth), ShapeFolder.open(tmp_path), Protocol(partial=True))
    assert found.missing == Detection(found=2, true=2, both=1)


def test_the_overlap_of_two_parts(tmp_path, make):
    """Of five common points one is missing on a, another one on b, and one on both; both maps err once."""
    (tmp_path / "off").mkdir()
    (tmp_path / "corres").mkdir()
    for name, lines in (("a", "5 6 7 -1 -1"), ("b", "1 -1 3 4 -1")):
        write_shape(tmp_path / "off" / f"{name}.off", make.sphere(1))
        (tmp_path / "corres" / f"{name}.vts").write_text(lines.replace(" ", "\n"))
    (tmp_path / "pairs.txt").write_text("a,b\n")

    def forth(source, target):
        found = np.zeros(42, int)
        found[[4, 20]] = -1  # a common point that b has, too
        return found

    def back(source, target):
        found = np.full(42, -1)
        found[[0, 2]] = 4, 6
        return found

    protocol = Protocol(partial="both")
    stub = Stub(back, forth)
    found = evaluate(stub, ShapeFolder.open(tmp_path), protocol)
    # Common points of a: 4 and 6, which b has, and 5; of b: 0 and 2, which a has, and 3.
    assert found.overlap == Detection(found=2 + 2, true=2 + 2, both=1 + 2)
    assert found.overlap_iou == pytest.approx(3 / 5)
    figures = found.to_dict()
    assert figures["overlap"]["mean_iou"] == pytest.approx(3 / 5)
    assert figures["pairs"][0]["overlap"]["iou"] == pytest.approx(3 / 5)
    assert found.missing is None and "without_counterpart" not in figures
    assert np.all(found.errors == 0) and len(found.errors) == 2
    assert evaluate(stub, ShapeFolder.open(tmp_path), Protocol(partial=True)).overlap is None


@pytest.mark.parametrize(("partial", "told"), [("one", "true or false, or 'both'"), (3, "true or false, or 'both'")])
def test_what_is_partial(partial, told):
    with pytest.raises(ArgumentError, match=rf"partial holds {partial!r}, but must be {told}"):
        Protocol(partial=partial)


def test_parts_in_other_units(views_set):
    """Targets alone are multiplied, as the part that they are; the truth stays."""
    folder = ShapeFolder.open(views_set, "views")
    stub = Stub(lambda source, target: np.zeros(target.shape.n_points, int))
    evaluate(stub, folder, Protocol(partial=True, part_units=0.01))
    for shape in stub.prepared:
        own = folder.shape(Path(shape.name).stem)
        factor = 0.01 if Path(shape.name).stem.startswith("view") else 1
        np.testing.assert_allclose(shape.points, factor * own.points)
    with pytest.raises(ArgumentError, match=r"part_units is 0\.01, but partial is False"):
        Protocol(part_units=0.01)


def test_pairs_of_views(tmp_path, make):
    """Both views show one blob, whose every vertex is a common point; as a cloud the target has points of its own."""
    (tmp_path / "in" / "off").mkdir(parents=True)
    (tmp_path / "in" / "corres").mkdir()
    for name in "abcde":
        blob = make.blob()
        write_shape(tmp_path / "in" / "off" / f"{name}.off", blob)
        (tmp_path / "in" / "corres" / f"{name}.vts").write_text("\n".join(str(i + 1) for i in range(blob.n_points)))
    settings = ViewSettings(pixels=(24, 18))
    write_view_dataset(tmp_path / "in", tmp_path / "out", views=5, seed=3, settings=settings, apart=70.0)
    folder = ShapeFolder.open(tmp_path / "out", "view_pairs")
    (pair,) = folder.pairs("test")
    assert pair == ("view_000004_a", "view_000004_b")
    cloud, source = folder.cloud(pair[1]), folder.shape(pair[0])
    there = np.load(tmp_path / "out" / "truth" / f"{pair[1]}.npz")["cloud_to_full"]
    seen = there >= 0
    assert 0 < seen.sum() < len(there)
    full = folder.shape(json.loads((tmp_path / "out" / "truth" / f"{pair[1]}.json").read_text())["viewed"])
    edge = np.linalg.norm(full.points[full.faces[:, 0]] - full.points[full.faces[:, 1]], axis=1).max()
    assert np.linalg.norm(cloud.points[seen] - source.points[there[seen]], axis=1).max() < edge
    # What is not seen by the first camera is no corner that its view has.
    assert np.linalg.norm(cloud.points[~seen, None] - source.points, axis=2).min(axis=1).mean() > 0
    found = evaluate(Stub(lambda s, t: there), folder, Protocol(partial="both", modality="mesh-to-cloud"))
    assert np.all(found.errors == 0) and len(found.errors) == seen.sum()
    assert found.overlap is not None


@pytest.fixture
def views_set(tmp_path, make):
    """Views of five blobs that are one another's doubles, whose every vertex is a common point."""
    (tmp_path / "in" / "off").mkdir(parents=True)
    (tmp_path / "in" / "corres").mkdir()
    for name in "abcde":
        blob = make.blob()
        write_shape(tmp_path / "in" / "off" / f"{name}.off", blob)
        (tmp_path / "in" / "corres" / f"{name}.vts").write_text("\n".join(str(i + 1) for i in range(blob.n_points)))
    settings = ViewSettings(pixels=(24, 18), noise=0.01)
    write_view_dataset(tmp_path / "in", tmp_path / "out", views=10, seed=3, settings=settings)
    return tmp_path / "out"


def test_views_as_clouds_have_points_of_their_own(views_set):
    folder = ShapeFolder.open(views_set, "views")
    clouds = {name: read_shape(views_set / "clouds" / f"{name}.ply") for _, name in folder.pairs("test")}
    truth = {name: np.load(views_set / "truth" / f"{name}.npz")["cloud_to_full"] for name in clouds}
    matcher = Stub(lambda source, target: truth[target.name])
    found = evaluate(matcher, folder, Protocol(partial=True, modality="mesh-to-cloud"))
    assert [pair.pair[1] for pair in found.pairs] == list(clouds)
    for pair in found.pairs:
        assert len(pair.errors) == clouds[pair.pair[1]].n_points
        assert not pair.errors.any()
    seen = {Path(shape.name).stem: shape for shape in matcher.prepared}
    for name, cloud in clouds.items():
        assert np.array_equal(seen[name].points, cloud.points)
        assert seen[name].faces is None
    assert found.missing is not None

    wrong = evaluate(
        Stub(lambda s, t: np.zeros(t.shape.n_points, int)), folder, Protocol(partial=True, modality="cloud")
    )
    source = folder.shape(wrong.pairs[0].pair[0])
    expected = distances_along_edges(source)[0][truth[wrong.pairs[0].pair[1]]]
    assert np.allclose(wrong.pairs[0].errors, expected)


def test_views_as_meshes_have_the_points_of_the_complete_shape(views_set):
    folder = ShapeFolder.open(views_set, "views")
    maps = {name: np.load(views_set / "truth" / f"{name}.npz")["mesh_to_full"] for _, name in folder.pairs("test")}
    found = evaluate(Stub(lambda source, target: maps[target.name]), folder, Protocol(partial=True))
    assert all(len(pair.errors) == len(maps[pair.pair[1]]) and not pair.errors.any() for pair in found.pairs)


def test_views_without_common_points_have_no_truth_as_clouds(views_set):
    folder = ShapeFolder.open(views_set, "views")
    (_, name), *_ = folder.pairs("test")
    path = views_set / "truth" / f"{name}.npz"
    with np.load(path) as arrays:
        kept = {key: arrays[key] for key in arrays if key != "cloud_to_full"}
    np.savez(path, **kept)
    with pytest.raises(DataError, match=f"{path} has no cloud_to_full"):
        evaluate(Stub(lambda s, t: [0]), folder, Protocol(partial=True, modality="mesh-to-cloud"))


@pytest.mark.parametrize("modality", ["mesh", "mesh-to-cloud"])
def test_shapes_are_let_go_of_when_they_are_needed_no_more(views_set, modality):
    folder = ShapeFolder.open(views_set, "views")
    held, most = [], 0

    class Counting(Stub):
        def preprocess(self, shape, **options):
            ready = super().preprocess(shape, **options)
            held.append(weakref.ref(ready))
            return ready

        def find(self, pair):
            nonlocal most
            most = max(most, sum(ready() is not None for ready in held))
            return super().find(pair)

    pairs = folder.pairs("all")
    evaluate(
        Counting(lambda s, t: np.zeros(t.shape.n_points, int)),
        folder,
        Protocol(partial=True, split="all", modality=modality),
    )
    # At most those sources that a later pair needs, and one target.
    assert len(held) == len({source for source, _ in pairs}) + len(pairs)
    assert most <= len({source for source, _ in pairs}) + 1


def test_figures_that_are_not_defined_are_none():
    nothing = Detection(0, 0, 0)
    assert (nothing.precision, nothing.recall, nothing.f1) == (None, None, None)
    assert Detection(4, 0, 0).to_dict() == {
        "precision": 0.0,
        "recall": None,
        "f1": 0.0,
        "found": 4,
        "true": 0,
        "both": 0,
    }
    assert Detection(1, 2, 3) + Detection(10, 20, 30) == Detection(11, 22, 33)


# ---- clouds


def rows_of(clouds, prepared):
    """Which row of its file each point is, by where it lies; the files are z-up."""
    file = clouds[prepared.name.removeprefix("landmarks")]
    points = prepared.shape.points @ upright_rotation("z")
    return [int(np.argmin(np.linalg.norm(file - point, axis=1))) for point in points]


@pytest.mark.parametrize("seed", [0, 7])
def test_clouds_are_shuffled_before_they_are_matched_and_scored_in_their_own_unit(clouds_set, seed):
    root, clouds = clouds_set

    def next_row(source, target):
        """By rows of the files: each point to the true one's successor."""
        ours, theirs = rows_of(clouds, source), rows_of(clouds, target)
        return [ours.index((row + 1) % 50) for row in theirs]

    found = evaluate(Stub(next_row), ShapeFolder.open(root, "lungs"), Protocol(modality="cloud", seed=seed))
    assert len(found.pairs) == 9
    for pair in found.pairs:
        file = clouds[pair.pair[0]]
        expected = np.linalg.norm(file - np.roll(file, -1, axis=0), axis=1)
        np.testing.assert_allclose(np.sort(pair.errors), np.sort(expected))
    figures = found.to_dict()
    assert figures["unit"] == "mm"
    assert figures["mean_euclidean_error"] == pytest.approx(found.errors.mean())
    assert figures["median_euclidean_error"] == pytest.approx(np.median(found.errors))
    assert not [key for key in figures if "geodesic" in key or "pck" in key]
    assert "mean_euclidean_error" in figures["pairs"][0]


def test_the_numbering_of_clouds_gives_nothing_away(clouds_set):
    """What maps row i to row i has no truth in it, but on a cloud itself."""
    root, _ = clouds_set
    stub = Stub(lambda source, target: np.arange(50))
    found = evaluate(stub, ShapeFolder.open(root, "lungs"), Protocol(modality="cloud"))
    for pair in found.pairs:
        assert np.mean(pair.errors == 0) < 0.2 or pair.pair[0] == pair.pair[1]
    other = evaluate(stub, ShapeFolder.open(root, "lungs"), Protocol(modality="cloud", seed=1))
    assert not np.array_equal(found.errors, other.errors)
    again = evaluate(stub, ShapeFolder.open(root, "lungs"), Protocol(modality="cloud"))
    np.testing.assert_array_equal(found.errors, again.errors)


def test_the_real_matcher_takes_clouds(clouds_set):
    root, _ = clouds_set
    found = evaluate(Matcher(device="cpu"), ShapeFolder.open(root, "lungs"), Protocol(modality="cloud", n_pairs=1))
    assert np.isfinite(found.errors).all()


# ---- what can be wrong


def test_all_truth_is_looked_at_before_anything_is_matched(parts_set):
    root, _ = parts_set
    (root / "cuts" / "cuts_dog_shape_1.baryc_gt").write_text("1 1 0 0\n")
    stub = Stub(random_answer)
    with pytest.raises(DataError, match="has 1 lines, but cuts_dog_shape_1 has 90 points"):
        evaluate(stub, ShapeFolder.open(root, "shrec16_cuts"), PARTS)
    assert stub.prepared == []


def test_a_set_without_truth_is_not_scored(parts_set):
    root, _ = parts_set
    folder = ShapeFolder.open(root, "shrec16_cuts")
    described = replace(folder.description, truth="none", full="", pairs="every", partial=False, pre_aligned=False)
    with pytest.raises(DataError, match="this dataset has no ground truth"):
        evaluate(Stub(random_answer), ShapeFolder.open(root, described), Protocol())
