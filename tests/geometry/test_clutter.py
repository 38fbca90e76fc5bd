"""What does not belong to a shape, against shapes to which known points were added."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.distance import cdist

import homolog
from homolog import Shape, repair
from homolog.geometry import ClutterSettings, find_clutter, set_apart
from homolog.geometry.clutter import _apart
from homolog.geometry.outliers import noise_level
from homolog.shapes import add_noise
from homolog.synthesis.degradation import add_strays

MATCHER = homolog.MatcherSettings(method="axiomatic")


@pytest.fixture(scope="module")
def body():
    return repair(homolog.demo_shapes()[0]).shape


def box(body, share, seed=0):
    points = body.points
    return np.random.default_rng(seed).uniform(points.min(axis=0), points.max(axis=0), (round(share * len(points)), 3))


def floor(body, seed=0, wide=2.0):
    low, high = body.points.min(axis=0), body.points.max(axis=0)
    half = wide * (high - low) / 2
    found = (low + high) / 2 + half * np.random.default_rng(seed).uniform(-1, 1, (len(body.points), 3))
    found[:, 1] = low[1]
    return found


def with_points(body, *others):
    return Shape(np.concatenate([body.points, *others]))


def scores(shape, n_own):
    """Precision and recall of what is set apart, given that the first points are the shape's own."""
    found = set_apart(repair(shape)).clean_index < 0
    true = np.arange(shape.n_points) >= n_own
    return (found & true).sum() / max(1, found.sum()), (found & true).sum() / true.sum()


@pytest.mark.parametrize("sigma", [None, 0.0, 0.003, 0.01, 0.02])
def test_nothing_is_set_apart_from_a_body(body, sigma):
    scale = np.sqrt(homolog.geometry.surface_area(body))
    shape = body if sigma is None else add_noise(body.as_cloud(), sigma * scale, seed=0)
    repaired = repair(shape)
    assert set_apart(repaired) is repaired


@pytest.mark.parametrize("share", [0.01, 0.1, 0.3])
def test_outliers_in_the_box_are_found(body, share):
    precision, recall = scores(with_points(body, box(body, share)), body.n_points)
    assert precision > 0.97 and recall > 0.85


@pytest.mark.parametrize("spacing", [2, 4])
def test_nothing_is_set_apart_from_a_sparse_cloud(body, spacing):
    cloud = Shape(body.points[np.random.default_rng(0).permutation(body.n_points)[::spacing]])
    assert not find_clutter(cloud).points.any()


@pytest.mark.parametrize(
    ("kind", "share", "least"), [("clusters", 0.1, 0.85), ("clusters", 0.3, 0.85), ("near", 0.3, 0.4)]
)
def test_clusters_and_points_near_the_surface_are_found_where_they_can_be(body, kind, share, least):
    unit = float(np.sqrt(homolog.geometry.surface_area(body)))
    precision, recall = scores(add_strays(body, share, kind=kind, unit=unit, seed=0), body.n_points)
    assert precision > 0.97 and recall > least


def test_noise_is_not_told_by_outliers(body):
    unit = float(np.sqrt(homolog.geometry.surface_area(body)))
    cloud = add_strays(body, 0.3, kind="near", unit=unit, seed=0)
    noisy = add_noise(body.as_cloud(), 0.004 * unit, seed=0)
    assert noise_level(body.points) == noise_level(cloud.points) == 0 < noise_level(noisy.points)


def test_limbs_of_a_view_are_no_clusters(body):
    speck = trimesh.creation.icosphere(subdivisions=1, radius=0.02).vertices + body.points.max(axis=0)
    cloud = with_points(body, speck)
    assert find_clutter(cloud).points[body.n_points :].all()
    assert not find_clutter(cloud, partial=True).points.any()


@pytest.mark.parametrize("wide", [1.5, 2.0, 5.0])
def test_a_floor_is_found_and_feet_stay(body, wide):
    scan = with_points(body, floor(body, wide=wide))
    precision, recall = scores(scan, body.n_points)
    assert recall > 0.999 and precision > 0.98
    (finding,) = set_apart(repair(scan)).report.findings
    assert (finding.rule, finding.severity) == ("points of a plane", "repaired")
    assert finding.count >= body.n_points


def test_a_floor_is_found_among_outliers(body):
    precision, recall = scores(with_points(body, floor(body), box(body, 0.1)), body.n_points)
    assert precision > 0.98 and recall > 0.97


def test_a_wall_is_found(body):
    wall = floor(body)[:, [0, 2, 1]] * [1, 2, 1]
    wall[:, 2] = body.points[:, 2].min() - 0.2
    wall[:, 1] += body.points[:, 1].mean() - wall[:, 1].mean()
    precision, recall = scores(with_points(body, wall), body.n_points)
    assert precision > 0.99 and recall > 0.999


def test_a_floor_of_two_triangles_is_found(body):
    low = body.points[:, 1].min() - 1e-3
    corners = np.array([[-4.0, low, -4], [4, low, -4], [4, low, 4], [-4, low, 4]])
    n = body.n_points
    faces = np.concatenate([body.faces, [[n, n + 2, n + 1], [n, n + 3, n + 2]]])
    repaired = set_apart(repair(Shape(np.concatenate([body.points, corners]), faces)))
    assert (repaired.clean_index < 0).nonzero()[0].tolist() == [n, n + 1, n + 2, n + 3]
    np.testing.assert_array_equal(repaired.shape.faces, body.faces)
    assert repaired.report.area == pytest.approx(homolog.geometry.surface_area(body))


def sampled(mesh, n=5000):
    return Shape(trimesh.sample.sample_surface(mesh, n, seed=0)[0])


def test_flat_parts_of_an_object_stay():
    crate = trimesh.creation.box([1, 1, 1])
    legs = [
        trimesh.creation.box([0.1, 1, 0.1]).apply_translation([x, -0.5, z]) for x in (-0.7, 0.7) for z in (-0.3, 0.3)
    ]
    table = trimesh.util.concatenate([trimesh.creation.box([1.8, 0.05, 1]), *legs])
    for mesh in (crate, table):
        for shape in (sampled(mesh), Shape(mesh.vertices, mesh.faces)):
            assert not any(plane.any() for plane in find_clutter(shape).planes)


def test_an_object_at_a_distance_is_set_apart_and_a_near_one_stays(body):
    for distance, is_apart in ((0.6, True), (0.0, False)):
        ball = trimesh.creation.icosphere(subdivisions=3, radius=0.1)
        ball.apply_translation([body.points[:, 0].max() + 0.1 + distance, body.points[:, 1].mean(), 0])
        both = Shape(
            np.concatenate([body.points, ball.vertices]), np.concatenate([body.faces, ball.faces + body.n_points])
        )
        for shape in (both, both.as_cloud()) if is_apart else (both,):
            left_out = set_apart(repair(shape)).clean_index < 0
            assert not left_out[: body.n_points].any()
            assert (left_out[body.n_points :] == is_apart).all()
            assert not (set_apart(repair(shape), partial=True).clean_index < 0).any()


def test_indices_lead_back_to_the_file(body):
    scan = Shape(np.concatenate([[[np.nan] * 3], floor(body), body.points, body.points[:1]]), allow_broken=True)
    repaired = set_apart(repair(scan))
    np.testing.assert_array_equal(repaired.shape.points, scan.points[repaired.kept])
    kept = repaired.clean_index[repaired.clean_index >= 0]
    np.testing.assert_array_equal(repaired.shape.points[kept], scan.points[repaired.clean_index >= 0])
    assert repaired.clean_index[0] == -1
    assert repaired.clean_index[-1] == repaired.clean_index[body.n_points + 1]


def test_settings_move_the_bounds(body):
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.05).vertices + body.points.max(axis=0) + 0.3
    scan = with_points(body, ball)
    apart = [find_clutter(scan, settings).objects for settings in (ClutterSettings(), ClutterSettings(gap=5.0))]
    assert [each[body.n_points :].mean() for each in apart] == [1, 0]
    settings = homolog.MatcherSettings(method="axiomatic", clutter=ClutterSettings(gap=5.0))
    kept, left_out = (homolog.Matcher(settings=each).preprocess(scan) for each in (settings, MATCHER))
    assert kept.repaired.kept.size == scan.n_points > left_out.repaired.kept.size
    assert settings.to_dict()["clutter"]["gap"] == 5.0


@pytest.mark.slow
def test_a_match_leaves_them_without_counterpart_unless_they_are_kept(body):
    scan = with_points(body, box(body, 0.1))
    matches = {how: homolog.match(body, scan, method="axiomatic", clutter=how) for how in ("remove", "keep")}
    assert (matches["keep"].target_to_source >= 0).all()
    apart = matches["remove"].target_to_source < 0
    assert apart[body.n_points :].mean() > 0.85 and apart[: body.n_points].mean() < 0.01
    rules = [finding["rule"] for finding in matches["remove"].report["inputs"]["target"]["findings"]]
    assert "outliers" in rules


def test_which_components_lie_apart_is_told_as_by_all_distances():
    """However few positions are looked at first, and where a gap is missed or kept by little."""
    random = np.random.default_rng(0)
    for _ in range(40):
        centres = random.uniform(0, 3, (6, 1, 3))
        positions = (centres + random.uniform(0, 0.5, (6, 80, 3))).reshape(-1, 3)
        component, sizes = np.repeat(np.arange(6), 80), random.uniform(0.5, 9, 6)
        distances = cdist(positions, positions).reshape(6, 80, 6, 80).min(axis=(1, 3))
        off = distances[distances > 0]
        gap = float(random.choice(off)) * random.choice([1 - 1e-9, 1 + 1e-9, 0.97, 1.03])
        joined = {int(sizes.argmax())}
        while more := {b for a in joined for b in range(6) if distances[a, b] <= gap} - joined:
            joined |= more
        expected = [each not in joined and bool(sizes[each] < 0.7 * sizes.max()) for each in range(6)]
        assert _apart(positions, component, sizes, gap, 0.7).tolist() == expected
