"""Distances along edges against a full search."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra

from homolog.core.errors import ArgumentError, MissingExtraError, ShapeError
from homolog.geometry import edge_graph, geodesic_distances, geodesics, pair_distances


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


@pytest.mark.parametrize(
    ("kind", "least", "mean", "most"),
    [("dijkstra", 0.999, 1.07, 1.21), ("heat", 0.97, 0.99, 1.0), ("exact", 0.999, 0.9994, 1.0)],
)
def test_distances_on_a_sphere_are_those_along_great_circles(kind: str, least: float, mean: float, most: float, make):
    """Each by what its method is known to be off; edges inscribed in a sphere are shorter than its arcs."""
    sphere = make.sphere(4)
    starts, ends = pairs(sphere.n_points, 60)
    arcs = np.arccos(np.clip((sphere.points[starts] * sphere.points[ends]).sum(axis=1), -1, 1))
    ratios = (
        geodesic_distances(sphere.points, sphere.faces, starts, ends, geodesics=kind)[arcs > 0.4] / arcs[arcs > 0.4]
    )
    assert least < ratios.min() and ratios.max() < most
    assert ratios.mean() == pytest.approx(mean, abs=0.003)


def test_the_default_is_along_edges(make, graph) -> None:
    blob = make.blob(3)
    starts, ends = pairs(blob.n_points, 50)
    expected = pair_distances(graph, starts, ends)
    np.testing.assert_array_equal(geodesic_distances(blob.points, blob.faces, starts, ends), expected)


def test_no_straightened_path_is_longer_than_the_one_along_edges(make) -> None:
    blob = make.blob(3)
    starts, ends = pairs(blob.n_points, 50)
    edges, exact = (
        geodesic_distances(blob.points, blob.faces, starts, ends, geodesics=kind) for kind in ("dijkstra", "exact")
    )
    assert (exact <= edges + 1e-12).all() and (exact < 0.99 * edges).any()
    assert (exact >= np.linalg.norm(blob.points[starts] - blob.points[ends], axis=1) - 1e-12).all()


@pytest.mark.parametrize("kind", ["dijkstra", "heat", "exact"])
def test_pieces_and_points_without_faces_are_infinitely_far_and_a_point_is_at_itself(kind: str, make) -> None:
    """The first sphere lacks a face, so that its boundary counts as well."""
    one = make.sphere(1)
    points = np.concatenate([one.points, [[9.0, 9, 9]], one.points + 5])
    faces = np.concatenate([one.faces[1:], one.faces + 43])
    starts, ends = np.array([0, 0, 42, 42, 7, 50]), np.array([7, 50, 0, 42, 7, 60])
    found = geodesic_distances(points, faces, starts, ends, geodesics=kind)
    assert np.isinf(found[[1, 2]]).all() and (found[[3, 4]] == 0).all()
    arc = np.arccos(one.points[7] @ one.points[17])
    assert found[5] == pytest.approx(arc, rel=0.15)


def test_what_cannot_be_measured_says_so(make, monkeypatch) -> None:
    sphere = make.sphere(1)
    twisted = sphere.faces.copy()
    twisted[3] = twisted[3][::-1]
    one, other = np.array([1]), np.array([3])
    with pytest.raises(ShapeError, match='geodesics="exact" needs'):
        geodesic_distances(sphere.points, twisted, one, other, geodesics="exact")
    with pytest.raises(ArgumentError, match="must be one of dijkstra, heat, exact; did you mean 'exact'"):
        geodesic_distances(sphere.points, sphere.faces, one, other, geodesics="exat")
    monkeypatch.setitem(sys.modules, "potpourri3d", None)
    with pytest.raises(MissingExtraError, match=r"homolog\[geodesics\]"):
        geodesic_distances(sphere.points, sphere.faces, one, other, geodesics="heat")
