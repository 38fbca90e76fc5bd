"""What Sinkhorn's map carries over, and its derivative, against the unrolled iterations in float64."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from homolog.core.errors import ArgumentError
from homolog.core.memory import working_memory
from homolog.maps import reference
from homolog.maps.sinkhorn import Kernel, _Derivative, carried_over

MEMORIES = (1e-6, 0.01, 1024.0)


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def unit(*shape: int, seed: int = 0) -> Tensor:
    return torch.nn.functional.normalize(random(*shape, seed=seed), dim=1)


def with_gradients(carry, y: Tensor, x: Tensor, functions: Tensor, weights: Tensor, iterations: int) -> list[Tensor]:
    y, x = y.clone().requires_grad_(), x.clone().requires_grad_()
    carried = carry(y, x, functions, iterations=iterations)
    return [carried.detach(), *torch.autograd.grad((carried * weights).sum(), (y, x))]


def assert_like_unrolled(y: Tensor, x: Tensor, *, iterations: int, memory: float, temperature: float = 1.0) -> None:
    """Within what the rounding of logits of this size does to the result, in both precisions."""
    functions, weights = random(len(x), 7, seed=11), random(len(y), 7, seed=12)
    scale = float((y @ x.T).abs().max()) / temperature

    def own(y: Tensor, x: Tensor, functions: Tensor, iterations: int) -> Tensor:
        return carried_over(y, x, functions, temperature=temperature, iterations=iterations)

    def truth(y: Tensor, x: Tensor, functions: Tensor, iterations: int) -> Tensor:
        return reference.soft_map(y, x, temperature=temperature, iterations=iterations) @ functions

    expected = with_gradients(truth, y, x, functions, weights, iterations)
    with working_memory(memory):
        double = with_gradients(own, y, x, functions, weights, iterations)
        # The values as float32 has them are the same in both, so that only the arithmetic differs.
        single = with_gradients(own, *(tensor.float() for tensor in (y, x, functions, weights)), iterations)
    size = functions.norm() * weights.norm()
    units = functions.norm(), size * x.norm(dim=1).max() / temperature, size * y.norm(dim=1).max() / temperature
    for i, most in enumerate(units):
        for found, precision in ((double[i], 1e-14), (single[i], 1e-6)):
            error = (found.double() - expected[i]).norm()
            assert error <= precision * max(scale, 1) * (expected[i].norm() + most), (i, found.dtype, error)


def rounded(tensor: Tensor) -> Tensor:
    return tensor.float().double()


@pytest.mark.parametrize("memory", MEMORIES)
@pytest.mark.parametrize("scale", [1.0, 5.0, 20.0, 100.0, 1000.0])
@pytest.mark.parametrize("shape", [(60, 60), (70, 50), (10, 90), (90, 3), (1, 4)], ids=str)
def test_carried_functions_and_gradients_are_those_of_unrolled_iterations(shape, scale: float, memory: float) -> None:
    y, x = rounded(scale * unit(shape[0], 12)), rounded(unit(shape[1], 12, seed=1))
    for iterations in (1, 10):
        assert_like_unrolled(y, x, iterations=iterations, memory=memory)


@pytest.mark.parametrize("memory", MEMORIES)
@pytest.mark.parametrize("scale", [1.0, 20.0, 1000.0])
@pytest.mark.parametrize("n_y", [40, 90])
def test_so_they_are_for_permuted_and_repeated_copies(n_y: int, scale: float, memory: float) -> None:
    x = rounded(unit(40, 12))
    order = torch.cat([torch.randperm(40, generator=torch.Generator().manual_seed(i)) for i in range(3)])[:n_y]
    for iterations in (1, 10):
        assert_like_unrolled(scale * x[order], x, iterations=iterations, memory=memory)


def test_and_for_another_temperature() -> None:
    assert_like_unrolled(rounded(unit(30, 5)), rounded(unit(20, 5, seed=1)), iterations=10, memory=1, temperature=0.07)


@pytest.mark.parametrize(
    ("scale", "shape", "absorbed", "exact"),
    [(20.0, (60, 60), False, False), (100.0, (60, 60), True, False), (1000.0, (60, 60), True, True)],
    ids=["plain", "absorbed", "left for the logarithm"],
)
def test_every_way_of_holding_the_kernel_is_among_those_compared(scale: float, shape, absorbed, exact, calls) -> None:
    absorbing, forward = calls(Kernel, "with_absorbed"), calls(Kernel, "exact_iteration")
    backward = calls(_Derivative, "_through_iteration_exactly")
    y, x = rounded(scale * unit(shape[0], 12)), rounded(unit(shape[1], 12, seed=1))
    assert_like_unrolled(y, x, iterations=10, memory=1024)
    assert (bool(absorbing), bool(forward), bool(backward)) == (absorbed, exact, exact)


@pytest.mark.parametrize("memory", [1e-6, 1024.0])
@pytest.mark.parametrize("scale", [1.0, 8.0])
@pytest.mark.parametrize(("shape", "iterations"), [((30, 20), 200), ((40, 2), 40), ((2, 40), 40)])
def test_scalings_that_drift_between_shapes_of_different_size_lose_nothing(
    shape, iterations: int, scale: float, memory: float
) -> None:
    # By log(n_y / n_x) in each iteration: 81 and 120 in all, beyond what float32 can exponentiate and invert.
    y, x = rounded(scale * random(shape[0], 5)), rounded(random(shape[1], 5, seed=1))
    assert_like_unrolled(y, x, iterations=iterations, memory=memory)


sizes, scales = st.integers(1, 30), st.sampled_from([0.1, 1.0, 10.0, 100.0, 1000.0])


@given(n_y=sizes, n_x=sizes, scale=scales, iterations=st.integers(1, 10), seed=st.integers(0, 1000))
def test_rows_sum_to_one(n_y: int, n_x: int, scale: float, iterations: int, seed: int) -> None:
    y, x = scale * unit(n_y, 4, seed=seed).float(), unit(n_x, 4, seed=seed + 1).float()
    carried = carried_over(y, x, torch.ones(n_x, 1), temperature=1.0, iterations=iterations)
    torch.testing.assert_close(carried, torch.ones(n_y, 1), atol=1e-6 * max(scale, 10), rtol=0)


@given(n_y=sizes, n_x=sizes, scale=scales, iterations=st.integers(1, 10), seed=st.integers(0, 1000))
def test_a_constant_on_all_logits_of_a_column_changes_nothing(
    n_y: int, n_x: int, scale: float, iterations: int, seed: int
) -> None:
    y, x = scale * unit(n_y, 4, seed=seed), unit(n_x, 4, seed=seed + 1)
    constants, functions = scale * random(n_x, 1, seed=seed + 2), random(n_x, 3, seed=seed + 3)
    shifted = torch.cat([y, torch.ones(n_y, 1)], dim=1), torch.cat([x, constants], dim=1)
    before, after = (
        carried_over(*features, functions, temperature=1.0, iterations=iterations) for features in ((y, x), shifted)
    )
    torch.testing.assert_close(after, before.to(after), atol=1e-10, rtol=1e-10)


def test_nor_does_one_on_all_logits_of_a_row_once_the_map_is_balanced() -> None:
    y, x, functions = random(15, 4), random(15, 4, seed=1), random(15, 3, seed=2)
    shifted = torch.cat([y, 3 * random(15, 1, seed=3)], dim=1), torch.cat([x, torch.ones(15, 1)], dim=1)
    before, after = (
        carried_over(*features, functions, temperature=1.0, iterations=1000) for features in ((y, x), shifted)
    )
    torch.testing.assert_close(after, before, atol=1e-8, rtol=0)


@pytest.mark.parametrize("scale", [20.0, 100.0, 1000.0], ids=["plain", "absorbed", "absorbed anew"])
@pytest.mark.parametrize(("memory", "most"), [(1024.0, 1), (8.0, 0)])
def test_at_most_one_array_between_all_points_is_held(memory: float, most: int, scale: float, large_tensors) -> None:
    n = 1500
    y, x = (scale * unit(n, 12)).float().requires_grad_(), unit(n, 12, seed=1).float().requires_grad_()
    with working_memory(memory), large_tensors(4 * n * n / 2) as seen:
        carried_over(y, x, random(n, 3).float(), temperature=1.0, iterations=3).square().sum().backward()
    assert seen.most_alive == most


def test_what_is_kept_for_the_derivative_grows_with_the_points_alone() -> None:
    kept = []
    y, x = random(300, 8).requires_grad_(), random(200, 8, seed=1).requires_grad_()
    with torch.autograd.graph.saved_tensors_hooks(lambda t: kept.append(t.numel()) or t, lambda t: t):
        carried_over(y, x, random(200, 3), iterations=10)
    assert sum(kept) == (300 + 200) * (8 + 10) + 200 * 3


def test_functions_are_not_derived_and_inputs_not_written_to() -> None:
    y, x, functions = (random(9, 4).requires_grad_(), random(8, 4, seed=1), random(8, 2, seed=2).requires_grad_())
    kept = [tensor.detach().clone() for tensor in (y, x, functions)]
    carried_over(y, x, functions).sum().backward()
    assert functions.grad is None and y.grad is not None
    assert all(torch.equal(before, after) for before, after in zip(kept, (y, x, functions), strict=True))


@pytest.mark.parametrize("options", [{"temperature": 0.0}, {"temperature": float("nan")}, {"iterations": 0}])
def test_settings_that_make_no_map_are_refused(options: dict) -> None:
    with pytest.raises(ArgumentError, match=next(iter(options))):
        carried_over(random(3, 2), random(3, 2), random(3, 1), **options)
