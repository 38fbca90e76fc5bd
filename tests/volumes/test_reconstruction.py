"""Surfaces of clouds that are drawn from known solids."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from homolog.core.errors import ArgumentError, ShapeError
from homolog.shapes import Shape
from homolog.volumes import reconstruct_surface

pytest.importorskip("skimage")
pytest.importorskip("fast_simplification")


def scattered(mesh, count, seed=0):
    """So many points of a surface, each drawn on its own: with gaps and clusters."""
    points, _ = trimesh.sample.sample_surface(mesh, count, seed=seed)
    return Shape(np.asarray(points), name="scattered")


def solid(shape):
    return trimesh.Trimesh(shape.points, shape.faces, process=False)


BALL = trimesh.creation.icosphere(subdivisions=4, radius=30.0)
BALL.apply_translation([5.0, -200.0, 40.0])
BOX = trimesh.creation.box(extents=(60.0, 40.0, 90.0))
RING = trimesh.creation.torus(major_radius=30.0, minor_radius=12.0)


@pytest.mark.parametrize(("mesh", "euler"), [(BALL, 2), (BOX, 2), (RING, 0)], ids=["ball", "box", "ring"])
def test_solids_come_back(mesh, euler):
    cloud = scattered(mesh, 3000)
    found = reconstruct_surface(cloud, points=2000, resolution=64)
    made = solid(found)
    assert made.is_watertight and made.is_winding_consistent and made.euler_number == euler
    assert made.volume == pytest.approx(mesh.volume, rel=0.05)  # positive: faces look outwards
    assert found.n_points == pytest.approx(2000, rel=0.05)
    voxel = np.ptp(cloud.points, axis=0).max() / 64
    away, _ = KDTree(np.asarray(made.sample(20_000, seed=1))).query(cloud.points)
    assert away.mean() < voxel


def test_normals_and_order_do_not_matter():
    cloud = scattered(BOX, 1500)
    order = np.random.default_rng(0).permutation(cloud.n_points)
    first, second = (
        reconstruct_surface(Shape(points), resolution=48) for points in (cloud.points, cloud.points[order])
    )
    assert np.array_equal(first.points, second.points) and np.array_equal(first.faces, second.faces)


def test_it_follows_the_cloud():
    """Twice as large and elsewhere: the same surface, twice as large and there."""
    cloud = scattered(RING, 2000)
    first = reconstruct_surface(cloud, points=None, resolution=48)
    second = reconstruct_surface(Shape(2.0 * cloud.points + [100.0, 0.0, -7.0]), points=None, resolution=48)
    assert np.allclose(second.points, 2.0 * first.points + [100.0, 0.0, -7.0], atol=1e-3)


def test_an_open_surface_has_no_inside():
    half = scattered(BALL, 3000)
    open_bowl = Shape(half.points[half.points[:, 2] < 40.0], name="bowl.xyz")
    with pytest.raises(ShapeError, match=r"bowl\.xyz has gaps too wide to tell its inside"):
        reconstruct_surface(open_bowl, resolution=48)


def test_what_cannot_be_asked_for():
    cloud = scattered(BALL, 500)
    with pytest.raises(ArgumentError, match="points"):
        reconstruct_surface(cloud, points=2)
    with pytest.raises(ArgumentError, match="resolution"):
        reconstruct_surface(cloud, resolution=2)
    with pytest.raises(ShapeError):
        reconstruct_surface(Shape(cloud.points[:2]))
    for points in (np.zeros((50, 3)), np.full((50, 3), np.nan)):
        with pytest.raises(ShapeError):
            reconstruct_surface(Shape(points, name="bad"))
