"""Distances along edges against a full search."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra

from homolog.core.errors import ArgumentError
from homolog.geometry import edge_graph, geodesics, pair_distances


@pytest.fixture(scope="module")
def graph(make):
    blob = make.blob(3)
    return edge_graph(blob.points, blob.faces)


def pairs(n: int, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.integers(0, n, count), rng.integers(0, n, count)


def test_the_graph_holds_each_edge_both_ways_with_its_length(make) -> None:
    grid = make.grid(4, width=3.0)
    graph = edge_graph(grid.points, grid.faces)
    assert graph.shape == (16, 16) and graph.nnz == 2 * (2 * 12 + 9)
    assert graph[0, 1] == graph[1, 0] == pytest.approx(1.0)
    assert graph[0, 5] == pytest.approx(np.sqrt(2))
    assert graph[0, 2] == 0


def test_an_edge_without_length_still_joins_its_ends() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0], [2, 0, 0]])
    graph = edge_graph(points, np.array([[0, 1, 2], [1, 2, 3]]))
    assert pair_distances(graph, np.array([1, 0]), np.array([2, 3])) == pytest.approx([0, 2])


@pytest.mark.parametrize("horizon", [1e-4, 0.1, 0.7, 50.0])
def test_pair_distances_equal_a_full_search_whatever_the_horizon(horizon: float, graph) -> None:
    starts, ends = pairs(graph.shape[0], 900)
    ends[:50] = starts[:50]
    expected = dijkstra(graph)[starts, ends]
    assert expected.max() > 2
    np.testing.assert_allclose(pair_distances(graph, starts, ends, horizon=horizon), expected, rtol=1e-12)


def test_more_starts_than_one_batch_and_repeated_pairs(graph, monkeypatch) -> None:
    starts, ends = pairs(graph.shape[0], 400, seed=1)
    starts, ends = np.tile(starts, 2), np.tile(ends, 2)
    expected = dijkstra(graph)[starts, ends]
    for rows in (1, 7, len(np.unique(starts))):
        monkeypatch.setattr(geodesics, "_ROWS", rows)
        np.testing.assert_allclose(pair_distances(graph, starts, ends), expected, rtol=1e-12)


def test_only_far_pairs_are_searched_again_with_the_horizon_doubled(graph, monkeypatch) -> None:
    searched = []
    within = geodesics._within

    def spy(graph, starts, ends, limit):
        searched.append((len(starts), limit))
        return within(graph, starts, ends, limit)

    monkeypatch.setattr(geodesics, "_within", spy)
    starts, ends = pairs(graph.shape[0], 300)
    expected = dijkstra(graph)[starts, ends]
    np.testing.assert_allclose(pair_distances(graph, starts, ends, horizon=0.25), expected, rtol=1e-12)
    limits = [limit for _, limit in searched]
    assert limits == [0.25 * 2**i for i in range(len(limits))]
    apart = starts != ends
    for count, limit in searched[1:]:
        assert count == (apart & (expected > limit / 2)).sum()


def test_points_on_different_pieces_are_infinitely_far(make) -> None:
    one = make.sphere(1)
    both = make.joined([one, type(one)(one.points + np.array([5, 0, 0]), one.faces)])
    graph = edge_graph(both.points, both.faces)
    distances = pair_distances(graph, np.array([0, 3, 50, 0]), np.array([42, 60, 1, 1]))
    assert np.isinf(distances[:3]).all() and np.isfinite(distances[3])


def test_no_pairs_give_no_distances(graph) -> None:
    none = np.zeros(0, dtype=int)
    assert pair_distances(graph, none, none).shape == (0,)


@pytest.mark.parametrize("horizon", [0, -1.0, float("nan")])
def test_a_horizon_that_would_never_grow_is_refused(horizon: float, graph) -> None:
    with pytest.raises(ArgumentError, match="horizon"):
        pair_distances(graph, *pairs(10, 5), horizon=horizon)
