"""Shapes in patches, deformed along correspondences."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import homolog
from homolog.geometry.deformation import WeightedPairs
from homolog.geometry.patches import PatchedShape
from homolog.shapes import Shape


@pytest.fixture(scope="module")
def bar() -> PatchedShape:
    """A round bar along x."""
    mesh = trimesh.creation.capsule(height=4.0, radius=0.4, count=[24, 24]).subdivide()
    mesh.vertices = mesh.vertices[:, [2, 0, 1]]
    return PatchedShape(homolog.compute_operators(Shape(np.array(mesh.vertices), np.array(mesh.faces))), 60)


def _bent(points: np.ndarray) -> np.ndarray:
    """The bar bent to a quarter of a circle."""
    radius = np.ptp(points[:, 0]) / (np.pi / 2)
    angles = points[:, 0] / radius
    away = radius + points[:, 1]
    return np.stack([away * np.sin(angles), away * np.cos(angles) - radius, points[:, 2]], axis=1)


def _pairs(bar: PatchedShape, target: np.ndarray) -> WeightedPairs:
    return WeightedPairs(np.arange(len(target)), target, bar.masses)


def test_shape_follows_its_counterparts(bar):
    target = _bent(bar.points)
    found = bar.registered(target, _pairs(bar, target), np.ones(len(target), dtype=bool))
    assert np.linalg.norm(found - target, axis=1).mean() < 0.03


def test_patches_at_rest_carry_points_to_where_they_are(bar):
    turns = np.tile(np.eye(3), (bar.count, 1, 1))
    np.testing.assert_allclose(bar.carried(bar.middles, turns, np.ones(bar.count)), bar.points, atol=1e-6)


def test_counterparts_far_from_all_others_count_little(bar):
    target = _bent(bar.points)
    wrong = np.random.default_rng(0).random(len(target)) < 0.1
    pairs = _pairs(bar, np.where(wrong[:, None], target + np.array([0.0, 0.0, 1.0]), target))
    found = bar.registered(target, pairs, np.ones(len(target), dtype=bool))
    assert np.linalg.norm(found - target, axis=1).mean() < 0.05
