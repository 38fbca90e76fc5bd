"""Normals, frames and gradients against slow references and linear functions."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from homolog.geometry.tangent import (
    gradient_matrices,
    mesh_edges,
    mesh_normals,
    nearest_neighbours,
    normals_of,
    scatter_of,
    tangent_frames,
)


def slow_gradient(points, frames, starts, ends, values) -> np.ndarray:
    """Point by point: the ridge least-squares fit of the differences along its edges."""
    gradient = np.zeros((len(points), 2))
    for point in range(len(points)):
        mine = ends[starts == point]
        offsets = (points[mine] - points[point]) @ frames[point, :2].T
        rows = np.vstack([offsets, np.sqrt(1e-5) * np.eye(2)])
        wanted = np.concatenate([values[mine] - values[point], [0, 0]])
        gradient[point] = np.linalg.lstsq(rows, wanted, rcond=None)[0]
    return gradient


@given(seed=st.integers(0, 10**6))
def test_frames_are_orthonormal_right_handed_and_keep_the_normal(seed: int) -> None:
    normals = np.random.default_rng(seed).standard_normal((20, 3))
    normals[:6] = np.concatenate([np.eye(3), -np.eye(3)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    frames = tangent_frames(normals)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.broadcast_to(np.eye(3), (20, 3, 3)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(frames), 1, atol=1e-12)
    np.testing.assert_array_equal(frames[:, 2], normals)


def test_normals_of_a_sphere_point_outwards(make) -> None:
    sphere = make.sphere(4)
    assert (np.einsum("ij,ij->i", mesh_normals(sphere.points, sphere.faces), sphere.points) > 0.999).all()
    found = normals_of(scatter_of(sphere.points, nearest_neighbours(sphere.points, 30)))
    assert (np.abs(np.einsum("ij,ij->i", found, sphere.points)) > 0.998).all()


def test_a_mesh_normal_is_the_mean_of_its_faces_and_never_zero() -> None:
    box = trimesh.creation.box()
    expected = np.zeros((8, 3))
    for face, normal in zip(box.faces, box.face_normals, strict=True):
        expected[face] += normal
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(mesh_normals(box.vertices, box.faces), expected, atol=1e-12)
    folded = mesh_normals(np.eye(3), np.array([[0, 1, 2], [2, 1, 0]]))
    np.testing.assert_array_equal(folded, np.tile([0.0, 0, 1], (3, 1)))


def test_mesh_edges_are_those_of_the_faces_both_ways_once_each(make) -> None:
    fan = np.array([[0, 1, 2], [0, 1, 3], [1, 0, 4]])
    for faces in (make.blob(1).faces, make.grid(4).faces, fan):
        starts, ends = mesh_edges(faces)
        expected = {(int(f[i]), int(f[j])) for f in faces for i in range(3) for j in range(3) if i != j}
        assert len(starts) == len(expected)
        assert list(zip(starts.tolist(), ends.tolist(), strict=True)) == sorted(expected)
    assert all(len(indices) == 0 for indices in mesh_edges(fan[:0]))


def test_neighbours_are_the_nearest_by_brute_force() -> None:
    points = np.random.default_rng(2).standard_normal((80, 3))
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    expected = np.argsort(distances, axis=1)[:, 1:8]
    np.testing.assert_array_equal(nearest_neighbours(points, 7), expected)
    assert nearest_neighbours(points[:4], 30).shape == (4, 3)


def test_no_point_is_its_own_neighbour_where_points_coincide() -> None:
    points = np.random.default_rng(0).standard_normal((30, 3))
    points[10:20] = points[:10]
    points[20:26] = points[0]  # eight times the same, more than the neighbours asked for
    near = nearest_neighbours(points, 5)
    assert (near != np.arange(30)[:, None]).all()
    assert all(len(set(row)) == 5 for row in near.tolist())
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(distances, np.inf)
    found = np.take_along_axis(distances, near, axis=1)
    np.testing.assert_allclose(found, np.sort(distances, axis=1)[:, :5], atol=1e-12)


@pytest.mark.parametrize("modality", ["mesh", "cloud"])
def test_gradients_equal_the_least_squares_fit_point_by_point(modality: str, make) -> None:
    blob = make.blob(2)
    if modality == "mesh":
        frames, (starts, ends) = tangent_frames(mesh_normals(blob.points, blob.faces)), mesh_edges(blob.faces)
    else:
        near = nearest_neighbours(blob.points, 12)
        frames = tangent_frames(normals_of(scatter_of(blob.points, near)))
        starts, ends = np.repeat(np.arange(blob.n_points), 12), near.ravel()
    values = np.random.default_rng(1).standard_normal(blob.n_points)
    along = gradient_matrices(blob.points, frames, starts, ends)
    found = np.stack([matrix @ values for matrix in along], axis=1)
    np.testing.assert_allclose(found, slow_gradient(blob.points, frames, starts, ends, values), rtol=1e-8, atol=1e-8)
    for matrix in along:
        np.testing.assert_allclose(matrix.sum(axis=1), 0, atol=1e-9)
    for one, other in ((along[0].indptr, along[1].indptr), (along[0].indices, along[1].indices)):
        np.testing.assert_array_equal(one, other)


def test_the_gradient_of_a_linear_function_on_a_plane_is_constant(make) -> None:
    grid = make.grid(12, width=20.0)  # the regularisation is nothing beside such edges
    frames = tangent_frames(mesh_normals(grid.points, grid.faces))
    along = gradient_matrices(grid.points, frames, *mesh_edges(grid.faces))
    slope = np.array([0.7, -1.9, 5.0])
    found = np.stack([matrix @ (grid.points @ slope) for matrix in along], axis=1)
    in_space = np.einsum("na,nax->nx", found, frames[:, :2])
    np.testing.assert_allclose(in_space, np.tile([0.7, -1.9, 0], (grid.n_points, 1)), atol=1e-4)


def test_the_order_of_the_edges_does_not_matter(make) -> None:
    blob = make.blob(2)
    frames, (starts, ends) = tangent_frames(mesh_normals(blob.points, blob.faces)), mesh_edges(blob.faces)
    order = np.random.default_rng(4).permutation(len(starts))
    shuffled = gradient_matrices(blob.points, frames, starts[order], ends[order])
    for one, other in zip(gradient_matrices(blob.points, frames, starts, ends), shuffled, strict=True):
        assert (one != other).nnz == 0
        assert one.has_canonical_format and one.nnz == len(starts) + blob.n_points


@pytest.mark.parametrize("modality", ["mesh", "cloud"])
def test_the_gradient_of_coordinates_on_a_sphere_is_their_tangent_part(modality: str, make) -> None:
    sphere = make.sphere(4)
    if modality == "mesh":
        frames, (starts, ends) = tangent_frames(mesh_normals(sphere.points, sphere.faces)), mesh_edges(sphere.faces)
    else:
        near = nearest_neighbours(sphere.points, 12)
        frames = tangent_frames(normals_of(scatter_of(sphere.points, near)))
        starts, ends = np.repeat(np.arange(sphere.n_points), 12), near.ravel()
    along = gradient_matrices(sphere.points, frames, starts, ends)
    slope = np.array([0.3, -0.5, 0.8])
    found = np.stack([matrix @ (sphere.points @ slope) for matrix in along], axis=1)
    in_space = np.einsum("na,nax->nx", found, frames[:, :2])
    expected = slope - (sphere.points @ slope)[:, None] * sphere.points
    np.testing.assert_allclose(in_space, expected, atol=0.04)


def test_neighbours_on_a_line_keep_the_gradient_finite() -> None:
    points = np.stack([np.arange(6.0), np.zeros(6), np.zeros(6)], axis=1)
    frames = np.broadcast_to(np.eye(3), (6, 3, 3))
    starts = np.repeat(np.arange(6), 5)
    along_x, along_y = gradient_matrices(points, frames, starts, nearest_neighbours(points, 5).ravel())
    np.testing.assert_allclose(along_x @ points[:, 0], 1, rtol=1e-4)
    np.testing.assert_allclose(along_y @ points[:, 0], 0, atol=1e-12)
