"""The working-memory bound, and memory that is kept."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from homolog.core.errors import ArgumentError
from homolog.core.memory import fits, get_working_memory, row_tiles, set_working_memory, working_memory


@given(
    n_rows=st.integers(0, 5000),
    bytes_per_row=st.floats(0, 1e8),
    mebibytes=st.floats(1e-6, 1e4),
)
def test_tiles_cover_every_row_once_in_order(n_rows: int, bytes_per_row: float, mebibytes: float) -> None:
    with working_memory(mebibytes):
        tiles = list(row_tiles(n_rows, bytes_per_row))
    assert [row for tile in tiles for row in range(tile.start, tile.stop)] == list(range(n_rows))
    assert all(tile.stop > tile.start for tile in tiles)


@given(n_rows=st.integers(2, 5000), bytes_per_row=st.integers(1, 10**7), mebibytes=st.floats(1e-3, 1e4))
def test_a_tile_stays_within_the_bound_unless_it_is_a_single_row(
    n_rows: int, bytes_per_row: int, mebibytes: float
) -> None:
    with working_memory(mebibytes):
        for tile in row_tiles(n_rows, bytes_per_row):
            height = tile.stop - tile.start
            assert height == 1 or height * bytes_per_row <= mebibytes * 2**20


def test_tiles_stay_small_where_much_memory_is_allowed() -> None:
    with working_memory(10_000):
        first = next(row_tiles(10**6, bytes_per_row=4 * 1000))
    assert (first.stop - first.start) * 4000 <= 4 * 2**20


@pytest.mark.parametrize(("mebibytes", "height"), [(1024, 128), (600, 128), (500, 16), (64, 16), (63, 1)])
def test_long_rows_still_come_by_the_hundred_or_in_sixteens_where_they_fit(mebibytes: float, height: int) -> None:
    with working_memory(mebibytes):
        assert next(row_tiles(1000, bytes_per_row=2**22)) == slice(0, height)


def test_fits_compares_with_the_bound_in_mebibytes() -> None:
    with working_memory(2):
        assert fits(2 * 2**20)
        assert not fits(2 * 2**20 + 1)


def test_the_bound_returns_after_a_block_even_when_it_fails() -> None:
    before = get_working_memory()
    with pytest.raises(RuntimeError), working_memory(3):
        assert get_working_memory() == 3
        raise RuntimeError
    assert get_working_memory() == before


def test_setting_the_bound_lasts() -> None:
    before = get_working_memory()
    try:
        set_working_memory(17)
        assert get_working_memory() == 17
    finally:
        set_working_memory(before)


@pytest.mark.parametrize("value", [0, -1, float("nan")])
def test_a_bound_that_is_not_positive_is_refused_and_changes_nothing(value: float) -> None:
    before = get_working_memory()
    with pytest.raises(ArgumentError, match="working memory"):
        set_working_memory(value)
    assert get_working_memory() == before


_HANDED_OUT = """
import resource, sys
import numpy as np
from homolog.core.memory import keep_freed_memory

def pages_handed_out():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    arrays = [np.ones(2**20) for _ in range(12)]
    del arrays
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

if sys.argv[1] == "kept":
    keep_freed_memory()
pages_handed_out()
print(pages_handed_out())
"""


@pytest.mark.process
@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library")
def test_memory_that_is_kept_need_not_be_handed_out_again() -> None:
    """In processes of their own: what else a process did with its memory has a say."""
    pages = {
        way: int(subprocess.run([sys.executable, "-c", _HANDED_OUT, way], capture_output=True, check=True).stdout)
        for way in ("kept", "given back")
    }
    assert 10 * pages["kept"] < pages["given back"]
