"""Flipped triangles of smooth maps are opened, and nothing else moves."""

import numpy as np

from homolog.transfer import SurfaceProjector, untangled
from homolog.transfer.smooth_map import SurfaceMap


def folded(make, seed):
    """The identity of a sphere, but for some points that are exchanged with a neighbour."""
    sphere = make.sphere(3)
    projector = SurfaceProjector(sphere)
    positions = sphere.points.copy()
    for corner, neighbour in sphere.faces[np.random.default_rng(seed).permutation(len(sphere.faces))[:6], :2]:
        positions[[corner, neighbour]] = positions[[neighbour, corner]]
    return sphere, SurfaceMap(projector, projector, positions, orientation=1)


def test_folds_open(make):
    sphere, smooth = folded(make, 0)
    assert smooth.flipped_triangles.sum() > 10
    opened = untangled(smooth)
    assert opened.flipped_triangles.sum() == 0
    np.testing.assert_allclose(np.linalg.norm(opened.positions, axis=1), 1, atol=0.02)
    moved = np.linalg.norm(opened.positions - smooth.positions, axis=1) > 1e-9
    near = np.linalg.norm(
        sphere.points[:, None] - sphere.points[np.unique(sphere.faces[smooth.flipped_triangles])], axis=2
    )
    assert moved.any() and near.min(axis=1)[moved].max() < 0.7  # within a few rings
    assert np.linalg.norm(opened.positions - sphere.points, axis=1).max() < 0.2


def test_flips_by_slow_reference(make):
    """A triangle of a sphere is turned over if its normal points inward."""
    sphere, smooth = folded(make, 1)
    expected = []
    for face in sphere.faces:
        a, b, c = smooth.positions[face]
        expected.append(np.cross(b - a, c - a) @ (a + b + c) < 0)
    np.testing.assert_array_equal(smooth.flipped_triangles, expected)


def test_a_mirrored_orientation_is_no_flip(make):
    """Triangles that are listed the other way round, on both sides or on one."""
    sphere = make.sphere(2)
    inside_out = type(sphere)(sphere.points, sphere.faces[:, ::-1])
    for start, goal, turned in ((inside_out, inside_out, 1), (sphere, inside_out, -1), (sphere, inside_out, 0)):
        smooth = SurfaceMap(SurfaceProjector(start), SurfaceProjector(goal), sphere.points, orientation=turned)
        assert not smooth.flipped_triangles.any()
        assert untangled(smooth) is smooth


def test_clouds_are_left_alone(make):
    sphere = make.sphere(2)
    smooth = SurfaceMap(SurfaceProjector(sphere), SurfaceProjector(sphere.as_cloud()), sphere.points)
    assert smooth.flipped_triangles is None and untangled(smooth) is smooth
