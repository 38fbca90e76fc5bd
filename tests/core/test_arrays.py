"""Functions of tensors that take numpy arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog import maps
from homolog.core.arrays import takes_arrays, takes_arrays_of_any_precision
from homolog.core.errors import ArgumentError
from homolog.maps import losses


@dataclass(frozen=True)
class Both:
    total: Tensor
    note: str


@takes_arrays
def doubled(values: Tensor, *, times: int = 2) -> Tensor:
    assert isinstance(values, Tensor)
    return values * times


@takes_arrays
def summed(first: Tensor, second: Tensor) -> tuple[Tensor, Both, int]:
    return first + second, Both((first * second).sum(), "kept"), 3


def test_tensors_pass_through_untouched() -> None:
    values = torch.arange(3.0, requires_grad=True)
    result = doubled(values, times=3)
    assert isinstance(result, Tensor)
    result.sum().backward()
    assert values.grad is not None and values.grad.tolist() == [3, 3, 3]


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int64])
def test_arrays_give_arrays_of_the_same_type(dtype: type) -> None:
    values = np.arange(4, dtype=dtype)
    for result in (doubled(values), doubled(values=values)):
        assert isinstance(result, np.ndarray) and result.dtype == dtype
        np.testing.assert_array_equal(result, 2 * values)


def test_one_array_among_tensors_makes_all_results_arrays_tuples_and_dataclasses_too() -> None:
    total, both, number = summed(np.ones(3), torch.full((3,), 2.0, dtype=torch.float64))
    np.testing.assert_array_equal(total, [3, 3, 3])
    assert isinstance(both, Both) and isinstance(both.total, np.ndarray) and both.total == 6
    assert both.note == "kept" and number == 3


def test_read_only_strided_and_columnwise_arrays_are_taken_and_never_written() -> None:
    @takes_arrays
    def zeroing(values: Tensor) -> Tensor:
        return values.zero_()

    locked = np.ones(3)
    locked.flags.writeable = False
    zeroing(locked)
    np.testing.assert_array_equal(locked, 1)

    base = np.arange(12.0).reshape(3, 4)
    np.testing.assert_array_equal(doubled(base[:, ::2]), 2 * base[:, ::2])
    np.testing.assert_array_equal(doubled(np.asfortranarray(base)), 2 * base)


def test_reversed_arrays_are_taken() -> None:
    np.testing.assert_array_equal(doubled(np.arange(3.0)[::-1]), [4, 2, 0])


def test_results_do_not_carry_a_gradient() -> None:
    weight = torch.ones(3, requires_grad=True)
    total, _, _ = summed(np.ones(3, dtype=np.float32), weight)
    np.testing.assert_array_equal(total, [2, 2, 2])


@takes_arrays
def compared(x: Float[Tensor, "n d"], y: Float[Tensor, "m d"]) -> Tensor:
    return x @ y.T


@takes_arrays
def picked(x: Float[Tensor, "n 3"], index: Int[Tensor, " n"]) -> Tensor:
    return x[index]


@takes_arrays_of_any_precision
def solved(x: Float[Tensor, "*batch k c"], y: Float[Tensor, "*batch k c"]) -> Tensor:
    return x.double() - y.double()


WHOLE = torch.zeros(5, dtype=torch.int64)
MISFITS = {
    "list": (
        lambda: compared([[1.0]], torch.ones(2, 1)),
        "x is a list, but must be a tensor or numpy array of shape (n, d)",
    ),
    "dimensions": (lambda: compared(torch.ones(2), torch.ones(2, 1)), "x has shape (2,), but must have shape (n, d)"),
    "too many": (lambda: picked(torch.ones(1, 5, 3), WHOLE), "x has shape (1, 5, 3), but must have shape (n, 3)"),
    "width": (
        lambda: compared(torch.ones(2, 4), y=torch.ones(2, 3)),
        "y has shape (2, 3), but must have shape (m, d) with d = 4, as x has it",
    ),
    "fixed width": (lambda: picked(torch.ones(5, 2), WHOLE), "x has shape (5, 2), but must have shape (n, 3)"),
    "no points": (
        lambda: compared(np.ones((0, 4)), np.ones((2, 4))),
        "x has shape (0, 4), but must have shape (n, d), and nothing may be empty",
    ),
    "no features": (
        lambda: compared(torch.ones(3, 0), torch.ones(2, 0)),
        "x has shape (3, 0), but must have shape (n, d), and nothing may be empty",
    ),
    "precision": (
        lambda: compared(torch.ones(3, 2), np.ones((2, 2))),
        "y holds float64 and x float32, but both must hold the same",
    ),
    "whole numbers": (
        lambda: compared(torch.ones(3, 2, dtype=torch.int64), torch.ones(2, 2)),
        "x holds int64, but must hold real numbers, such as float32",
    ),
    "real index": (
        lambda: picked(torch.ones(5, 3), torch.ones(5)),
        "index holds float32, but must hold whole numbers, int64",
    ),
    "length": (
        lambda: picked(torch.ones(4, 3), WHOLE),
        "index has shape (5,), but must have shape (n,) with n = 4, as x has it",
    ),
    "objects": (
        lambda: compared(np.full((2, 2), None), np.ones((2, 2))),
        "x holds object, but must hold numbers, such as float32 or int64",
    ),
    "batch": (
        lambda: solved(torch.ones(7, 2, 3), torch.ones(7, 2, 4)),
        "y has shape (7, 2, 4), but must have shape (..., k, c) with c = 3, as x has it",
    ),
    "device": (
        lambda: compared(torch.ones(3, 2), torch.ones(3, 2, device="meta")),
        "y is on meta and x on cpu, but both must be on one device",
    ),
}


@pytest.mark.parametrize("misfit", MISFITS)
def test_what_does_not_fit_is_refused_in_a_line(misfit: str) -> None:
    call, said = MISFITS[misfit]
    with pytest.raises(ArgumentError) as caught:
        call()
    assert str(caught.value) == said


def test_what_fits_passes() -> None:
    compared(torch.ones(2, 3), torch.ones(4, 3))
    picked(np.ones((5, 3)), np.zeros(5, dtype=np.int32))
    solved(torch.ones(7, 2, 3), torch.ones(2, 3, dtype=torch.float64))


def test_missing_and_surplus_arguments_are_for_python_to_refuse() -> None:
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'y'"):
        compared(torch.ones(2, 3))  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="takes 2 positional arguments but 3 were given"):
        picked(np.ones((5, 3)), np.zeros(5, dtype=int), np.ones(2))  # type: ignore[call-arg]


FEATURES = {
    "nearest_neighbour": lambda x, y: maps.nearest_neighbour(x, y),
    "most_similar": lambda x, y: maps.most_similar(x, y),
    "sinkhorn_matches": lambda x, y: maps.sinkhorn_matches(x, y),
    "functional_map": lambda x, y: maps.functional_map(x, y, torch.ones(len(y), len(x))),
    "infonce_loss": lambda x, y: losses.infonce_loss(x, y),
}


@pytest.mark.parametrize("name", FEATURES)
@pytest.mark.parametrize(("first", "second"), [((6, 0), (6, 0)), ((0, 4), (6, 4)), ((6, 4), (0, 4)), ((6, 4), (6, 5))])
def test_features_that_cannot_be_compared(name: str, first: tuple[int, int], second: tuple[int, int]) -> None:
    for kind in (torch.ones, np.ones):
        with pytest.raises(ArgumentError, match=r"has shape \(\d, \d\), but must have shape"):
            FEATURES[name](kind(first), kind(second))


@pytest.mark.parametrize("name", [name for name in FEATURES if name != "functional_map"])
def test_features_of_two_precisions(name: str) -> None:
    with pytest.raises(ArgumentError, match=r"holds float32 and .* float64, but both must hold the same"):
        FEATURES[name](torch.ones(6, 4, dtype=torch.float64), torch.ones(6, 4))


def test_more_eigenpairs_in_a_map_than_there_are() -> None:
    with pytest.raises(ArgumentError, match=r"c_xy has shape \(5, 7\).*at least 7 columns.*5, but they have 6 and 6"):
        maps.point_map_from_functional_map(torch.ones(5, 7), torch.ones(9, 6), torch.ones(8, 6))
