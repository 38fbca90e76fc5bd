"""Rotations that bring shapes to stand alike."""

import itertools

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from homolog.core.errors import ArgumentError
from homolog.maps import joint_rotations, rotation_angle, rotations


@pytest.fixture(scope="module")
def turned():
    """Eight tripods of unlike legs, each of points of its own, and how each was turned."""
    found = []
    for number in range(8):
        random = np.random.default_rng(number)
        legs = np.diag([1.0, 0.65, 0.35]) * random.uniform(0.9, 1.1, 3)
        points = random.random((200, 1)) * legs[np.arange(200) % 3] + 0.05 * random.standard_normal((200, 3))
        turn = Rotation.random(random_state=number).as_matrix()
        found.append((torch.tensor((points - points.mean(axis=0)) @ turn.T).float(), torch.tensor(turn).float()))
    return found


def angles(found, turned):
    """By how much each shape then stands otherwise than the one that none is turned for."""
    (stays,) = (turn for (_, misfit), (_, turn) in zip(found, turned, strict=True) if misfit == 0)
    return [float(rotation_angle(R @ turn @ stays.T)) for (R, _), (_, turn) in zip(found, turned, strict=True)]


@pytest.mark.parametrize("landmarks", [0, 3])
def test_shapes_turned_at_random_stand_alike(turned, monkeypatch, landmarks):
    if landmarks:
        monkeypatch.setattr(rotations, "_ALL_PAIRS", 5)
        monkeypatch.setattr(rotations, "_LANDMARKS", landmarks)
    told = []
    found = joint_rotations([points for points, _ in turned], progress=lambda *step: told.append(step))
    assert max(angles(found, turned)) < 15
    n_pairs = 8 * 3 - 3 * 4 // 2 if landmarks else 28
    assert told[-1] == (n_pairs, n_pairs, "aligning shapes") and len(told) == n_pairs
    assert sum(misfit == 0 for _, misfit in found) == 1
    assert all(torch.allclose(R @ R.T, torch.eye(3), atol=1e-4) and torch.det(R) > 0 for R, _ in found)


def test_one_shape_stays_and_none_is_refused(turned):
    rotation, misfit = joint_rotations([turned[0][0]])[0]
    assert torch.equal(rotation, torch.eye(3)) and misfit == 0
    with pytest.raises(ArgumentError, match="got none"):
        joint_rotations([])


def test_the_spanning_tree_is_the_least():
    points = np.random.default_rng(0).random((30, 2))
    points[12] = points[3]  # of length zero, an edge is an edge as well
    distances = np.linalg.norm(points[:, None] - points, axis=2)
    edges = list(rotations._spanning_tree(distances, list(itertools.combinations(range(30), 2)), 7))
    reached = {7}
    for child, parent in edges:  # each is joined to what is there
        assert parent in reached and child not in reached
        reached.add(child)
    assert len(edges) == 29
    assert sum(distances[edge] for edge in edges) == pytest.approx(length_by_prim(distances))


def length_by_prim(distances):
    """Of the minimum spanning tree: what is nearest is joined to what is there, one by one (Prim, 1957)."""
    there, length = [0], 0.0
    while outside := sorted({*range(len(distances))} - {*there}):
        nearest = min(outside, key=lambda number: distances[number, there].min())
        length += distances[nearest, there].min()
        there.append(nearest)
    return length
