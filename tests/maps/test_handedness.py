"""Handedness: whether maps keep left and right, and the side of a surface."""

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree

from homolog import Shape, compute_operators
from homolog.geometry import OperatorSettings
from homolog.maps import CoarseMapSettings, coarse_fit, handedness, surface_handedness
from homolog.shapes import rotation_about


@pytest.fixture(scope="module")
def body(demo_operators):
    """Samples of a body's basis, and the nearest of them to the mirror image of each."""
    basis = demo_operators[0].basis.sampled(torch.arange(0, demo_operators[0].n_points, 8))
    points = basis.points.numpy()
    mirrored = torch.from_numpy(KDTree(points).query(points * [-1, 1, 1])[1])
    return basis, mirrored


def test_a_surface_is_kept_or_turned_over(body):
    basis, mirrored = body
    same = torch.arange(basis.n_points)
    assert float(surface_handedness(basis, basis, same)) == pytest.approx(1, abs=1e-3)
    assert float(surface_handedness(basis, basis, mirrored)) < -0.6


def test_a_scrambled_map_keeps_no_side(body):
    basis, _ = body
    scrambled = torch.randperm(basis.n_points, generator=torch.Generator().manual_seed(0))
    assert abs(float(surface_handedness(basis, basis, scrambled))) < 0.3


def test_the_pose_does_not_matter_to_the_surface(body):
    basis, mirrored = body
    turned = basis.turned(torch.from_numpy(rotation_about(0, 130.0)).float())
    found, other = (surface_handedness(basis, other, mirrored) for other in (basis, turned))
    torch.testing.assert_close(found, other, atol=1e-4, rtol=0)


def test_inward_faces_reverse_the_surface(demo):
    shape = demo.amber
    inward = Shape(shape.points, np.ascontiguousarray(shape.faces[:, ::-1]))
    outside, inside = (
        compute_operators(each, settings=OperatorSettings(n_eigenpairs=60)).basis for each in (shape, inward)
    )
    assert float(surface_handedness(outside, inside, torch.arange(shape.n_points))) < -0.9


def test_a_map_that_exchanges_left_and_right_fits_worse(body):
    """It is as smooth and leads home as well, and a symmetric body is its own mirror image."""
    basis, mirrored = body
    same = torch.arange(basis.n_points)
    right, exchanged = (coarse_fit(basis, basis, m, m, have_outsides=True) for m in (same, mirrored))
    assert right.handedness == pytest.approx(1) and exchanged.handedness < 0
    none = CoarseMapSettings(handedness=0.0, surface_handedness=0.0, cycle=0.0)
    apart = [coarse_fit(basis, basis, m, m, have_outsides=True, settings=none).misfit for m in (same, mirrored)]
    assert exchanged.misfit - right.misfit > apart[1] - apart[0] + 0.5


def test_clouds_have_no_side_of_the_surface(body):
    basis, mirrored = body
    plain, sided = (coarse_fit(basis, basis, mirrored, mirrored, have_outsides=has) for has in (False, True))
    surface = float(surface_handedness(basis, basis, mirrored))
    assert sided.misfit - plain.misfit == pytest.approx(-0.5 * surface, abs=1e-5)
    assert plain.handedness == pytest.approx(
        float(handedness(basis.points, basis.points[mirrored], radius=0.15)), abs=1e-5
    )
