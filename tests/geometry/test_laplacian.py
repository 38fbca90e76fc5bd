"""Laplacian and mass against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sparse
import trimesh

from homolog.core.errors import ArgumentError, ShapeError
from homolog.geometry import cloud_laplacian, mesh_laplacian, surface_area
from homolog.shapes import Shape

KINDS = ("robust", "cotangent")


def slow_cotangent(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pinkall and Polthier, triangle by triangle, angle by angle."""
    laplacian, mass = np.zeros((len(points), len(points))), np.zeros(len(points))
    for face in faces:
        for corner in range(3):
            here, a, b = face[corner], face[(corner + 1) % 3], face[(corner + 2) % 3]
            to_a, to_b = points[a] - points[here], points[b] - points[here]
            angle = np.arccos(to_a @ to_b / np.linalg.norm(to_a) / np.linalg.norm(to_b))
            weight = 0.5 / np.tan(angle)
            laplacian[[a, b], [a, b]] += weight
            laplacian[[a, b], [b, a]] -= weight
            mass[here] += np.linalg.norm(np.cross(to_a, to_b)) / 2 / 3
    return laplacian, mass


def fan() -> tuple[np.ndarray, np.ndarray]:
    """Three triangles on one edge: no surface."""
    points = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, -0.5, 0]], dtype=float)
    return points, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])


@pytest.mark.parametrize("kind", KINDS)
def test_one_right_triangle_has_the_weights_of_its_angles(kind: str) -> None:
    # Angles 90, 45 and 45 degrees: half cotangents 0, 1/2 and 1/2.
    laplacian, mass = mesh_laplacian(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]), kind=kind)
    np.testing.assert_allclose(laplacian.toarray(), [[1, -0.5, -0.5], [-0.5, 0.5, 0], [-0.5, 0, 0.5]], atol=1e-4)
    np.testing.assert_allclose(mass, 1 / 6, rtol=1e-4)


def test_cotangent_equals_the_sum_over_angles(make) -> None:
    blob = make.blob(1)
    laplacian, mass = mesh_laplacian(blob.points, blob.faces, kind="cotangent")
    expected_laplacian, expected_mass = slow_cotangent(blob.points, blob.faces)
    np.testing.assert_allclose(laplacian.toarray(), expected_laplacian, atol=1e-12)
    np.testing.assert_allclose(mass, expected_mass, rtol=1e-12)


def test_both_kinds_agree_where_the_mesh_is_delaunay(make) -> None:
    sphere = make.sphere(2)
    robust, robust_mass = mesh_laplacian(sphere.points, sphere.faces, kind="robust")
    plain, plain_mass = mesh_laplacian(sphere.points, sphere.faces, kind="cotangent")
    np.testing.assert_allclose(robust.toarray(), plain.toarray(), atol=1e-3)
    np.testing.assert_allclose(robust_mass, plain_mass, rtol=1e-3)


def test_the_robust_kind_has_no_negative_weights_where_the_plain_one_has() -> None:
    # Two flat triangles across the long diagonal of a thin rhombus: the wrong one of the two.
    points = np.array([[-1.0, 0, 0], [1, 0, 0], [0, 0.2, 0], [0, -0.2, 0]])
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    plain, _ = mesh_laplacian(points, faces, kind="cotangent")
    robust, _ = mesh_laplacian(points, faces, kind="robust")
    assert plain[0, 1] > 1
    # The flipped diagonal: its opposite angles are those of the far tips, half cotangents (1 - 0.04) / 0.4 / 2 each.
    assert robust[0, 1] == 0
    np.testing.assert_allclose(-robust[2, 3], (1 - 0.04) / 0.4, rtol=1e-3)


@pytest.mark.parametrize("kind", [*KINDS, "cloud"])
def test_it_is_symmetric_semidefinite_and_kills_constants(kind: str, make) -> None:
    for shape in (make.blob(2), make.grid(9)):
        if kind == "cloud":
            laplacian, mass = cloud_laplacian(shape.points)
        else:
            laplacian, mass = mesh_laplacian(shape.points, shape.faces, kind=kind)
        dense = laplacian.toarray()
        assert sparse.issparse(laplacian) and laplacian.shape == (shape.n_points, shape.n_points)
        np.testing.assert_array_equal(dense, dense.T)
        np.testing.assert_allclose(dense.sum(axis=1), 0, atol=1e-10)
        assert np.linalg.eigvalsh(dense).min() > -1e-10
        assert (mass > 0).all()


@pytest.mark.parametrize("kind", KINDS)
def test_mass_sums_to_the_area(kind: str, make) -> None:
    torus = trimesh.creation.torus(1.0, 0.4, major_sections=20, minor_sections=12)
    shapes = [make.blob(3), make.grid(7, width=3.0), Shape(torus.vertices, torus.faces)]
    for shape in shapes:
        _, mass = mesh_laplacian(shape.points, shape.faces, kind=kind)
        assert mass.sum() == pytest.approx(surface_area(shape), rel=1e-3)
    assert surface_area(shapes[1]) == pytest.approx(9.0)


def test_cloud_mass_sums_to_the_area_of_a_clean_sphere(make) -> None:
    _, mass = cloud_laplacian(make.sphere(4).points)
    assert mass.sum() == pytest.approx(4 * np.pi, rel=0.05)


@pytest.mark.parametrize("kind", KINDS)
def test_coordinates_of_a_sphere_are_its_first_eigenfunctions(kind: str, make) -> None:
    sphere = make.sphere(4)
    laplacian, mass = mesh_laplacian(sphere.points, sphere.faces, kind=kind)
    energy, norm = sphere.points.T @ (laplacian @ sphere.points), sphere.points.T @ (mass[:, None] * sphere.points)
    np.testing.assert_allclose(energy, 2 * norm, atol=0.005 * norm.max())
    # Point by point it fails at the twelve points of five neighbours, whose third of the faces is not their cell.
    regular = np.bincount(sphere.faces.ravel()) == 6
    pointwise = laplacian @ sphere.points / mass[:, None]
    np.testing.assert_allclose(pointwise[regular], 2 * sphere.points[regular], atol=0.05)


@pytest.mark.parametrize("kind", KINDS)
def test_a_mesh_that_is_no_surface_works(kind: str) -> None:
    points, faces = fan()
    laplacian, mass = mesh_laplacian(points, faces, kind=kind)
    dense = laplacian.toarray()
    assert np.isfinite(dense).all()
    np.testing.assert_allclose(dense.sum(axis=1), 0, atol=1e-10)
    assert np.linalg.eigvalsh(dense).min() > -1e-10
    assert mass.sum() == pytest.approx(0.5 + 0.5 + np.sqrt(1.25) / 2, rel=1e-3)
    if kind == "cotangent":
        np.testing.assert_allclose(dense, slow_cotangent(points, faces)[0], atol=1e-12)


def test_lengths_scale_the_mass_and_leave_the_laplacian(make) -> None:
    blob = make.blob(2)
    laplacian, mass = mesh_laplacian(blob.points, blob.faces)
    larger, larger_mass = mesh_laplacian(7 * blob.points, blob.faces)
    np.testing.assert_allclose(larger.toarray(), laplacian.toarray(), atol=1e-6)
    np.testing.assert_allclose(larger_mass, 49 * mass, rtol=1e-6)


def test_a_point_between_slivers_keeps_some_mass(make) -> None:
    grid = make.grid(4)
    points = np.vstack([grid.points, grid.points[:1]])
    faces = np.vstack([grid.faces, [[0, 1, len(points) - 1]]])  # the last point has but a face without area
    _, mass = mesh_laplacian(points, faces, kind="cotangent")
    assert 0 < mass[-1] < 1e-4 * mass.mean()


def test_small_clouds_take_the_neighbours_they_have(make) -> None:
    points = make.sphere(0).points  # 12 points, fewer than 30 neighbours
    laplacian, _ = cloud_laplacian(points)
    assert laplacian.shape == (12, 12)


def test_an_unknown_kind_is_refused_with_the_nearest_name(make) -> None:
    with pytest.raises(ArgumentError, match=r"laplacian is 'robus'.*did you mean 'robust'"):
        mesh_laplacian(make.grid(3).points, make.grid(3).faces, kind="robus")


def test_what_is_not_finite_is_refused() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, np.nan, 0]])
    with pytest.raises(ShapeError, match="1 NaN or infinite"):
        mesh_laplacian(points, np.array([[0, 1, 2]]), kind="cotangent")
    with pytest.raises(ShapeError, match="not finite"):
        mesh_laplacian(np.zeros((4, 3)), np.array([[0, 1, 2], [1, 3, 2]]))
    with pytest.raises(ArgumentError, match="n_neighbours"):
        cloud_laplacian(np.random.default_rng(0).random((50, 3)), n_neighbours=2)


def test_a_cloud_far_from_the_origin_has_the_laplacian_that_it_has_there(make) -> None:
    """The library that makes it rounds positions, so that neighbours differed."""
    points = make.blob(3).points
    laplacian, mass = cloud_laplacian(points)
    moved, moved_mass = cloud_laplacian(1000 * points + [50.0, -3000.0, 7.0])
    assert abs(moved - laplacian).max() < 1e-9 * abs(laplacian).max()
    assert np.allclose(moved_mass, 1e6 * mass, rtol=1e-9)
