"""Rotations to try, and those that bring two shapes together."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from homolog.maps import (
    best_rotation,
    closest_point_rotations,
    cube_rotations,
    distinct_rotations,
    handedness,
    principal_rotations,
    rotation_angle,
)


def random_rotation(seed):
    return torch.from_numpy(Rotation.random(random_state=seed).as_matrix()).float()


@pytest.fixture
def points():
    """An uneven cloud without any symmetry."""
    random = torch.Generator().manual_seed(0)
    cloud = torch.randn(300, 3, generator=random) * torch.tensor([1.0, 0.5, 0.2])
    cloud[:, 1] += cloud[:, 0] ** 2
    cloud[:, 2] += 0.5 * cloud[:, 0] * cloud[:, 1]
    return cloud - cloud.mean(dim=0)


def test_no_rotation_is_far_from_one_of_the_cube():
    turns = cube_rotations()
    assert torch.allclose(turns @ turns.mT, torch.eye(3).expand(24, 3, 3), atol=1e-6)
    assert torch.allclose(torch.linalg.det(turns), torch.ones(24))
    assert distinct_rotations(turns) == list(range(24))
    nearest = [min(float(rotation_angle(random_rotation(seed) @ turn.T)) for turn in turns) for seed in range(200)]
    assert max(nearest) < 63


def test_the_angle_is_that_of_the_rotation_vector():
    for seed in range(10):
        rotation = random_rotation(seed)
        expected = np.degrees(np.linalg.norm(Rotation.from_matrix(rotation.numpy()).as_rotvec()))
        assert float(rotation_angle(rotation)) == pytest.approx(expected, abs=0.05)


def test_best_rotation_is_no_reflection(points):
    mirrored = points * torch.tensor([-1.0, 1, 1])
    found = best_rotation(points, mirrored)
    assert float(torch.linalg.det(found)) == pytest.approx(1, abs=1e-5)
    expected = Rotation.align_vectors(mirrored.numpy(), points.numpy())[0].as_matrix()
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-4)


def test_weights_say_which_pairs_count(points):
    rotation = random_rotation(3)
    targets = points @ rotation.T
    targets[:100] = 0
    weights = torch.ones(300)
    weights[:100] = 0
    assert float(rotation_angle(best_rotation(points - points[100:].mean(0), targets, weights) @ rotation.T)) < 0.1


@pytest.mark.parametrize("seed", range(4))
def test_rigid_bodies_are_brought_together_from_any_rotation(points, seed):
    rotation = random_rotation(seed)
    shuffled = (points @ rotation.T)[torch.randperm(300, generator=torch.Generator().manual_seed(seed))]
    (found, misfit), *others = closest_point_rotations(points, shuffled)
    assert float(rotation_angle(found @ rotation.T)) < 0.5
    assert misfit == pytest.approx(0, abs=1e-5)
    assert all(other > misfit for _, other in others)


@pytest.mark.parametrize("seed", range(4))
def test_one_of_the_principal_rotations_is_that_between_copies(points, seed):
    rotation = random_rotation(seed)
    found = principal_rotations(points + 3, points @ rotation.T)
    torch.testing.assert_close(torch.linalg.det(found), torch.ones(4))
    angles = sorted(float(rotation_angle(each @ rotation.T)) for each in found)
    assert angles[0] < 0.1 and angles[1:] == pytest.approx([180] * 3, abs=0.1)


def test_handedness_tells_a_turn_from_a_reflection(points):
    turned = points @ random_rotation(1).T
    for radius in (0.3, 0.6):
        assert float(handedness(points, turned, radius=radius)) == pytest.approx(1, abs=1e-3)
        assert float(handedness(points, -turned, radius=radius)) == pytest.approx(-1, abs=1e-3)
    half = torch.where(points[:, :1] > 0, turned, -turned)
    assert abs(float(handedness(points, half, radius=0.3))) < 0.5
