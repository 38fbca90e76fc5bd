"""Nearest rows and Sinkhorn's soft map against dense float64 references, at any working memory."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.special import logsumexp, softmax
from torch import Tensor

from homolog.core.errors import ArgumentError
from homolog.core.memory import working_memory
from homolog.maps import SoftMatches, most_similar, nearest_neighbour, normalised, sinkhorn_matches

MEMORIES = (1e-6, 0.005, 0.05, 1.0, 1024.0)


def random(*shape: int, seed: int = 0, scale: float = 1.0) -> Tensor:
    return scale * torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def dense_sinkhorn(y: Tensor, x: Tensor, temperature: float, iterations: int) -> np.ndarray:
    """In the logarithm, in float64: columns first, rows last."""
    logits = y.double().numpy() @ x.double().numpy().T / temperature
    for _ in range(iterations):
        logits = logits - logsumexp(logits, axis=0, keepdims=True)
        logits = logits - logsumexp(logits, axis=1, keepdims=True)
    return np.exp(logits)


def soft_map(found: SoftMatches, y: Tensor, x: Tensor, temperature: float) -> np.ndarray:
    """The soft map that the scalings make."""
    logits = y.double().numpy() @ x.double().numpy().T / temperature
    return np.exp(logits + np.asarray(found.row_scaling)[:, None] + np.asarray(found.column_scaling))


def assert_matches(
    found: SoftMatches, y: Tensor, x: Tensor, *, temperature: float, iterations: int = 10, atol: float = 1e-4
) -> None:
    """Every entry, the columns' sums, and the argmaxima up to ties within the tolerance."""
    soft = dense_sinkhorn(y, x, temperature, iterations)
    rebuilt = soft_map(found, y, x, temperature)
    rows, columns = np.arange(soft.shape[0]), np.arange(soft.shape[1])
    np.testing.assert_allclose(rebuilt, soft, atol=atol)
    np.testing.assert_allclose(rebuilt.sum(axis=0), soft.sum(axis=0), atol=atol * 10)
    np.testing.assert_allclose(soft[rows, np.asarray(found.y_to_x)], soft.max(axis=1), atol=atol)
    np.testing.assert_allclose(soft[np.asarray(found.x_to_y), columns], soft.max(axis=0), atol=atol)


@pytest.mark.parametrize("memory", MEMORIES)
def test_nearest_and_most_similar_equal_brute_force(memory: float) -> None:
    queries, candidates = random(301, 6), random(173, 6, seed=1) + 50  # far from the origin
    queries = queries + 50
    distances = (queries[:, None].double() - candidates[None].double()).square().sum(dim=2)
    products = queries.double() @ candidates.double().T
    with working_memory(memory):
        near, similar = nearest_neighbour(queries, candidates), most_similar(queries - 50, candidates - 50)
    assert torch.equal(near.index, distances.argmin(dim=1))
    torch.testing.assert_close(near.value.double(), distances.min(dim=1).values, atol=1e-4, rtol=1e-4)
    products = (queries.double() - 50) @ (candidates.double() - 50).T
    assert torch.equal(similar.index, products.argmax(dim=1))
    torch.testing.assert_close(similar.value.double(), products.max(dim=1).values, atol=1e-4, rtol=1e-4)


def test_a_row_finds_itself_at_no_distance_and_arrays_are_taken() -> None:
    rows = random(50, 4).numpy()
    found = nearest_neighbour(rows, rows)
    np.testing.assert_array_equal(found.index, np.arange(50))
    assert isinstance(found.value, np.ndarray) and (found.value >= 0).all() and found.value.max() < 1e-5


def test_normalised_rows_have_length_one_or_none() -> None:
    rows = random(5, 3) * torch.tensor([[1e-3], [1.0], [1e3], [7.0], [0.0]])
    unit = normalised(rows)
    torch.testing.assert_close(unit.norm(dim=1), torch.tensor([1.0, 1, 1, 1, 0]))
    torch.testing.assert_close(unit[:4] * rows[:4].norm(dim=1, keepdim=True), rows[:4])


@pytest.mark.parametrize("memory", MEMORIES)
@pytest.mark.parametrize("shape", [(90, 90), (130, 61), (40, 150), (1, 5), (5, 1)])
@pytest.mark.parametrize("scale", [1.0, 3.0, 14.0], ids=["plain", "beyond float32", "large"])
def test_sinkhorn_equals_the_dense_iteration(scale: float, shape: tuple[int, int], memory: float) -> None:
    y, x = normalised(random(shape[0], 12)) * scale, normalised(random(shape[1], 12, seed=1)) * scale
    for iterations in (1, 2, 10):
        with working_memory(memory):
            found = sinkhorn_matches(y, x, temperature=0.2, iterations=iterations)
        assert_matches(found, y, x, temperature=0.2, iterations=iterations, atol=2e-4 if scale < 10 else 5e-3)


@pytest.mark.parametrize("size", [20.0, 24.9, 25.1, 60.0])
def test_logits_around_the_bound_of_plain_exponentials(size: float) -> None:
    # Logits of exactly +-size: the worst that the plain way is trusted with.
    signs = torch.sign(random(50, 1))
    y = torch.cat([signs * size, torch.zeros(50, 1)], dim=1)
    x = torch.cat([torch.sign(random(70, 1, seed=1)), torch.zeros(70, 1)], dim=1)
    found = sinkhorn_matches(y, x, temperature=1.0)
    assert_matches(found, y, x, temperature=1.0)


@pytest.mark.parametrize("memory", [1e-6, 1024.0])
def test_logits_of_a_thousand_neither_overflow_nor_vanish(memory: float) -> None:
    # A permuted copy at logits of +-1000: the permutation is the soft map.
    order = torch.randperm(40, generator=torch.Generator().manual_seed(3))
    x = torch.linalg.qr(random(40, 40)).Q
    y = x[order] - 2 * x[order.roll(1)]
    with working_memory(memory):
        found = sinkhorn_matches(1000 * y, x, temperature=1.0)
    # In float32 a scaling of a thousand is rounded by 6e-5.
    permutation = np.eye(40)[order.numpy()]
    np.testing.assert_allclose(soft_map(found, 1000 * y, x, 1.0), permutation, atol=1e-3)
    assert torch.equal(found.y_to_x, order)
    assert torch.equal(found.x_to_y[order], torch.arange(40))
    assert_matches(found, 1000 * y, x, temperature=1.0, atol=1e-3)


def test_rows_are_normalised_last_and_columns_first() -> None:
    y, x = random(30, 5), random(20, 5, seed=1)
    once = sinkhorn_matches(y, x, temperature=1.0, iterations=1)
    kernel = np.exp(y.double().numpy() @ x.double().numpy().T)
    soft = kernel / kernel.sum(axis=0)
    soft = soft / soft.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(soft_map(once, y, x, 1.0), soft, atol=1e-5)
    assert_matches(once, y, x, temperature=1.0, iterations=1)
    assert abs(soft.sum(axis=0) - 1.5).max() > 0.1  # not yet balanced
    many = sinkhorn_matches(y, x, temperature=1.0, iterations=200)
    np.testing.assert_allclose(soft_map(many, y, x, 1.0).sum(axis=0), 1.5, atol=1e-3)


@pytest.mark.parametrize("options", [{"temperature": 0.0}, {"temperature": -1.0}, {"temperature": float("nan")}])
def test_a_temperature_that_is_not_positive_is_refused(options: dict) -> None:
    with pytest.raises(ArgumentError, match="temperature"):
        sinkhorn_matches(random(3, 2), random(3, 2), **options)


def test_no_iteration_is_refused() -> None:
    with pytest.raises(ArgumentError, match="iterations"):
        sinkhorn_matches(random(3, 2), random(3, 2), iterations=0)


def test_arrays_in_arrays_out_and_nothing_is_written_to_the_inputs() -> None:
    y, x = random(12, 3), random(9, 3, seed=1)
    kept = y.clone(), x.clone()
    from_tensors, from_arrays = sinkhorn_matches(y, x), sinkhorn_matches(y.numpy(), x.numpy())
    np.testing.assert_array_equal(from_arrays.y_to_x, from_tensors.y_to_x)
    np.testing.assert_array_equal(from_arrays.column_scaling, from_tensors.column_scaling)
    assert isinstance(from_arrays.row_scaling, np.ndarray)
    assert torch.equal(y, kept[0]) and torch.equal(x, kept[1])


@pytest.mark.reference
@pytest.mark.parametrize("memory", [16.0, 1024.0])
def test_clouds_are_matched_as_by_the_published_code(memory: float, faust) -> None:
    y, x = (torch.from_numpy(faust[f"{side}_cloud_features"]) for side in "yx")
    with working_memory(memory):
        found = sinkhorn_matches(y, x)
    assert (found.y_to_x.numpy() == faust["cloud_p2p_y_to_x"]).mean() >= 0.999
    column_sums = np.zeros(len(x))
    for rows in np.array_split(np.arange(len(y)), 8):
        soft = np.exp((y[rows] @ x.T / 0.2 + found.row_scaling[rows, None] + found.column_scaling).numpy())
        np.testing.assert_allclose(soft.max(axis=1), faust["cloud_row_max"][rows], atol=1e-3)
        column_sums += soft.sum(axis=0)
    np.testing.assert_allclose(column_sums, faust["cloud_col_sum"], rtol=1e-2, atol=1e-3)


@pytest.mark.reference
def test_a_part_is_matched_by_similarity_as_by_the_published_code(reference) -> None:
    with np.load(reference / "cuts_david.npz") as stored:
        partial, complete = stored["partial_features"], stored["complete_features"]
        expected, row_max = stored["p2p_partial_to_complete"], stored["row_max"]
    found = most_similar(partial, complete)
    assert (found.index == expected).mean() >= 0.999
    for rows in np.array_split(np.arange(len(partial)), 8):
        soft = softmax(partial[rows].astype(np.float64) @ complete.T.astype(np.float64) / 0.2, axis=1)
        np.testing.assert_allclose(soft[np.arange(len(rows)), found.index[rows]], row_max[rows], atol=1e-3)
