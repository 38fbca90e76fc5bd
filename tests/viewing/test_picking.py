"""What a ray meets, against triangles solved one by one, and points looked at one by one."""

import numpy as np
import pytest

from homolog.viewing.picking import Ray, hit_points, hit_surface


def aimed(origin, place, slope=0.0):
    direction = np.asarray(place, dtype=float) - origin
    return Ray(np.asarray(origin, dtype=float), direction / np.linalg.norm(direction), slope)


def slow_hit(points, faces, ray):
    """A 3 x 3 system per triangle: origin + t direction = a + u (b - a) + v (c - a)."""
    met = []
    for face in faces:
        a, b, c = points[face]
        t, u, v = np.linalg.solve(np.stack([-ray.direction, b - a, c - a], axis=1), ray.origin - a)
        if min(u, v, 1 - u - v) >= 0 and t > 0:
            met.append((t, int(face[np.argmax([1 - u - v, u, v])])))
    return min(met, default=None)


@pytest.mark.parametrize("seed", range(3))
def test_surface(make, seed):
    """Of rays from anywhere to near the surface, some miss it and most meet it several times."""
    blob, rng = make.blob(2), np.random.default_rng(seed)
    hits = 0
    for _ in range(15):
        ray = aimed(4 * rng.standard_normal(3), blob.points[rng.integers(blob.n_points)] + 0.1 * rng.standard_normal(3))
        found, expected = hit_surface(blob.points, blob.faces, ray), slow_hit(blob.points, blob.faces, ray)
        assert (found is None) == (expected is None)
        if found is not None:
            hits += 1
            assert found.depth == pytest.approx(expected[0])
            assert found.point == expected[1]
    assert hits >= 5


def test_surface_from_behind_and_through_an_edge():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    for height in (2, -2):
        assert hit_surface(points, faces, aimed([0.9, 0.9, height], [0.9, 0.9, 0])).point == 2
    assert hit_surface(points, faces, aimed([0.2, 0.2, 1], [0.2, 0.2, 2])) is None  # it lies behind
    assert hit_surface(points, faces, aimed([-1, 0.5, 0], [1, 0.5, 0])) is None  # along the surface


def layers():
    """Two square grids of points, one a unit behind the other, shifted by half a spacing."""
    x, y = np.meshgrid(np.arange(5.0), np.arange(5.0), indexing="ij")
    front = np.stack([x.ravel(), y.ravel(), np.zeros(25)], axis=1)
    return np.concatenate([front, front + np.array([0.5, 0.5, -8.0])])


def test_points_nearest_to_the_ray_in_front():
    points = layers()
    everything = np.ones(50, dtype=bool)
    for i in range(25):
        near = points[i] + [0.2, 0.1, 0]
        assert hit_points(points, everything, aimed(near + np.array([0, 0, 10]), near), 1.0).point == i
    # Of hidden points the ray passes on to those behind.
    behind = hit_points(points, np.arange(50) >= 25, aimed([2.4, 2.4, 10], [2.4, 2.4, 0]), 1.0)
    assert behind.point == 25 + 2 * 5 + 2
    assert behind.depth == pytest.approx(18)
    assert hit_points(points, everything & (np.arange(50) >= 25), aimed([2, 2, 10], [2, 2, 0]), 1.0, before=10) is None


def test_points_are_met_within_a_spacing_or_what_the_ray_has_widened_to():
    points, shown = np.array([[0.0, 0, 0]]), np.ones(1, dtype=bool)
    for slope, spacing, met in ((0, 0.5, False), (0, 1.1, True), (0.05, 0.5, False), (0.11, 0.5, True)):
        found = hit_points(points, shown, Ray(np.array([1.0, 0, 10]), np.array([0.0, 0, -1]), slope), spacing)
        assert (found is not None) == met
    assert hit_points(points, shown, Ray(np.array([0.0, 0, 10]), np.array([0.0, 0, 1])), 1.0) is None
