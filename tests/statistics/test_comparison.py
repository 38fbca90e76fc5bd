"""Comparison of groups against the textbook's statistic, all relabellings one by one, and what the null asks for."""

from itertools import combinations

import numpy as np
import pytest
from scipy import stats

from homolog.core.errors import ArgumentError
from homolog.statistics import compare_groups, false_discovery_rates


def hotelling(first, second):
    """T squared of two samples (a, d) and (b, d), with the pooled covariance."""
    a, b = len(first), len(second)
    away = second.mean(axis=0) - first.mean(axis=0)
    pooled = ((a - 1) * np.cov(first.T) + (b - 1) * np.cov(second.T)) / (a + b - 2)
    return a * b / (a + b) * away @ np.linalg.solve(pooled, away)


@pytest.fixture
def shapes():
    """Eleven shapes of six points; the last four differ at two points."""
    points = np.random.default_rng(0).standard_normal((11, 6, 3)) * [1.0, 2.0, 0.5]
    points[7:, 1] += [2, 0, 1]
    points[7:, 4] -= [1, 2, 0]
    return points, np.arange(11) >= 7


def test_all_relabellings_one_by_one(shapes):
    points, second = shapes
    found = compare_groups(points, second)
    assert found.is_exact and found.permutations == 330
    every = []
    for members in combinations(range(11), 4):
        rest = [number for number in range(11) if number not in members]
        every.append([hotelling(points[rest][:, one], points[list(members)][:, one]) for one in range(6)])
    every, own = np.array(every), np.array([hotelling(points[:7, one], points[7:, one]) for one in range(6)])
    np.testing.assert_allclose(found.t_squared, own, rtol=1e-9)
    np.testing.assert_allclose(found.p, (every >= own * (1 - 1e-9)).mean(axis=0))
    largest = every.max(axis=1, keepdims=True)
    np.testing.assert_allclose(found.p_corrected, (largest >= own * (1 - 1e-9)).mean(axis=0))
    np.testing.assert_allclose(found.difference, points[7:].mean(axis=0) - points[:7].mean(axis=0))
    assert found.p_overall == found.p_corrected.min()


def test_drawn_relabellings_come_near_to_all(shapes):
    points, second = shapes
    exact, told = compare_groups(points, second), []
    drawn = compare_groups(points, second, permutations=300, progress=lambda *state: told.append(state))
    assert not drawn.is_exact and drawn.permutations == 300 and told[-1] == (300, 300, "permutations")
    assert np.abs(drawn.p - exact.p).max() < 0.08 and drawn.p.min() >= 1 / 300
    again = compare_groups(points, second, permutations=300)
    np.testing.assert_array_equal(again.p_corrected, drawn.p_corrected)
    other = compare_groups(points, second, permutations=300, seed=1)
    assert (other.p != drawn.p).any()


def test_false_discovery_rates_are_scipys():
    p = np.random.default_rng(1).random(50) ** 3
    np.testing.assert_allclose(false_discovery_rates(p), stats.false_discovery_control(p))


def test_points_that_vary_in_a_plane_or_not_at_all(shapes):
    points, second = shapes
    points = points.copy()
    points[:, 0, 2] = 0
    points[:, 3] = 1
    found = compare_groups(points, second)
    assert np.isfinite(found.t_squared).all() and found.t_squared[3] == 0 and found.p[3] == 1
    flat = hotelling(points[:7, 0, :2], points[7:, 0, :2])
    assert found.t_squared[0] == pytest.approx(flat)


def test_exchanging_the_groups_turns_the_difference(shapes):
    points, second = shapes
    one, other = compare_groups(points, second), compare_groups(points, ~second)
    np.testing.assert_allclose(one.difference, -other.difference)
    np.testing.assert_allclose(one.p_corrected, other.p_corrected)


@pytest.mark.slow
def test_without_a_difference_p_is_uniform():
    """Over many samples of one kind: each point's p is uniform, and a corrected p below 0.05 comes in 5 % of them."""
    p, least = [], []
    for seed in range(400):
        random = np.random.default_rng(seed)
        smooth = random.standard_normal((16, 4, 3)).repeat(5, axis=1) + 0.5 * random.standard_normal((16, 20, 3))
        found = compare_groups(smooth, np.arange(16) < 8, permutations=400, seed=seed)
        p.append(found.p[0])
        least.append(found.p_overall)
    assert stats.kstest(p, "uniform").pvalue > 0.01
    assert stats.kstest(least, "uniform").pvalue > 0.01
    assert 0.02 < np.mean(np.array(least) <= 0.05) < 0.08


@pytest.mark.parametrize(
    ("second", "said"),
    [
        ([True] + [False] * 10, "the groups have 10 and 1 shapes"),
        (np.arange(11), "of truth values"),
        ([True] * 5, "must have shapes"),
    ],
)
def test_mistakes_are_named(shapes, second, said):
    with pytest.raises(ArgumentError, match=said):
        compare_groups(shapes[0], np.array(second))
    with pytest.raises(ArgumentError, match="permutations is 1"):
        compare_groups(*shapes, permutations=1)
