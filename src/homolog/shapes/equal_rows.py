"""Equal rows of an array, found by sorting."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int, Num


def first_of_equal_rows(rows: Num[np.ndarray, "n d"]) -> Int[np.ndarray, " n"]:
    """For each row, the index of the first row equal to it, perhaps its own. NaN equals nothing."""
    if not len(rows):
        return np.zeros(0, dtype=np.int64)
    # lexsort is stable, so that within a run of equal rows the first index comes first
    order = np.lexsort(rows.T)
    ordered = rows[order]
    starts_run = np.concatenate([[True], np.any(ordered[1:] != ordered[:-1], axis=1)])
    run_start = order[starts_run]
    first = np.empty(len(rows), dtype=np.int64)
    first[order] = run_start[np.cumsum(starts_run) - 1]
    return first
