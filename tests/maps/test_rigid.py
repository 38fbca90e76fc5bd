"""The rigid motion between points and their targets."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from homolog.maps import rigid_motion


def moved(points, seed):
    rotation = torch.from_numpy(Rotation.random(random_state=seed).as_matrix()).to(points)
    shift = torch.tensor([0.4, -1.0, 2.0]).to(points)
    return rotation, shift, points @ rotation.T + shift


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("wrong", [0.0, 0.4])
def test_found_exactly_though_many_places_are_wrong(seed, wrong):
    random = torch.Generator().manual_seed(seed)
    points = torch.randn(300, 3, generator=random, dtype=torch.float64)
    rotation, shift, targets = moved(points, seed)
    n_wrong = int(wrong * len(points))
    targets[:n_wrong] = 3 * torch.randn(n_wrong, 3, generator=random, dtype=torch.float64)
    found, away = rigid_motion(points, targets)
    torch.testing.assert_close(found, rotation, atol=1e-6, rtol=0)
    torch.testing.assert_close(away, shift, atol=1e-6, rtol=0)


def test_without_weighting_it_is_least_squares():
    """Against scipy's own solution of Wahba's problem, with noise on the targets."""
    random = np.random.default_rng(0)
    points = random.normal(size=(50, 3))
    targets = points @ Rotation.from_euler("xyz", [0.3, 1.0, -2.0]).as_matrix().T + random.normal(size=(50, 3))
    found, away = rigid_motion(torch.from_numpy(points), torch.from_numpy(targets), rounds=0)
    expected, _ = Rotation.align_vectors(targets - targets.mean(axis=0), points - points.mean(axis=0))
    np.testing.assert_allclose(found.numpy(), expected.as_matrix(), atol=1e-9)
    np.testing.assert_allclose(away.numpy(), targets.mean(axis=0) - expected.apply(points.mean(axis=0)), atol=1e-9)


@pytest.mark.parametrize("rounds", [0, 5])
def test_several_problems_at_once_are_solved_as_one_by_one_and_weights_count_as_copies(rounds):
    random = torch.Generator().manual_seed(3)
    points, targets = torch.randn(2, 4, 30, 3, generator=random, dtype=torch.float64)
    weights = torch.randint(0, 3, (4, 30), generator=random).double()
    rotations, shifts = rigid_motion(points, targets, weights=weights, rounds=rounds)
    for number in range(4):
        one, away = rigid_motion(points[number], targets[number], weights=weights[number], rounds=rounds)
        torch.testing.assert_close(rotations[number], one)
        torch.testing.assert_close(shifts[number], away)
    copies = weights[0].long()
    twice = rigid_motion(points[0].repeat_interleave(copies, 0), targets[0].repeat_interleave(copies, 0), rounds=0)
    torch.testing.assert_close(rigid_motion(points[0], targets[0], weights=weights[0], rounds=0), twice)


def test_never_a_reflection():
    points = torch.randn(100, 3, generator=torch.Generator().manual_seed(1))
    mirrored = points * torch.tensor([-1.0, 1.0, 1.0])
    flat = points * torch.tensor([1.0, 1.0, 0.0])
    for start, end in ((points, mirrored), (flat, flat @ moved(points, 2)[0].T), (points, points)):
        rotation, _ = rigid_motion(start, end)
        assert torch.det(rotation) == pytest.approx(1, abs=1e-5)
        torch.testing.assert_close(rotation @ rotation.T, torch.eye(3), atol=1e-5, rtol=0)
    rotation, shift = rigid_motion(points, points)
    torch.testing.assert_close(rotation, torch.eye(3), atol=1e-5, rtol=0)
    assert shift.norm() < 1e-5
