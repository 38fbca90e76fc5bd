"""Repair changes what it must, nothing else, and knows the way back."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from homolog.core.errors import ArgumentError, ShapeError
from homolog.shapes import Shape, add_noise, check, repair


def sphere():
    mesh = trimesh.creation.icosphere(subdivisions=2)
    return Shape(mesh.vertices, mesh.faces, name="ball")


def dirty():
    """A sphere behind a NaN, with an unused point and a copy of a point in use among its own."""
    ball = sphere()
    points = np.concatenate([[[np.nan] * 3], ball.points, [[9, 9, 9]], ball.points[[4]]])
    faces = ball.faces + 1
    faces = np.concatenate([faces, [[0, 1, 2]], faces[:1]])
    faces[faces == 5] = [5, 164, 164, 164, 5][: np.sum(faces == 5)] if np.sum(faces == 5) == 5 else 164
    return Shape(points, faces, name="dirty")


def test_clean_shape_comes_back_identical():
    for shape in (sphere(), sphere().as_cloud()):
        repaired = repair(shape)
        assert repaired.shape is shape
        np.testing.assert_array_equal(repaired.kept, np.arange(shape.n_points))
        np.testing.assert_array_equal(repaired.clean_index, np.arange(shape.n_points))


def test_the_way_back():
    repaired = repair(dirty())
    np.testing.assert_array_equal(repaired.shape.points, sphere().points)
    np.testing.assert_array_equal(repaired.shape.faces, sphere().faces)
    assert repaired.shape.name == "dirty"
    np.testing.assert_array_equal(repaired.kept, np.arange(1, 163))
    assert repaired.clean_index[0] == -1
    assert repaired.clean_index[163] == -1
    assert repaired.clean_index[164] == repaired.clean_index[5] == 4
    values = repaired.to_original(repaired.shape.points)
    np.testing.assert_array_equal(values[1:163], dirty().points[1:163])
    np.testing.assert_array_equal(values[164], dirty().points[5])
    assert np.isnan(values[[0, 163]]).all()


def test_values_of_every_kind_go_back():
    repaired = repair(dirty())
    assert repaired.to_original(np.arange(162))[0] == -1
    assert repaired.to_original(np.arange(162), fill=7)[0] == 7
    assert repaired.to_original(np.ones(162, bool))[0] == False  # noqa: E712
    assert repaired.to_original(np.ones((162, 4, 2), np.float32)).shape == (165, 4, 2)
    assert repaired.to_original(np.ones(162, np.uint8)).dtype == np.uint8
    with pytest.raises(ArgumentError, match="one per clean point"):
        repaired.to_original(np.arange(161))


def test_maps_go_back_on_both_sides():
    source, target = repair(dirty()), repair(sphere())
    back = source.original_map(np.arange(162), target)
    np.testing.assert_array_equal(back, source.clean_index)
    forth = target.original_map(np.append(np.arange(161), -1), source)
    np.testing.assert_array_equal(forth, [*range(1, 162), -1])
    np.testing.assert_array_equal(source.original_index(np.array([[0, -1], [161, 3]])), [[1, -1], [162, 4]])
    for wrong in ([162], [-2]):
        with pytest.raises(ArgumentError, match="from -1 to 161"):
            source.original_index(np.array(wrong))


def test_nothing_of_the_caller_changes():
    shape = dirty()
    before = shape.points.copy(), shape.faces.copy()
    repair(shape)
    np.testing.assert_array_equal(shape.points, before[0])
    np.testing.assert_array_equal(shape.faces, before[1])


@pytest.mark.parametrize(
    ("points", "faces", "words"),
    [
        (np.eye(5, 3), [[0, 1, 9]], "as a cloud"),
        (np.eye(5, 3), [[3, 4, 0], [0, 0, 1]], "as a cloud"),
        (np.eye(3), None, "at least 4"),
        (np.ones((9, 3)), None, "at least 4"),
        (np.arange(9.0)[:, None] * [1, 1, 1], None, "one line"),
        (np.eye(5, 3) * 1e200, None, "other units"),
    ],
)
def test_beyond_repair(points, faces, words):
    with pytest.raises(ShapeError, match=words) as caught:
        repair(Shape(points, faces, name="scan.ply", allow_broken=True))
    assert str(caught.value).startswith("scan.ply cannot be used")
    assert "\n" not in str(caught.value)


COORDINATE = st.sampled_from([0.0, -0.0, 1.0, 2.0, 0.5, np.nan, np.inf])
POINTS = st.lists(st.tuples(COORDINATE, COORDINATE, COORDINATE), min_size=1, max_size=14)
CORNER = st.integers(-1, 14)
FACES = st.none() | st.lists(st.tuples(CORNER, CORNER, CORNER), max_size=16)


@settings(derandomize=True, deadline=None, max_examples=400)
@given(POINTS, FACES)
def test_any_shape(points, faces):
    faces = None if faces is None else np.reshape(faces, (-1, 3)).astype(int)
    shape = Shape(np.reshape(points, (-1, 3)), faces, allow_broken=True)
    report = check(shape)
    if not report.usable:
        with pytest.raises(ShapeError):
            repair(shape)
        return
    once = repair(shape)
    assert once.report == report
    # Repairing twice is repairing once.
    twice = repair(once.shape)
    assert twice.shape is once.shape
    assert twice.report.is_clean
    # Each clean point is an original one, and each original one that is left leads to an equal clean one.
    np.testing.assert_array_equal(once.shape.points, shape.points[once.kept])
    left = once.clean_index >= 0
    np.testing.assert_array_equal(once.shape.points[once.clean_index[left]], shape.points[left])
    np.testing.assert_array_equal(once.clean_index[once.kept], np.arange(len(once.kept)))
    assert np.all(np.diff(once.kept) > 0)
    assert len(np.unique(once.shape.points + 0.0, axis=0)) == once.shape.n_points
    if faces is not None:
        clean = np.sort(once.shape.faces, axis=1)
        assert len(np.unique(clean, axis=0)) == len(clean)
        np.testing.assert_array_equal(np.unique(clean), np.arange(once.shape.n_points))
        assert len(faces) - len(clean) == sum(
            f.count for f in report.findings if f.severity == "repaired" and "face" in f.rule
        )


@settings(derandomize=True, deadline=None, max_examples=100)
@given(st.lists(st.tuples(COORDINATE, COORDINATE, COORDINATE), min_size=1, max_size=30))
def test_clouds_against_a_plain_loop(points):
    seen, expected = {}, []
    for point in points:
        usable = all(np.isfinite(point))
        expected.append(seen.setdefault(tuple(x + 0.0 for x in point), len(seen)) if usable else -1)
    shape = Shape(points)
    if check(shape).usable:
        assert repair(shape).clean_index.tolist() == expected


def test_a_million_points_take_seconds():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(1_000_000, 3))
    points[500_000:500_100] = points[:100]
    repaired = repair(Shape(points))
    assert repaired.shape.n_points == 999_900
    np.testing.assert_array_equal(repaired.clean_index[500_000:500_100], np.arange(100))


def test_noise_has_the_spread_asked_for():
    cloud = Shape(np.zeros((20_000, 3)))
    noise = add_noise(cloud, 0.3, seed=1).points
    np.testing.assert_allclose(noise.std(axis=0), 0.3, rtol=0.03)
    np.testing.assert_allclose(noise.mean(axis=0), 0, atol=0.01)
    np.testing.assert_array_equal(noise, add_noise(cloud, 0.3, seed=1).points)
    assert not np.array_equal(noise, add_noise(cloud, 0.3, seed=2).points)


def test_noise_keeps_faces_and_refuses_nonsense():
    ball = sphere()
    noisy = add_noise(ball, 0.01, seed=0)
    np.testing.assert_array_equal(noisy.faces, ball.faces)
    np.testing.assert_array_equal(add_noise(ball, 0, seed=0).points, ball.points)
    for sigma in (-0.1, np.nan, np.inf):
        with pytest.raises(ArgumentError, match="sigma"):
            add_noise(ball, sigma, seed=0)
