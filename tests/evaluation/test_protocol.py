"""The protocol against a direct computation, with matchers that answer what they are told."""

import json
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra

from homolog.core.errors import ArgumentError, DataError
from homolog.datasets import ShapeFolder
from homolog.evaluation import Evaluation, PairErrors, Protocol, evaluate, geodesic_errors
from homolog.geometry import compute_operators
from homolog.matching import MapQuality, Match, Matcher, Quality
from homolog.pairs import MatcherSettings, WarningSettings
from homolog.shapes import Shape, face_areas, write_shape

BASE_POINTS = 162
COMMON = {"a": 90, "b": 90, "c": 90, "d": 31, "e": 31}


@dataclass(frozen=True)
class Family:
    """Differently deformed, scaled and ordered copies of one mesh, on disk, with common points."""

    folder: ShapeFolder
    shapes: dict[str, Shape]
    order: dict[str, np.ndarray]
    """Per shape, which point of the base each vertex is."""

    def vertex(self, name):
        """Per base point, its vertex on a shape."""
        return np.argsort(self.order[name])

    def truth(self, source, target):
        """Per target vertex, the true source vertex."""
        return self.vertex(source)[self.order[target]]


@pytest.fixture(scope="module")
def family(tmp_path_factory, make):
    root = tmp_path_factory.mktemp("family")
    (root / "off").mkdir()
    (root / "corres").mkdir()
    base, rng = make.blob(2), np.random.default_rng(0)
    asked = {count: rng.permutation(BASE_POINTS)[:count] for count in set(COMMON.values())}
    shapes, orders = {}, {}
    for number, (name, count) in enumerate(COMMON.items()):
        order = rng.permutation(BASE_POINTS)
        stretch = rng.uniform(0.5, 2, 3) * 10.0**number
        shape = Shape(base.points * stretch + 10.0**number, base.faces)
        shapes[name] = Shape(*_arrays(make.relabelled(shape, order)), name=f"{name}.off")
        orders[name] = order
        write_shape(root / "off" / f"{name}.off", shapes[name])
        lines = np.argsort(order)[asked[count]] + 1
        (root / "corres" / f"{name}.vts").write_text("".join(f"{line}\n" for line in lines))
    (root / "pairs.txt").write_text("a,b\nb,a\na,a\nc,b\na,c\nd,e\ne,d\ne,e\n")
    return Family(ShapeFolder.open(root), shapes, orders)


def _arrays(shape):
    return shape.points, shape.faces


def brute_force(shape, truth, mapped):
    """Dijkstra between all points, on edges taken from the faces one by one; over the root of the area."""
    n = shape.n_points
    graph = np.zeros((n, n))
    area = 0.0
    for i, j, k in shape.faces:
        a, b, c = shape.points[[i, j, k]]
        area += np.linalg.norm(np.cross(b - a, c - a)) / 2
        for p, q in ((i, j), (j, k), (k, i)):
            graph[p, q] = graph[q, p] = np.linalg.norm(shape.points[p] - shape.points[q])
    return dijkstra(graph)[truth, mapped] / np.sqrt(area)


@dataclass
class Ready:
    """What the stub preprocesses: the shape it was given."""

    shape: Shape
    name: str
    modality: str


class Stub:
    """Answers by a function of source and target name: per target vertex a source vertex. Forth is nonsense."""

    settings = MatcherSettings()

    def __init__(self, answer, confidence=None):
        self.answer, self.confidence = answer, confidence
        self.prepared, self.centres, self.matched, self.partial = [], [], [], []

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
        self.prepared.append((shape, as_cloud, scale))
        self.centres.append(centre)
        return Ready(shape, shape.name.removesuffix(".off"), "cloud" if as_cloud else "mesh")

    def method_of(self, source, target):
        return SimpleNamespace(name=f"{source}, {target}")

    def paired(self, source, target, options):
        return SimpleNamespace(source=source, target=target, options=options)

    def find(self, pair):
        source, target = pair.source, pair.target
        self.matched.append((source.name, target.name))
        self.partial.append(pair.options.partial)
        back = np.asarray(self.answer(source.name, target.name))
        more = target.shape.n_points - len(back)  # points that are no vertex of the base
        confidence = np.ones(len(back)) if self.confidence is None else self.confidence(source.name, target.name)
        nonsense = np.zeros(source.shape.n_points, int)
        return Match(
            source.shape,
            target.shape,
            nonsense,
            np.append(back, np.full(more, -1)),
            np.zeros(len(nonsense)),
            np.append(confidence, np.zeros(more)),
        )


ALL = Protocol(split="all")
TINY = Protocol(split="all", modality="cloud", noise=0.01)


def test_a_perfect_map_has_no_error(family):
    found = evaluate(Stub(family.truth), family.folder, ALL)
    assert np.all(found.errors == 0)
    figures = found.to_dict()
    assert figures["mean_geodesic_error"] == figures["median_geodesic_error"] == 0
    assert figures["pck_auc"] == 1
    assert figures["unmatched_points"] == 0
    assert figures["least_confident_fifth_error_share"] is None


def test_the_map_measured_is_target_to_source(family):
    """A matcher whose maps are the truth the wrong way round fares badly."""
    wrong = evaluate(Stub(lambda s, t: family.truth(t, s)), family.folder, ALL)
    assert wrong.to_dict()["mean_geodesic_error"] > 30


@pytest.fixture(scope="module")
def shifted(family):
    """Maps that are off by known vertices, differently for every pair and way."""

    def answer(source, target):
        seed = 100 * ord(source) + ord(target)
        away = np.random.default_rng(seed).permutation(BASE_POINTS)
        truth = family.truth(source, target)
        return np.where(np.arange(BASE_POINTS) % 3 == 0, truth, away)

    return answer


def expected_errors(family, answer, pairs):
    errors = []
    for source, target in pairs:
        truth, asked = family.folder.template_correspondence(source), family.folder.template_correspondence(target)
        errors.append(brute_force(family.shapes[source], truth, answer(source, target)[asked]))
    return errors


def test_errors_are_graph_distances_on_the_source(family, shifted):
    stub = Stub(shifted)
    found = evaluate(stub, family.folder, ALL)
    pairs = family.folder.pairs("all")
    assert len(pairs) == 8
    assert stub.matched == list(pairs)
    assert [pair.pair for pair in found.pairs] == list(pairs)
    for pair, expected in zip(found.pairs, expected_errors(family, shifted, pairs), strict=True):
        assert len(expected) == COMMON[pair.pair[0]]
        np.testing.assert_allclose(pair.errors, expected, rtol=1e-9, atol=1e-12)


def test_figures_pool_all_points_of_all_pairs(family, shifted):
    figures = evaluate(Stub(shifted), family.folder, ALL).to_dict()
    parts = expected_errors(family, shifted, family.folder.pairs("all"))
    errors = np.concatenate(parts)
    assert {len(part) for part in parts} == {90, 31}
    mean_of_means = np.mean([part.mean() for part in parts])
    assert abs(errors.mean() - mean_of_means) > 1e-3  # these would pass for one another otherwise
    assert figures["mean_geodesic_error"] == pytest.approx(100 * errors.mean())
    assert figures["median_geodesic_error"] == pytest.approx(100 * np.median(errors))
    thresholds = np.array(figures["pck"]["thresholds"])
    shares = np.array([np.mean(errors <= threshold) for threshold in thresholds])
    np.testing.assert_allclose(figures["pck"]["shares"], shares)
    assert figures["pck_threshold"] == thresholds[-1] == 0.1
    assert figures["pck_auc"] == pytest.approx(np.sum((shares[1:] + shares[:-1]) / 2 * np.diff(thresholds)) / 0.1)
    assert [(entry["source"], entry["target"]) for entry in figures["pairs"]] == list(family.folder.pairs("all"))
    for entry, part in zip(figures["pairs"], parts, strict=True):
        assert entry["points"] == len(part)
        assert entry["mean_geodesic_error"] == pytest.approx(100 * part.mean())
    assert set(figures["seconds"]) == {"preprocess", "match", "measure", "total"}
    assert figures["seconds"]["total"] >= max(figures["seconds"][key] for key in ("preprocess", "match", "measure"))


def test_confidences_are_those_of_the_points_measured(family, shifted):
    def unsure_when_wrong(source, target):
        return (shifted(source, target) == family.truth(source, target)).astype(float)

    found = evaluate(Stub(shifted, unsure_when_wrong), family.folder, ALL)
    for pair in found.pairs:
        np.testing.assert_array_equal(pair.confidences == 1, pair.errors == 0)
    sure_when_wrong = evaluate(Stub(shifted, lambda s, t: 1 - unsure_when_wrong(s, t)), family.folder, ALL)
    shares = [each.to_dict()["least_confident_fifth_error_share"] for each in (found, sure_when_wrong)]
    assert shares[0] > 0.2
    assert shares[1] == 0


def test_points_without_a_match_count_as_the_diameter(family, shifted):
    """And the mean over matched points alone stands beside."""

    def with_gaps(source, target):
        return np.where(np.arange(BASE_POINTS) % 4 == 1, -1, shifted(source, target))

    found = evaluate(Stub(with_gaps), family.folder, ALL)
    diameters, matched = {name: diameter(shape) for name, shape in family.shapes.items()}, []
    for pair, expected in zip(found.pairs, expected_errors(family, shifted, family.folder.pairs("all")), strict=True):
        left = family.folder.template_correspondence(pair.pair[1]) % 4 != 1
        np.testing.assert_array_equal(pair.matched, left)
        np.testing.assert_allclose(pair.errors[left], expected[left])
        unmatched = pair.errors[~left]
        assert np.all(unmatched <= (1 + 1e-9) * diameters[pair.pair[0]])
        assert np.all(unmatched >= 0.94 * diameters[pair.pair[0]])
        assert len(pair.confidences) == len(pair.errors) == len(expected)
        matched.append(expected[left])
    figures, errors = found.to_dict(), np.concatenate(matched)
    assert figures["unmatched_points"] == np.sum(~found.matched) == len(found.errors) - len(errors) > 0
    assert figures["mean_geodesic_error_of_matched_points"] == pytest.approx(100 * errors.mean())
    assert figures["mean_geodesic_error"] == pytest.approx(100 * found.errors.mean())
    assert figures["mean_geodesic_error"] > 1.2 * figures["mean_geodesic_error_of_matched_points"]


def diameter(shape):
    """The largest distance along edges between any two points, from all pairs."""
    everything = np.arange(shape.n_points)
    first, second = (grid.ravel() for grid in np.meshgrid(everything, everything))
    return brute_force(shape, first, second).max()


def test_a_map_that_abstains_everywhere_counts_as_the_diameter(family):
    def nothing(source, target):
        return np.full(BASE_POINTS, -1)

    found = evaluate(Stub(nothing), family.folder, ALL)
    figures = found.to_dict()
    assert figures["unmatched_points"] == len(found.errors)
    assert figures["mean_geodesic_error_of_matched_points"] is figures["least_confident_fifth_error_share"] is None
    for pair in found.pairs:
        assert len(set(pair.errors)) == 1 and pair.errors[0] > 0.5
    json.dumps(figures, allow_nan=False)


def test_clouds_are_measured_on_the_mesh(family, shifted):
    plain = evaluate(Stub(shifted), family.folder, ALL)
    for modality, noise in (("cloud", 0.0), ("cloud", 0.02), ("mesh-to-cloud", 0.02), ("cloud-to-mesh", 0.0)):
        found = evaluate(Stub(shifted), family.folder, Protocol(modality=modality, split="all", noise=noise))
        np.testing.assert_array_equal(found.errors, plain.errors)


@pytest.mark.parametrize(
    ("modality", "noise", "expected"),
    [
        ("mesh", 0.0, {(name, False): 1 for name in COMMON}),
        ("cloud", 0.0, {(name, True): 1 for name in COMMON}),
        # By the list of pairs, d is a source and a target; so is every other one.
        ("cloud", 0.01, {("a", True): 2, ("b", True): 2, ("c", True): 2, ("d", True): 2, ("e", True): 2}),
        ("mesh-to-cloud", 0.0, {(name, cloud): 1 for name in COMMON for cloud in (False, True)}),
        ("cloud-to-mesh", 0.01, {(name, cloud): 1 for name in COMMON for cloud in (False, True)}),
    ],
)
def test_every_shape_is_prepared_once_per_role_that_differs(family, modality, noise, expected):
    stub = Stub(family.truth)
    found = evaluate(stub, family.folder, Protocol(modality=modality, split="all", noise=noise))
    counts = {}
    for shape, as_cloud, scale in stub.prepared:
        name = shape.name.removesuffix(".off")
        counts[name, as_cloud] = counts.get((name, as_cloud), 0) + 1
        np.testing.assert_array_equal(shape.faces, family.shapes[name].faces)
        if as_cloud and noise:
            assert scale == pytest.approx(np.sqrt(brute_area(family.shapes[name])))
        else:
            assert scale is None
            np.testing.assert_array_equal(shape.points, family.shapes[name].points)
    assert counts == expected
    source, _, target = modality.partition("-to-")
    assert found.method == f"{source}, {target or source}"


def noise_of(family, protocol):
    """The noise on each prepared cloud, in units of sqrt(area); two of each name: as source and as target."""
    stub = Stub(family.truth)
    evaluate(stub, family.folder, protocol)
    return {
        (shape.name, number): (shape.points - family.shapes[shape.name.removesuffix(".off")].points) / scale
        for number, (shape, as_cloud, scale) in enumerate(stub.prepared)
        if as_cloud
    }


def test_noise_has_its_size_in_units_of_the_normalised_shape(family):
    for sigma in (0.01, 0.05):
        noise = noise_of(family, Protocol(modality="cloud", split="all", noise=sigma))
        assert len(noise) == 10
        for added in noise.values():
            assert added.std() == pytest.approx(sigma, rel=0.12)
            np.testing.assert_allclose(added.std(axis=0), sigma, rtol=0.25)
            assert abs(added.mean()) < 0.2 * sigma


def test_noise_is_independent_between_shapes_and_roles(family):
    noise = list(noise_of(family, TINY).values())
    for i in range(len(noise)):
        for j in range(i):
            correlation = np.corrcoef(noise[i].ravel(), noise[j].ravel())[0, 1]
            assert abs(correlation) < 0.2


def test_noise_follows_the_seed(family):
    first, second = noise_of(family, TINY), noise_of(family, TINY)
    other = noise_of(family, Protocol(split="all", modality="cloud", noise=0.01, seed=1))
    for key, added in first.items():
        np.testing.assert_array_equal(added, second[key])
        assert abs(np.corrcoef(added.ravel(), other[key].ravel())[0, 1]) < 0.2


def test_noise_does_not_depend_on_what_else_is_evaluated(family, tmp_path):
    (tmp_path / "one.txt").write_text("c,b\n")
    alone = noise_of(family, Protocol(modality="cloud", noise=0.01, pairs_file=str(tmp_path / "one.txt")))
    together = list(noise_of(family, TINY).values())
    assert len(alone) == 2
    for added in alone.values():
        assert any(np.array_equal(added, other) for other in together)


def test_meshes_get_no_noise(family):
    stub = Stub(family.truth)
    evaluate(stub, family.folder, Protocol(modality="mesh-to-cloud", split="all", noise=0.05))
    for shape, as_cloud, scale in stub.prepared:
        moved = np.abs(shape.points - family.shapes[shape.name.removesuffix(".off")].points).max()
        assert (moved > 0.05 * scale) if as_cloud else (moved == 0)


def test_progress_counts_to_its_total(family):
    told = []
    evaluate(Stub(family.truth), family.folder, TINY, progress=lambda *state: told.append(state))
    assert [done for done, _, _ in told] == list(range(len(told)))
    assert {total for _, total, _ in told} == {len(told)} == {10 + 8}
    assert told[-1][2] == "e - e"


def test_pairs_file(family, tmp_path):
    (tmp_path / "mine.txt").write_text("c,a\n")
    stub = Stub(family.truth)
    found = evaluate(stub, family.folder, Protocol(pairs_file=str(tmp_path / "mine.txt")))
    assert stub.matched == [("c", "a")]
    assert sorted(shape.name for shape, *_ in stub.prepared) == ["a.off", "c.off"]
    assert len(found.errors) == 90


@pytest.mark.parametrize("modality", ["mesh", "cloud", "mesh-to-cloud"])
def test_the_real_matcher_takes_the_same_road(make, tmp_path, modality):
    """Relabelled copies of one blob: the axiomatic method finds nearly every point."""
    blob = make.blob(2)
    (tmp_path / "off").mkdir()
    (tmp_path / "corres").mkdir()
    for seed, name in enumerate(("one", "two")):
        order = np.random.default_rng(seed).permutation(blob.n_points)
        copy = make.relabelled(blob, order)
        write_shape(tmp_path / "off" / f"{name}.off", Shape(copy.points * (1 + 9 * seed), copy.faces))
        (tmp_path / "corres" / f"{name}.vts").write_text("\n".join(map(str, np.argsort(order) + 1)))
    matcher = Matcher(settings=MatcherSettings(method="axiomatic"), device="cpu", operators=compute_operators)
    figures = evaluate(matcher, ShapeFolder.open(tmp_path), Protocol(modality=modality)).to_dict()
    assert figures["method"] == "axiomatic"
    assert len(figures["pairs"]) == 4
    assert figures["mean_geodesic_error"] < 0.5
    assert figures["pck_auc"] > 0.98


def soiled(shape):
    """A mesh with points that are NaN, far away and in no face, or there twice, and faces that do not fit."""
    n = shape.n_points
    points = np.concatenate([shape.points, [[np.nan] * 3, [1e7, 0, 0]], shape.points[:1]])
    second = np.where(shape.faces[:9] == 0, n + 2, shape.faces[:9])
    faces = [*second, *shape.faces[9:], [0, 1, n + 3], [1, 2, n], [0, 1, n + 2], [5, 5, 6]]
    return Shape(points, faces, name=shape.name, allow_broken=True)


@pytest.fixture
def soiled_folder(family, tmp_path):
    root = copied(family, tmp_path)
    for name, shape in family.shapes.items():
        write_shape(root / "off" / f"{name}.off", soiled(shape))
    return ShapeFolder.open(root)


def test_the_scale_is_that_of_the_repaired_shape(family, soiled_folder):
    stub = Stub(family.truth)
    evaluate(stub, soiled_folder, TINY)
    assert len(stub.prepared) == 10
    for shape, _, scale in stub.prepared:
        clean = family.shapes[shape.name.removesuffix(".off")]
        assert scale == pytest.approx(np.sqrt(brute_area(clean)))
        assert (shape.points[:BASE_POINTS] - clean.points).std() == pytest.approx(0.01 * scale, rel=0.12)


def test_errors_are_those_on_the_repaired_shape(family, soiled_folder, shifted):
    found = evaluate(Stub(shifted), soiled_folder, ALL)
    for pair, expected in zip(found.pairs, expected_errors(family, shifted, family.folder.pairs("all")), strict=True):
        np.testing.assert_allclose(pair.errors, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("modality", "as_cloud"), [("mesh", None), ("cloud", "both"), ("mesh-to-cloud", "target")])
def test_pairs_are_matched_as_by_themselves(soiled_folder, monkeypatch, modality, as_cloud):
    matcher, found = Matcher(settings=MatcherSettings(method="axiomatic"), device="cpu"), []
    expected = matcher.match(soiled_folder.shape("a"), soiled_folder.shape("b"), as_cloud=as_cloud)
    find = Matcher.find
    monkeypatch.setattr(Matcher, "find", lambda *given: found.append(find(*given)) or found[-1])
    (soiled_folder.root / "pairs.txt").write_text("a,b\n")
    evaluate(matcher, soiled_folder, Protocol(modality=modality))
    np.testing.assert_array_equal(found[0].target_to_source, expected.target_to_source)
    np.testing.assert_array_equal(found[0].target_confidence, expected.target_confidence)


@pytest.mark.parametrize(("least", "doubtful"), [(0.0, 0), (1.0, 4)])
def test_the_settings_say_which_matches_are_doubtful(family, least, doubtful):
    warnings = WarningSettings(least_confidence=least, most_dirichlet_energy=1e9)
    matcher = Matcher(settings=MatcherSettings(method="axiomatic", warnings=warnings), device="cpu")
    assert evaluate(matcher, family.folder, Protocol(split="all", n_pairs=4)).n_doubtful == doubtful


# ---- pairs drawn at random


def test_drawn_pairs_are_scored(family):
    stub = Stub(family.truth)
    found = evaluate(stub, family.folder, Protocol(split="all", n_pairs=4, seed=2))
    assert len(set(stub.matched)) == 4
    assert set(stub.matched) < {("a", "b"), ("b", "a"), ("c", "b"), ("a", "c"), ("d", "e"), ("e", "d")}
    assert [(pair["source"], pair["target"]) for pair in found.to_dict()["pairs"]] == stub.matched
    with pytest.raises(ArgumentError, match=r"n_pairs is 7, but must be from 1 to the number of pairs .*, 6"):
        evaluate(Stub(never), family.folder, Protocol(split="all", n_pairs=7))


# ---- geodesic errors


def test_geodesic_errors_match_brute_force(make):
    blob = make.blob(2)
    rng = np.random.default_rng(0)
    truth, mapped = rng.integers(0, BASE_POINTS, (2, 300))
    np.testing.assert_allclose(geodesic_errors(blob, truth, mapped), brute_force(blob, truth, mapped), rtol=1e-9)
    larger = Shape(blob.points * 50 + 7, blob.faces)
    np.testing.assert_allclose(geodesic_errors(larger, truth, mapped), brute_force(blob, truth, mapped), rtol=1e-9)


def test_between_pieces_the_straight_distance_counts(make):
    ball = make.sphere(1)
    both = make.joined([ball, Shape(ball.points + np.array([10, 0, 0]), ball.faces)])
    area = 2 * brute_area(ball)
    truth, mapped = np.array([0, 5, 3]), np.array([42, 47, 3])
    np.testing.assert_allclose(geodesic_errors(both, truth, mapped), np.array([10, 10, 0]) / np.sqrt(area))


def test_triangles_that_are_not_joined_are_joined_first(make):
    blob = make.blob(2)
    apart = Shape(blob.points[blob.faces].reshape(-1, 3), np.arange(3 * blob.n_faces).reshape(-1, 3))
    corner = np.random.default_rng(0).integers(0, apart.n_points, (2, 300))
    truth, mapped = blob.faces.ravel()[corner]
    np.testing.assert_allclose(geodesic_errors(apart, *corner), brute_force(blob, truth, mapped), rtol=1e-9)


def test_from_a_point_in_no_face_the_straight_distance_counts(make):
    ball = make.sphere(1)
    stray = Shape(np.concatenate([ball.points, [[0, 30, 40]]]), ball.faces)
    expected = np.array([np.linalg.norm(ball.points[3] - [0, 30, 40]), 0]) / np.sqrt(brute_area(ball))
    np.testing.assert_allclose(geodesic_errors(stray, np.array([42, 5]), np.array([3, 5])), expected)


def brute_area(shape):
    a, b, c = (shape.points[shape.faces[:, corner]] for corner in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def test_geodesic_errors_need_a_surface(make):
    with pytest.raises(DataError, match="cloudy has no faces"):
        geodesic_errors(Shape(make.sphere(1).points, name="cloudy"), np.array([0]), np.array([1]))


# ---- what can be wrong


def copied(family, tmp_path):
    root = tmp_path / "copy"
    for path in family.folder.root.rglob("*.*"):
        target = root / path.relative_to(family.folder.root)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(path.read_bytes())
    return root


def never(*args):
    raise AssertionError("a shape was matched")


def test_ground_truth_beyond_the_shape(family, tmp_path):
    root = copied(family, tmp_path)
    (root / "corres" / "b.vts").write_text("1\n" * 89 + "163\n")
    with pytest.raises(DataError, match=r"b\.vts names vertex 163, but the shape has 162"):
        evaluate(Stub(never), ShapeFolder.open(root), ALL)
    (root / "corres" / "b.vts").write_text("1\n" * 89 + "162\n")
    evaluate(Stub(family.truth), ShapeFolder.open(root), ALL)


def test_ground_truth_at_a_point_that_is_nowhere(soiled_folder):
    (soiled_folder.root / "corres" / "b.vts").write_text("1\n" * 89 + f"{BASE_POINTS + 1}\n")
    with pytest.raises(DataError, match=rf"b\.vts names vertex {BASE_POINTS + 1}, which is NaN or infinite") as caught:
        evaluate(Stub(never), soiled_folder, ALL)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("protocol", [Protocol(split="all", partial=True), replace(TINY, partial=True)])
def test_a_part_takes_the_scale_of_each_of_its_complete_shapes(family, tmp_path, protocol):
    root = copied(family, tmp_path)
    (root / "pairs.txt").write_text("a,b\nc,b\na,c\na,a\n")
    stub = Stub(family.truth)
    found = evaluate(stub, ShapeFolder.open(root), protocol)
    assert np.all(found.errors == 0)
    assert stub.matched == [("a", "b"), ("c", "b"), ("a", "c"), ("a", "a")]
    assert stub.partial == ["target"] * 4
    unit = {name: np.sqrt(face_areas(shape.points, shape.faces).sum()) for name, shape in family.shapes.items()}
    prepared = [(shape.name.removesuffix(".off"), scale) for shape, _, scale in stub.prepared]
    # Without noise a complete shape's own scale is left to the matcher, and source and target a are one.
    expected = [("a", "a"), ("b", "a"), ("c", "c"), ("b", "c"), ("c", "a"), *([("a", "a")] if protocol.noise else [])]
    assert [name for name, _ in prepared] == [name for name, _ in expected]
    for (name, scale), (_, scaled_by) in zip(prepared, expected, strict=True):
        own = name == scaled_by and not protocol.noise
        assert scale is None if own else scale == pytest.approx(unit[scaled_by], rel=1e-9)


def test_parts_in_place_take_the_middle_of_their_complete_shapes_too(family, tmp_path):
    root = copied(family, tmp_path)
    (root / "pairs.txt").write_text("a,b\nc,b\n")
    stub = Stub(family.truth)
    evaluate(stub, ShapeFolder.open(root), Protocol(split="all", partial=True, pre_aligned=True))
    middle = {name: shape.points.mean(axis=0) for name, shape in family.shapes.items()}
    names = [shape.name.removesuffix(".off") for shape, _, _ in stub.prepared]
    assert names == ["a", "b", "c", "b"]
    assert stub.centres[0] is None and stub.centres[2] is None
    np.testing.assert_allclose(stub.centres[1], middle["a"], atol=1e-9)
    np.testing.assert_allclose(stub.centres[3], middle["c"], atol=1e-9)
    with pytest.raises(ArgumentError, match="pre_aligned is for parts, but partial is False"):
        Protocol(pre_aligned=True)


def test_common_points_that_a_part_lacks_are_not_scored(family, tmp_path):
    """Ten lines of one shape and five others of the other are none: 75 of 90 points are scored, as in the whole."""
    root = copied(family, tmp_path)
    whole = evaluate(Stub(family.truth), ShapeFolder.open(root), Protocol(split="all", pairs_file=root / "pairs.txt"))
    for name, lacking in (("a", range(10)), ("b", range(40, 45))):
        lines = (root / "corres" / f"{name}.vts").read_text().split()
        (root / "corres" / f"{name}.vts").write_text(
            "\n".join("-1" if i in lacking else x for i, x in enumerate(lines))
        )
    found = evaluate(Stub(family.truth), ShapeFolder.open(root), Protocol(split="all", pairs_file=root / "pairs.txt"))
    kept = np.setdiff1d(np.arange(90), [*range(10), *range(40, 45)])
    by_pair = {pair.pair: pair for pair in found.pairs}
    for pair in whole.pairs:
        if pair.pair in (("a", "b"), ("b", "a")):
            assert np.array_equal(by_pair[pair.pair].errors, pair.errors[kept])
    assert found.matched.all()


def test_unequal_numbers_of_lines(family, tmp_path):
    root = copied(family, tmp_path)
    (root / "corres" / "b.vts").write_text("1\n" * 89)
    stub = Stub(never)
    with pytest.raises(DataError, match=r"a has 90 template points and b 89; every \.vts"):
        evaluate(stub, ShapeFolder.open(root), ALL)
    assert stub.prepared == []


def test_a_shape_that_cannot_be_read(family, tmp_path):
    root = copied(family, tmp_path)
    (root / "off" / "c.off").write_text("OFF\n1 2")
    with pytest.raises(ValueError, match=r"c\.off"):
        evaluate(Stub(never), ShapeFolder.open(root), ALL)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"modality": "clouds"}, "modality is 'clouds'.*did you mean 'cloud'"),
        ({"modality": "cloud", "noise": -0.1}, "noise is -0.1"),
        ({"modality": "cloud", "noise": float("nan")}, "noise is nan"),
        ({"modality": "cloud", "noise": float("inf")}, "noise is inf"),
        ({"noise": 0.01}, "noise is for clouds, but modality is 'mesh'"),
    ],
)
def test_protocols_that_make_no_sense(settings, said):
    with pytest.raises(ArgumentError, match=said):
        Protocol(**settings)


@pytest.mark.parametrize(
    ("modality", "source", "target"),
    [("mesh", False, False), ("cloud", True, True), ("mesh-to-cloud", False, True), ("cloud-to-mesh", True, False)],
)
def test_who_is_a_cloud(modality, source, target):
    protocol = Protocol(modality=modality)
    assert (protocol.is_cloud("source"), protocol.is_cloud("target")) == (source, target)


def pair_of(error, confidence, *, flipped=None):
    """A pair of two points with this mean error; coverage is the same for all, energy grows with the error."""
    side = Quality(1.0, 0.1 if error < 5 else 0.05, error**3, flipped, confidence)
    errors = np.array([error - 0.5, error + 0.5])
    return PairErrors(("a", "b"), errors, np.ones(2, bool), np.ones(2), quality=MapQuality(side, side))


def test_figures_of_quality_are_ranked_against_the_errors():
    errors = np.random.default_rng(0).permutation(12) + 1.0
    found = Evaluation(tuple(pair_of(error, -np.exp(error)) for error in errors), "nearest-features", {})
    correlations = found.to_dict()["quality_rank_correlations"]
    assert correlations["dirichlet_energy"] == pytest.approx(1)
    assert correlations["confidence"] == pytest.approx(-1)
    assert correlations["coverage"] is correlations["flipped_triangles"] is None
    # Ranks 1 to 12 against eight and four that tie.
    ranks, tied = np.arange(1, 13), np.where(np.arange(1, 13) < 5, 10.5, 4.5)
    assert correlations["cycle_error"] == pytest.approx(np.corrcoef(ranks, tied)[0, 1])
    assert found.to_dict()["pairs"][0]["quality"]["source"]["coverage"] == 1


def test_few_pairs_are_not_ranked_nor_those_that_say_nothing(family):
    few = Evaluation(tuple(pair_of(error, 0.5) for error in np.arange(1.0, 10)), "nearest-features", {})
    assert "quality_rank_correlations" not in few.to_dict()
    silent = evaluate(Stub(family.truth), family.folder, ALL).to_dict()
    assert "quality" not in silent["pairs"][0]


def test_landmarks_are_points_of_the_truth_that_are_not_scored(family):
    known = {}

    class Recording(Stub):
        def find(self, pair):
            known[pair.source.name, pair.target.name] = pair.options.landmarks
            return super().find(pair)

    stub, listed = Recording(lambda source, target: np.zeros(BASE_POINTS, dtype=int)), family.folder.root / "pairs.txt"
    plain = evaluate(stub, family.folder, Protocol(pairs_file=str(listed)))
    guided = evaluate(stub, family.folder, Protocol(landmarks=4, pairs_file=str(listed)))
    for one, whole in zip(guided.pairs, plain.pairs, strict=True):
        assert len(one.errors) == len(whole.errors) - 4
        assert np.isin(one.errors, whole.errors).all()
    landmarks = known["a", "b"]
    assert len(set(landmarks.source)) == 4
    np.testing.assert_array_equal(family.truth("a", "b")[list(landmarks.target)], landmarks.source)
    # They lie far apart: farther than four neighbours would.
    points = family.shapes["a"].points[list(landmarks.source)]
    gaps = np.linalg.norm(points[:, None] - points[None], axis=2)[np.triu_indices(4, 1)]
    assert gaps.min() > 0.3 * np.ptp(family.shapes["a"].points, axis=0).max()


@pytest.mark.parametrize(
    ("count", "match", "said"), [(31, None, "landmarks is 31, but d - e has 31 points"), (2, print, "landmarks guide")]
)
def test_landmarks_that_cannot_be_taken_are_refused(family, count, match, said):
    protocol = Protocol(landmarks=count, pairs_file=str(family.folder.root / "pairs.txt"))
    with pytest.raises(ArgumentError) as refused:
        evaluate(None if match else Stub(None), family.folder, protocol, match=match)
    assert said in str(refused.value)
