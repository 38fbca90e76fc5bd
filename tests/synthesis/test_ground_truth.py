"""Ground truth on surfaces of which one knows what lies where."""

import numpy as np
from stand_in import sphere

from homolog.geometry.surface import ReferenceSurface, Surface
from homolog.synthesis.ground_truth import project_mesh, vertices_at
from homolog.synthesis.remeshing import MeshSettings, remesh
from homolog.synthesis.template import sample_evenly


def bent(surface, angle):
    """A limb along y whose upper half is bent to the front, back onto the lower half."""
    x, y, z = surface.vertices.T
    turn = np.clip((y + 0.15) / 0.3, 0.0, 1.0) * angle
    middle_y = np.where(y < -0.15, y, -0.15 + 0.3 * np.sin(turn) / angle)
    middle_z = np.where(y < -0.15, 0.0, 0.3 * (1.0 - np.cos(turn)) / angle)
    rest = np.maximum(y - 0.15, 0.0)
    vertices = np.stack(
        [x, middle_y + rest * np.cos(turn) - z * np.sin(turn), middle_z + rest * np.sin(turn) + z * np.cos(turn)],
        axis=1,
    )
    return Surface(vertices, surface.faces)


def limb():
    vertices, faces = sphere(4)
    return Surface(vertices * [0.09, 0.6, 0.09], faces)


def test_vertices_lie_exactly_at_their_places():
    surface = limb()
    reference = ReferenceSurface(surface)
    rough = remesh(reference, np.ones(len(surface.vertices)), MeshSettings(1500), np.random.default_rng(0))
    mesh, places = project_mesh(rough, reference)
    np.testing.assert_array_equal(mesh.vertices, places.positions(surface))
    np.testing.assert_allclose(mesh.vertices, rough.vertices, atol=5e-3)
    assert places.weights.min() >= 0
    np.testing.assert_allclose(places.weights.sum(axis=1), 1.0)


def test_points_go_to_the_nearest_vertex_and_never_across_a_gap():
    rest = limb()
    body = bent(rest, np.deg2rad(178.0))
    reference = ReferenceSurface(body)
    rough = remesh(reference, np.ones(len(rest.vertices)), MeshSettings(1500), np.random.default_rng(0))
    mesh, places = project_mesh(rough, reference)
    points = sample_evenly(rest, 800)
    found = vertices_at(points, mesh, places, body, rest)
    edge = np.sqrt(np.linalg.norm(mesh.face_vectors, axis=1).mean())
    assert np.linalg.norm(mesh.vertices[found] - points.positions(body), axis=1).max() < 1.2 * edge
    # The two halves touch, but are far apart at rest; only within the bend are places there further apart than here.
    jumps = np.linalg.norm(places.positions(rest)[found] - points.positions(rest), axis=1)
    assert jumps[np.abs(points.positions(rest)[:, 1]) > 0.25].max() < 2.0 * edge
    assert np.linalg.norm(mesh.vertices[found] - points.positions(body), axis=1).mean() < 0.5 * edge


def test_a_mesh_of_the_template_itself():
    surface = Surface(*sphere(3))
    mesh, places = project_mesh(surface, ReferenceSurface(surface))
    points = sample_evenly(surface, 300)
    found = vertices_at(points, mesh, places, surface, surface)
    distances = np.linalg.norm(points.positions(surface)[:, None] - surface.vertices[None], axis=2)
    np.testing.assert_allclose(distances[np.arange(300), found], distances.min(axis=1))


def test_even_samples_are_even():
    surface = limb()
    points = sample_evenly(surface, 400).positions(surface)
    gaps = np.linalg.norm(points[:, None] - points[None], axis=2) + np.eye(400)
    area = np.linalg.norm(surface.face_vectors, axis=1).sum() / 2
    assert gaps.min() > 0.6 * np.sqrt(area / 400)
