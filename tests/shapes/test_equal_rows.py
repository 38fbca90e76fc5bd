"""Equal rows: compared with a slow loop, whatever the hashes do."""

from __future__ import annotations

import numpy as np
import pytest

from homolog.shapes import equal_rows
from homolog.shapes.equal_rows import first_of_equal_rows


def slow(rows: np.ndarray) -> list[int]:
    """The first row that is equal, one by one."""
    return [next((j for j in range(i) if (rows[j] == rows[i]).all()), i) for i in range(len(rows))]


@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int64, np.int32, np.uint8])
def test_first_of_equal_rows(dtype: type) -> None:
    rows = np.random.default_rng(0).integers(0, 4, (150, 3)).astype(dtype)
    assert first_of_equal_rows(rows).tolist() == slow(rows)


def test_no_rows_one_row_and_rows_without_equal_ones() -> None:
    assert first_of_equal_rows(np.zeros((0, 3))).tolist() == []
    assert first_of_equal_rows(np.zeros((1, 3))).tolist() == [0]
    assert first_of_equal_rows(np.arange(30.0).reshape(10, 3)).tolist() == [*range(10)]


def test_zeros_of_both_signs_are_equal_and_nan_is_not() -> None:
    rows = np.array([[0.0, 1], [np.nan, 2], [-0.0, 1], [np.nan, 2], [np.inf, 3], [np.inf, 3], [-np.inf, 3]])
    assert first_of_equal_rows(rows).tolist() == [0, 1, 0, 3, 4, 4, 6]


def test_negative_and_large_numbers() -> None:
    rows = np.array([[-1, 2**40], [2**40, -1], [-1, 2**40], [1, 2**40]])
    assert first_of_equal_rows(rows).tolist() == [0, 1, 0, 3]


def test_rows_with_one_hash_are_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = np.random.default_rng(1).integers(0, 3, (90, 3))
    monkeypatch.setattr(equal_rows, "_hashes", lambda rows: np.asarray(rows[:, 0] > 1).astype(np.uint64))
    assert first_of_equal_rows(rows).tolist() == slow(rows)
