"""Clouds of a mesh."""

import numpy as np
import pytest
import trimesh

from homolog.shapes import face_areas
from homolog.training.clouds import CloudVariant, cloud_variants, make_cloud
from homolog.training.settings import CloudSettings


def test_the_clean_cloud_comes_first():
    settings = CloudSettings(
        noise=(0.1, 0.2), subsampled=(0.5,), resampled=(300,), cut=(0.4,), holes=(9,), views=(0.0,)
    )
    found = cloud_variants(settings)
    kinds = ["clean", "noise", "noise", "subsampled", "resampled", "cut", "holes", "views"]
    assert [variant.kind for variant in found] == kinds
    assert [variant.amount for variant in found[1:]] == [0.1, 0.2, 0.5, 300, 0.4, 9, 0.0]
    assert [variant.is_partial for variant in found] == [False] * 5 + [True] * 3


def test_clean_and_noisy_clouds_keep_the_points(make):
    blob = make.blob(3)
    clean = make_cloud(blob, CloudVariant(), seed=0)
    assert clean.weights is None and clean.shape.faces is None
    assert np.array_equal(clean.shape.points, blob.points)
    noisy = make_cloud(blob, CloudVariant("noise", 0.02), seed=0)
    assert noisy.weights is None
    moved = noisy.shape.points - blob.points
    assert abs(moved.std() - 0.02) < 0.001


def test_subsampled_clouds_are_some_of_the_points(make):
    blob = make.blob(3)
    cloud = make_cloud(blob, CloudVariant("subsampled", 0.3), seed=1)
    assert cloud.shape.n_points == round(0.3 * blob.n_points)
    origin = cloud.weights.argmax(axis=1)
    assert np.all(np.diff(origin) > 0)
    assert np.array_equal(cloud.shape.points, blob.points[origin])


@pytest.mark.parametrize("variant", [CloudVariant("cut", 0.4), CloudVariant("holes", 5)])
def test_parts_are_some_of_the_points_of_one_piece(make, variant):
    blob = make.blob(3)
    cloud = make_cloud(blob, variant, seed=1)
    assert cloud.shape.faces is None
    origin = cloud.weights.argmax(axis=1)
    assert len(set(origin)) == len(origin) < blob.n_points
    assert np.array_equal(cloud.shape.points, blob.points[origin])
    inside = blob.faces[np.isin(blob.faces, origin).all(axis=1)]
    area = face_areas(blob.points, inside).sum() / face_areas(blob.points, blob.faces).sum()
    if variant.kind == "cut":
        assert 0.35 < area < 0.45
    else:
        assert 0.5 < area < 0.98


def test_views_lie_on_one_side_of_the_surface(make):
    """The inner side of a convex shape's surface is hidden: what is seen has a plane of its own that parts it off."""
    ball = make.sphere(3)
    cloud = make_cloud(ball, CloudVariant("views", 0.0), seed=1)
    assert cloud.shape.faces is None and cloud.shape.n_points > ball.n_points
    np.testing.assert_allclose(cloud.weights @ ball.points, cloud.shape.points)
    np.testing.assert_allclose(cloud.weights.sum(axis=1), 1)
    assert cloud.weights.min() >= 0 and np.diff(cloud.weights.indptr).max() <= 3
    outwards = cloud.shape.points / np.linalg.norm(cloud.shape.points, axis=1, keepdims=True)
    camera = cloud.shape.points.mean(axis=0) / np.linalg.norm(cloud.shape.points.mean(axis=0))
    assert (outwards @ camera).min() > 0.2  # the camera is at least two radii away, so that it sees less than half
    noisy = make_cloud(ball, CloudVariant("views", 0.01), seed=1)
    moved = np.linalg.norm(noisy.shape.points - noisy.weights @ ball.points, axis=1)
    assert abs(np.sqrt((moved**2).mean()) / (0.01 * np.sqrt(face_areas(ball.points, ball.faces).sum())) - 1) < 0.05


def test_resampled_clouds_lie_on_the_surface(make):
    blob = make.blob(2)
    cloud = make_cloud(blob, CloudVariant("resampled", 5000), seed=1)
    mesh = trimesh.Trimesh(blob.points, blob.faces, process=False)
    _, distance, face = trimesh.proximity.closest_point_naive(mesh, cloud.shape.points[:300])
    assert distance.max() < 1e-8
    weights = cloud.weights.toarray()
    assert weights.min() >= 0
    np.testing.assert_allclose(weights.sum(axis=1), 1)
    np.testing.assert_allclose(weights @ blob.points, cloud.shape.points)
    for row, corners in zip(weights[:300], blob.faces[face], strict=True):
        assert row[corners].sum() == pytest.approx(1)


def test_resampled_clouds_are_even(make):
    """As many points on each part of the surface as its area asks for, and within a triangle, too."""
    grid = make.grid(2)
    points = make_cloud(grid, CloudVariant("resampled", 40_000), seed=2).shape.points
    counts, *_ = np.histogram2d(points[:, 0], points[:, 1], bins=10, range=[[0, 1], [0, 1]])
    assert abs(counts / 400 - 1).max() < 5 / 20  # five standard deviations
    stretched = make.blob(2)
    cloud = make_cloud(stretched, CloudVariant("resampled", 20_000), seed=3)
    mesh = trimesh.Trimesh(stretched.points, stretched.faces, process=False)
    np.testing.assert_allclose(cloud.shape.points.mean(axis=0), mesh.centroid, atol=0.03)


def test_seeds(make):
    blob = make.blob(2)
    variants = [CloudVariant("noise", 0.1), CloudVariant("subsampled", 0.5), CloudVariant("resampled", 200)]
    for variant in (*variants, CloudVariant("cut", 0.5), CloudVariant("views", 0.01)):
        first, again, other = (make_cloud(blob, variant, seed=seed).shape.points for seed in (0, 0, 1))
        assert np.array_equal(first, again)
        assert not np.array_equal(first, other)


def test_parts_may_be_learned_as_meshes_too(make):
    """With the triangles that are left, of larger holes; what a camera sees stays a cloud."""
    settings = CloudSettings(cut=(0.4,), holes=(5,), views=(0.0,), hole_radius=(0.2, 0.3), part_meshes=True)
    found = [(each.kind, each.is_mesh) for each in cloud_variants(settings)]
    assert found == [
        ("clean", False),
        ("cut", False),
        ("holes", False),
        ("views", False),
        ("cut", True),
        ("holes", True),
    ]
    blob = make.blob(3)
    cloud, mesh = (make_cloud(blob, variant, seed=1) for variant in cloud_variants(settings) if variant.kind == "holes")
    origin = mesh.weights.argmax(axis=1)
    assert cloud.shape.faces is None and np.array_equal(cloud.shape.points, mesh.shape.points)
    corners = {tuple(sorted(face)) for face in blob.faces.tolist()}
    assert all(tuple(sorted(origin[face])) in corners for face in mesh.shape.faces)
    area = face_areas(mesh.shape.points, mesh.shape.faces).sum() / face_areas(blob.points, blob.faces).sum()
    smaller = make_cloud(blob, CloudVariant("holes", 5, (0.02, 0.1), is_mesh=True), seed=1)
    assert (
        area
        < 0.8
        < face_areas(smaller.shape.points, smaller.shape.faces).sum() / face_areas(blob.points, blob.faces).sum()
    )
