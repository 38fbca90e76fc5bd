"""Surfaces and outlines of masks that are drawn here, against the bodies that were drawn."""

import numpy as np
import pytest
import trimesh

from homolog.core.errors import ArgumentError, ShapeError
from homolog.volumes import Mask, mask_surface, slice_cloud

pytest.importorskip("skimage")
pytest.importorskip("fast_simplification")

RADIUS, CENTRE = 12.0, np.array([3.0, -40.0, 200.0])
# Voxels that run against each other and are longer along one axis.
AXES = np.diag([0.5, -0.6, 1.2])


def drawn(inside, extent, axes=AXES):
    """A mask of what a function of positions, in millimetres about the centre, calls inside."""
    size = np.ceil(2 * (extent + 2) / np.abs(np.diag(axes))).astype(int)
    places = np.stack(np.meshgrid(*(np.arange(n) for n in size), indexing="ij"), axis=-1)
    positions = (places - (size - 1) / 2) @ axes.T
    return Mask(inside(positions), CENTRE - axes @ ((size - 1) / 2), axes)


@pytest.fixture(scope="module")
def ball():
    return drawn(lambda p: np.linalg.norm(p, axis=-1) < RADIUS, RADIUS)


@pytest.fixture(scope="module")
def ring():
    def inside(p):
        return (np.hypot(p[..., 0], p[..., 1]) - 10) ** 2 + p[..., 2] ** 2 < 4.0**2

    return drawn(inside, 14.5)


def solid(shape):
    return trimesh.Trimesh(shape.points, shape.faces, process=False)


def test_the_surface_of_a_ball(ball):
    shape = mask_surface(ball, points=1000)
    distance = np.linalg.norm(shape.points - CENTRE, axis=1)
    assert abs(distance.mean() - RADIUS) < 0.1
    assert distance.std() < 0.12  # a tenth of a voxel's longest side
    mesh = solid(shape)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.euler_number == 2
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.02)  # positive: faces look outwards
    assert mesh.area == pytest.approx(4 * np.pi * RADIUS**2, rel=0.02)
    assert shape.n_points == pytest.approx(1000, rel=0.02)


def test_blur_takes_the_steps_away(ball):
    def roughness(smoothing):
        mesh = solid(mask_surface(ball, points=None, smoothing=smoothing))
        away = mesh.triangles_center - CENTRE
        return 1 - np.einsum("nk,nk->n", mesh.face_normals, away / np.linalg.norm(away, axis=1)[:, None]).mean()

    assert roughness(1.0) < 0.02 < 0.05 < roughness(0.0)


def test_a_ring_keeps_its_hole(ring):
    mesh = solid(mask_surface(ring, points=1500))
    assert mesh.is_watertight and mesh.euler_number == 0
    assert mesh.volume == pytest.approx(2 * np.pi**2 * 10 * 4**2, rel=0.04)


def test_an_object_at_the_border_of_the_volume_is_closed():
    mask = Mask(np.ones((6, 7, 8), dtype=bool), np.zeros(3), np.eye(3))
    mesh = solid(mask_surface(mask, points=None, smoothing=0.0))
    assert mesh.is_watertight
    np.testing.assert_allclose(mesh.bounds, [[-0.5] * 3, [5.5, 6.5, 7.5]])


def test_all_points(ball):
    everything = mask_surface(ball, points=None)
    assert everything.n_points > 3000
    few = mask_surface(ball, points=10**6)
    np.testing.assert_array_equal(few.points, everything.points)


def test_outlines_of_a_ball(ball):
    cloud = slice_cloud(ball, every=3)
    assert cloud.faces is None
    from_centre = cloud.points - CENTRE
    heights = np.unique(from_centre[:, 2].round(6))
    np.testing.assert_allclose(np.diff(heights), 3 * 1.2, atol=1e-6)
    radius = np.hypot(from_centre[:, 0], from_centre[:, 1])
    expected = np.sqrt(RADIUS**2 - from_centre[:, 2] ** 2)
    assert np.abs(radius - expected).max() < 0.6  # a voxel
    assert abs((radius - expected).mean()) < 0.1


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_slices_along_any_axis(ball, axis):
    cloud = slice_cloud(ball, axis=axis, every=2)
    step = 2 * abs(AXES[axis, axis])
    np.testing.assert_allclose(np.diff(np.unique(cloud.points[:, axis].round(6))), step, atol=1e-6)
    assert abs(np.linalg.norm(cloud.points - CENTRE, axis=1).mean() - RADIUS) < 0.3


def test_a_span_of_slices(ball):
    lower = slice_cloud(ball, span=(0.0, 0.4)).points[:, 2]
    assert lower.max() <= CENTRE[2] - RADIUS + 0.4 * 2 * RADIUS + 1.2
    upper = slice_cloud(ball, span=(0.4, 1.0)).points[:, 2]
    assert len(lower) + len(upper) == slice_cloud(ball).n_points


def test_some_points_of_the_outlines(ball):
    every, some = slice_cloud(ball), slice_cloud(ball, points=200, seed=1)
    assert some.n_points == 200
    assert {tuple(point) for point in some.points} <= {tuple(point) for point in every.points}


def test_a_hole_has_an_outline_of_its_own(ring):
    middle = slice_cloud(ring, span=(0.4, 0.6))
    radius = np.hypot(*(middle.points - CENTRE)[:, :2].T)
    assert (radius < 7).any() and (radius > 13).any() and not ((radius > 7.5) & (radius < 12.5)).any()


def test_numbers_that_cannot_be(ball):
    for call in (
        lambda: mask_surface(ball, points=2),
        lambda: mask_surface(ball, smoothing=-1.0),
        lambda: mask_surface(ball, smoothing=float("nan")),
        lambda: slice_cloud(ball, axis=3),
        lambda: slice_cloud(ball, every=0),
        lambda: slice_cloud(ball, span=(0.5, 0.5)),
        lambda: slice_cloud(ball, points=10**6),
    ):
        with pytest.raises(ArgumentError, match="must be"):
            call()


def test_objects_that_make_no_shape():
    with pytest.raises(ShapeError, match="marks no voxel"):
        Mask(np.zeros((3, 3, 3), dtype=bool), np.zeros(3), np.eye(3))
    with pytest.raises(ShapeError, match="without a volume"):
        Mask(np.ones((3, 3, 3), dtype=bool), np.zeros(3), np.diag([1.0, 0.0, 1.0]))
    inside = np.zeros((9, 9, 9), dtype=bool)
    inside[4, 4, 4] = True
    mesh = solid(mask_surface(Mask(inside, np.zeros(3), np.eye(3)), smoothing=2.0))
    assert mesh.is_watertight and 0 < mesh.volume < 8
    with pytest.raises(ShapeError, match="more slices"):
        slice_cloud(Mask(inside, np.zeros(3), np.eye(3)), span=(0.0, 0.1))
