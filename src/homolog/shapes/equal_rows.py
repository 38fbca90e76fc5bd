"""Equal rows of an array, found by sorting their hashes."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int, Num, UInt64

# Odd numbers without a pattern (of the golden ratio, and of MurmurHash3's finaliser), by which a hash is multiplied.
_STEP, _MIX = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xFF51AFD7ED558CCD)
_HALF = np.uint64(32)


def first_of_equal_rows(rows: Num[np.ndarray, "n d"]) -> Int[np.ndarray, " n"]:
    """For each row, the index of the first row equal to it, perhaps its own. NaN equals nothing."""
    if not len(rows):
        return np.zeros(0, dtype=np.int64)
    # Both sorts are stable, so that within a run of equal rows the first index comes first.
    hashes = _hashes(rows)
    order = np.argsort(hashes, kind="stable")
    same_hash = np.diff(hashes[order]) == 0
    equal = np.zeros(len(rows), dtype=bool)
    equal[1:][same_hash] = (rows[order[:-1][same_hash]] == rows[order[1:][same_hash]]).all(axis=1)
    if equal[1:].sum() < same_hash.sum():  # different rows with one hash, next to none but of NaN
        order = np.lexsort(rows.T)
        equal[1:] = (rows[order[:-1]] == rows[order[1:]]).all(axis=1)
    first = np.empty(len(rows), dtype=np.int64)
    first[order] = order[~equal][np.cumsum(~equal) - 1]
    return first


def _hashes(rows: Num[np.ndarray, "n d"]) -> UInt64[np.ndarray, " n"]:
    """A number for each row, the same for equal ones."""
    found = np.zeros(len(rows), dtype=np.uint64)
    for column in rows.T:
        # Adding zero makes -0 and 0, which are equal, the same bits.
        bits = (column.astype(np.float64) + 0.0).view(np.uint64) if column.dtype.kind == "f" else column
        found = (found ^ bits.astype(np.uint64)) * _STEP
        found ^= found >> _HALF
        found *= _MIX
    return found
