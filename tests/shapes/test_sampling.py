"""Evenly spread samples against a greedy choice by all distances."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from homolog.core.errors import ArgumentError
from homolog.shapes.sampling import farthest_points


def greedy(distances: np.ndarray, first: int, count: int) -> list[int]:
    chosen = [first]
    while len(chosen) < count:
        chosen.append(int(distances[:, chosen].min(axis=1).argmax()))
    return chosen


def all_distances(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points[:, None] - points[None], axis=2)


@given(n=st.integers(1, 60), share=st.floats(0, 1), seed=st.integers(0, 1000))
def test_the_choice_is_greedy_from_one_of_its_points(n: int, share: float, seed: int) -> None:
    points = np.random.default_rng(seed).normal(size=(n, 3)) * [5, 1, 0.2]
    count = max(1, round(share * n))
    found, distances = farthest_points(points, count, seed=seed), all_distances(points)
    assert found.dtype == np.int64 and (np.diff(found) > 0).all() and len(found) == count
    candidates = [greedy(distances, first, count) for first in found]
    assert any(sorted(chosen) == found.tolist() for chosen in candidates)
    covering = distances[:, found].min(axis=1).max()
    assert any(np.isclose(covering, distances[:, chosen].min(axis=1).max()) for chosen in candidates)
    # No two samples are nearer to each other than the farthest point is to them.
    apart = distances[np.ix_(found, found)] + np.diag(np.full(count, np.inf))
    assert apart.min() >= covering - 1e-12


def test_samples_of_a_body_cover_it_evenly(demo) -> None:
    points = demo.amber.points
    found = farthest_points(points, 200, seed=0)
    drawn = np.random.default_rng(0).choice(len(points), 200, replace=False)
    covering = [
        np.linalg.norm(points[:, None] - points[None, kept], axis=2).min(axis=1).max() for kept in (found, drawn)
    ]
    assert covering[0] < 0.5 * covering[1]


def test_a_seed_decides_the_first_point() -> None:
    points = np.random.default_rng(0).normal(size=(100, 3))
    assert farthest_points(points, 20, seed=4).tolist() == farthest_points(points, 20, seed=4).tolist()
    assert len({tuple(farthest_points(points, 1, seed=seed)) for seed in range(20)}) > 10
    # The same points elsewhere, and in single precision, are chosen alike.
    moved = (2 * points + [10, 0, -3]).astype(np.float32)
    assert farthest_points(moved, 20, seed=4).tolist() == farthest_points(points, 20, seed=4).tolist()


def test_no_index_comes_twice_even_where_points_coincide() -> None:
    points = np.repeat(np.eye(3), 4, axis=0)
    assert farthest_points(points, 12, seed=0).tolist() == list(range(12))
    corners = farthest_points(points, 3, seed=0)
    assert sorted(corners // 4) == [0, 1, 2]


@pytest.mark.parametrize("count", [0, -1, 11])
def test_more_points_than_there_are_or_none_are_refused(count: int) -> None:
    with pytest.raises(ArgumentError, match=f"count is {count}, but must be from 1 to the number of points, 10"):
        farthest_points(np.zeros((10, 3)), count, seed=0)
