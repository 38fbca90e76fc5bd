"""Remeshing: size, quality, place and stretch of the triangles."""

import numpy as np
import pytest
from stand_in import sphere

from homolog.geometry.surface import ReferenceSurface, Surface
from homolog.synthesis.remeshing import MeshSettings, is_one_closed_surface, relax, remesh
from homolog.synthesis.self_intersections import self_intersection_share


def quality(surface):
    """1 for an equilateral triangle, 0 for a needle."""
    triangles = surface.vertices[surface.faces]
    squares = np.square(triangles - triangles[:, [1, 2, 0]]).sum(axis=(1, 2))
    return 2.0 * np.sqrt(3.0) * np.linalg.norm(surface.face_vectors, axis=1) / squares


def made(surface, count, *, detail=None, stretch=1.0, seed=0):
    detail = np.ones(len(surface.vertices)) if detail is None else detail
    return remesh(ReferenceSurface(surface), detail, MeshSettings(count, stretch), np.random.default_rng(seed))


@pytest.fixture(scope="module")
def ball():
    return Surface(*sphere(4, radius=0.5))


def test_a_sphere(ball):
    mesh = made(ball, 1200)
    assert is_one_closed_surface(mesh)
    assert len(mesh.vertices) == pytest.approx(1200, rel=0.05)
    assert quality(mesh).mean() > 0.93
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 0.5, rtol=5e-3)


def test_the_same_numbers_give_the_same_mesh(ball):
    first, second = made(ball, 1000, seed=3), made(ball, 1000, seed=3)
    np.testing.assert_array_equal(first.vertices, second.vertices)
    np.testing.assert_array_equal(first.faces, second.faces)


def test_other_numbers_give_another_connectivity(ball):
    first, second = made(ball, 1000, seed=1), made(ball, 1000, seed=2)
    assert first.faces.shape != second.faces.shape or (first.faces != second.faces).any()
    # Hardly any vertex is where one of the other is.
    apart = np.linalg.norm(first.vertices[:, None] - second.vertices[None], axis=2).min(axis=1)
    assert np.median(apart) > 0.15 * np.sqrt(4 * np.pi * 0.25 / 1000)


def test_finer_where_wanted(ball):
    upper = ball.vertices[:, 1] > 0
    mesh = made(ball, 1500, detail=np.where(upper, 0.5, 1.0))
    middles = mesh.vertices[mesh.faces].mean(axis=1)[:, 1]
    areas = np.linalg.norm(mesh.face_vectors, axis=1)
    assert areas[middles > 0.1].mean() < 0.35 * areas[middles < -0.1].mean()


def test_stretched_in_one_direction(ball):
    isotropic, stretched = made(ball, 1000), made(ball, 1000, stretch=3.0)
    assert is_one_closed_surface(stretched)
    assert self_intersection_share(stretched) == 0.0
    assert len(stretched.vertices) == pytest.approx(1000, rel=0.1)
    assert elongation(isotropic) < 1.1
    assert elongation(stretched) > 1.5


def elongation(mesh):
    """How much longer edges are in the direction of the longest ones than across it, all over a sphere."""
    triangles = mesh.vertices[mesh.faces]
    sides = (triangles - triangles[:, [1, 2, 0]]).reshape(-1, 3)
    squares = np.linalg.eigvalsh(sides.T @ sides)
    return np.sqrt(squares[2] / squares[:2].mean())


def test_relaxing_evens_out_without_leaving_the_surface(ball):
    generator = np.random.default_rng(0)
    coarse = Surface(*sphere(3, radius=0.5))
    shaken = coarse.vertices + 0.012 * generator.normal(size=coarse.vertices.shape)
    shaken *= 0.5 / np.linalg.norm(shaken, axis=1, keepdims=True)
    uneven = Surface(shaken, coarse.faces)
    even = relax(uneven, ReferenceSurface(ball))
    assert quality(even).mean() > quality(uneven).mean() + 0.02
    np.testing.assert_allclose(np.linalg.norm(even.vertices, axis=1), 0.5, rtol=5e-3)


def test_what_is_one_closed_surface(ball):
    assert is_one_closed_surface(ball)
    assert not is_one_closed_surface(Surface(ball.vertices, ball.faces[1:]))
    assert not is_one_closed_surface(Surface(ball.vertices, ball.faces[:, ::-1]))
    assert not is_one_closed_surface(Surface(np.concatenate([ball.vertices, [[0, 0, 0]]]), ball.faces))
    two = Surface(np.concatenate([ball.vertices, ball.vertices + 2]), np.concatenate([ball.faces, ball.faces + 2562]))
    assert not is_one_closed_surface(two)
