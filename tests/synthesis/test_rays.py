"""The ray caster against the formula for one ray and one triangle, tried for all of them."""

import numpy as np
import pytest

from homolog.synthesis.rays import first_hits, visible


def moller_trumbore(origin, direction, corners, *, slack=0.0):
    """How far along a ray it meets a triangle, and the weights there; None if it does not."""
    a, b, c = corners
    normal = np.cross(direction, c - a)
    determinant = (b - a) @ normal
    if abs(determinant) < 1e-14:
        return None
    v = (origin - a) @ normal / determinant
    w = direction @ np.cross(origin - a, b - a) / determinant
    weights = np.array([1 - v - w, v, w])
    return (((c - a) @ np.cross(origin - a, b - a)) / determinant, weights) if (weights >= -slack).all() else None


def one_by_one(corners, ray):
    met = [(hit[0], number, hit[1]) for number, triangle in enumerate(corners) if (hit := meets(ray, triangle))]
    return min(met, key=lambda hit: hit[0]) if met else None


def meets(ray, triangle):
    return moller_trumbore(np.zeros(3), np.array([*ray, 1.0]), triangle)


def soup(seed, n, size):
    """Triangles at random before the viewer."""
    random = np.random.default_rng(seed)
    return random.uniform([-1, -1, 2], [1, 1, 4], size=(n, 1, 3)) + size * random.standard_normal((n, 3, 3))


@pytest.mark.parametrize(("n", "size"), [(1, 1.5), (12, 0.4), (100, 0.08), (40, 0.3)])
def test_first_hits_are_those_of_trying_all(n, size):
    corners = soup(n, n, size)
    corners[..., 2] = np.abs(corners[..., 2]) + 0.1
    rays = np.random.default_rng(1).uniform(-0.6, 0.6, size=(150, 2))
    hits = first_hits(corners, rays)
    expected = [one_by_one(corners, ray) for ray in rays]
    assert hits.triangles.tolist() == [-1 if hit is None else hit[1] for hit in expected]
    for number, hit in enumerate(expected):
        assert hits.depths[number] == pytest.approx(np.inf if hit is None else hit[0], rel=1e-9)
        assert hits.weights[number] == pytest.approx(np.zeros(3) if hit is None else hit[2], abs=1e-9)
    assert any(hit is not None for hit in expected)


@pytest.mark.parametrize("turn", [1, -1])
def test_no_ray_slips_through_a_closed_surface(make, turn):
    """Rays through the very corners and through the middles of edges, where triangles of either turn meet."""
    sphere = make.sphere(3)
    points = sphere.points @ make.rotation(2).T + [0, 0, 3]
    corners = points[sphere.faces][:, ::turn]
    edges = (corners + np.roll(corners, 1, axis=1)).reshape(-1, 3) / 2
    targets = np.concatenate([points, edges])
    hits = first_hits(corners, targets[:, :2] / targets[:, 2:])
    tangent = np.abs(np.linalg.norm(targets[:, :2], axis=1) / targets[:, 2] - 1 / np.sqrt(8)) < 0.02
    assert (hits.triangles[~tangent] >= 0).all()
    assert (hits.depths <= targets[:, 2] * (1 + 1e-9))[~tangent].all()


def test_triangles_without_area_or_seen_from_the_edge_are_not_met():
    flat = np.array([[[-1, 0, 2], [1, 0, 2], [0, 0, 2]], [[-1, 0, 1], [1, 0, 2], [0, 0, 3]]], dtype=float)
    hits = first_hits(flat, np.zeros((1, 2)))
    assert hits.triangles.tolist() == [-1] and np.isinf(hits.depths).all()


def test_of_two_triangles_at_one_depth_the_lower_index_is_met():
    triangle = np.array([[-1, -1, 2], [1, -1, 2], [0, 1, 2]], dtype=float)
    assert first_hits(np.stack([triangle, triangle]), np.zeros((1, 2))).triangles.tolist() == [0]


def test_points_behind_a_triangle_are_hidden_and_those_on_it_are_not():
    triangle = np.array([[[-1, -1, 2], [1, -1, 2], [0, 1, 2]]], dtype=float)
    points = np.array([[0, 0, 1.9], [0, 0, 2], [0, 0, 2.1], [3, 0, 3], [-1, -1, 2]], dtype=float)
    assert visible(triangle, points).tolist() == [True, True, False, True, True]
