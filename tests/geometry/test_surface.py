"""Surfaces: subdivision, closest points, and projection onto the side whose normal agrees."""

import numpy as np
import pytest
import trimesh

from homolog.geometry.surface import (
    BarycentricPoints,
    ReferenceSurface,
    Surface,
    closest_weights,
    split_long,
    subdivided,
)


def sphere(subdivisions):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)


def test_subdividing_keeps_the_surface():
    coarse = Surface(*sphere(2))
    fine, parents = subdivided(coarse)
    area = np.linalg.norm(fine.face_vectors, axis=1).reshape(-1, 4).sum(axis=1)
    np.testing.assert_allclose(area, np.linalg.norm(coarse.face_vectors, axis=1))
    np.testing.assert_allclose(np.repeat(coarse.face_normals, 4, axis=0), fine.face_normals, atol=1e-12)
    np.testing.assert_array_equal(fine.vertices, coarse.vertices[parents].mean(axis=1))
    assert trimesh.Trimesh(fine.vertices, fine.faces, process=False).is_watertight


def test_closest_points_of_triangles():
    generator = np.random.default_rng(0)
    triangles, points = generator.normal(size=(500, 3, 3)), 2.0 * generator.normal(size=(500, 3))
    weights = closest_weights(triangles, points)
    assert weights.min() >= 0
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    expected = trimesh.triangles.closest_point(triangles, points)
    np.testing.assert_allclose(np.einsum("pck,pc->pk", triangles, weights), expected, atol=1e-9)


def test_closest_point_of_a_needle():
    needle = np.array([[[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]])
    weights = closest_weights(needle, np.array([[1.5, 1.0, 0.0]]))
    np.testing.assert_allclose(np.einsum("pck,pc->pk", needle, weights), [[1.5, 0, 0]])


def test_projecting_points_on_the_surface():
    surface = Surface(*sphere(3))
    generator = np.random.default_rng(1)
    triangles = generator.integers(len(surface.faces), size=300)
    given = BarycentricPoints(triangles, generator.dirichlet([1.0, 1.0, 1.0], 300))
    found = ReferenceSurface(surface).project(given.positions(surface), surface.face_normals[triangles])
    np.testing.assert_allclose(found.positions(surface), given.positions(surface), atol=1e-9)


def test_points_stay_on_their_side_of_a_thin_sheet():
    vertices, faces = sphere(4)
    sheet = Surface(vertices * [1.0, 1.0, 0.005], faces)
    upper = sheet.vertices[sheet.vertices[:, 2] > 0.003]
    # The points are nearer to the lower side, but face up.
    points, up = upper - [0.0, 0.0, 0.012], np.tile([0.0, 0.0, 1.0], (len(upper), 1))
    assert (ReferenceSurface(sheet).project(points, up).positions(sheet)[:, 2] > 0).all()


def test_values_at_subdivided_vertices():
    surface = Surface(*sphere(2))
    reference = ReferenceSurface(surface)
    values = surface.vertices @ [1.0, 2.0, 3.0]
    middles = surface.vertices[surface.faces[:, :2]].mean(axis=1)
    nearest = reference.nearest_vertices(middles, middles)
    np.testing.assert_allclose(reference.values_at(nearest, values), middles @ [1.0, 2.0, 3.0])


def test_projections_without_normals_are_the_closest_of_all():
    vertices, faces = sphere(2)
    surface = Surface(vertices * [1.0, 1.3, 0.7], faces)
    points = np.random.default_rng(2).normal(size=(60, 3))
    found = ReferenceSurface(surface).project(points, around=3).positions(surface)
    every = closest_weights(np.tile(surface.vertices[faces], (60, 1, 1)), np.repeat(points, len(faces), axis=0))
    on = np.einsum("pck,pc->pk", np.tile(surface.vertices[faces], (60, 1, 1)), every).reshape(60, -1, 3)
    closest = np.linalg.norm(on - points[:, None], axis=2).min(axis=1)
    np.testing.assert_allclose(np.linalg.norm(found - points, axis=1), closest, rtol=1e-9)
    assert ReferenceSurface(surface).project(points[:0]).weights.shape == (0, 3)


def test_split_triangles_are_the_same_surface():
    generator = np.random.default_rng(4)
    surface = Surface(
        generator.normal(size=(30, 3)), generator.permuted(np.tile(np.arange(30), (12, 1)), axis=1)[:, :3]
    )
    split = split_long(surface, 0.9, most=100_000)
    fine = split.surface
    assert np.linalg.norm(np.diff(fine.vertices[fine.faces], axis=1), axis=2).max() <= 0.9
    areas = np.bincount(split.parents, np.linalg.norm(fine.face_vectors, axis=1), len(surface.faces))
    np.testing.assert_allclose(areas, np.linalg.norm(surface.face_vectors, axis=1))
    points = BarycentricPoints(np.arange(len(fine.faces)), generator.dirichlet([1.0, 1.0, 1.0], len(fine.faces)))
    np.testing.assert_allclose(split.to_original(points).positions(surface), points.positions(fine), atol=1e-12)
    assert len(split_long(surface, 0.9, most=40).surface.faces) <= 40


def test_a_tetrahedron_is_projected_onto_although_it_has_fewer_vertices_than_are_looked_at():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    surface = Surface(corners, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    below, down = np.array([[0.2, 0.2, -0.1], [0.2, 0.2, 0.1]]), np.array([[0.0, 0, -1], [0, 0, -1]])
    found = ReferenceSurface(surface).project(below, down, around=3)
    assert found.positions(surface) == pytest.approx(np.array([[0.2, 0.2, 0], [0.2, 0.2, 0]]))
