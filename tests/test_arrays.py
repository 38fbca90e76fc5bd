"""Functions of tensors that take numpy arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch import Tensor

from homolog.arrays import takes_arrays


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
