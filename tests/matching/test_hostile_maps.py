"""Point maps of other programs that are damaged, or made to fill the memory."""

import os

import numpy as np
import pytest
import scipy.io

from homolog.core.errors import DataError
from homolog.matching import read_point_map


def refused(path, *words):
    with pytest.raises(DataError) as caught:
        read_point_map(path)
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) < 400
    for word in (path.name, *words):
        assert word in message, message


def test_matlab_files_are_read_as_scipy_reads_them(tmp_path):
    values = np.arange(1, 6)
    scipy.io.savemat(tmp_path / "a.mat", {"map": values, "name": "x", "cells": np.array([1, "a"], dtype=object)})
    np.testing.assert_array_equal(read_point_map(tmp_path / "a.mat"), values - 1)


@pytest.mark.long
def test_expansion_is_bounded(tmp_path):
    zeros = np.zeros(27_000_000)  # 216 MB, a little more than any file may expand to
    scipy.io.savemat(tmp_path / "a.mat", {"map": zeros}, do_compression=True)
    refused(tmp_path / "a.mat", "HOMOLOG_EXPANSION_MB")
    np.savez_compressed(tmp_path / "a.npz", map=zeros)
    refused(tmp_path / "a.npz", "HOMOLOG_EXPANSION_MB")


@pytest.mark.slow
def test_flipped_bytes_crash_nothing(tmp_path):
    """Some make SciPy's reader write where it must not."""
    path, random = tmp_path / "a.mat", np.random.default_rng(0)
    scipy.io.savemat(path, {"map": np.arange(1, 43), "first_index": 1})
    content = np.frombuffer(path.read_bytes(), np.uint8)
    for _ in range(20):
        changed = content.copy()
        changed[random.integers(128, len(content), 4)] ^= 1 << random.integers(0, 8, 4).astype(np.uint8)
        path.write_bytes(changed.tobytes())
        try:
            read_point_map(path)
        except DataError as error:
            assert str(error).isprintable()


def test_pipes_are_not_waited_for(tmp_path):
    for suffix in (".txt", ".vts", ".map", ".mat", ".npz"):
        path = tmp_path / f"pipe{suffix}"
        os.mkfifo(path)
        refused(path, "ordinary file")


@pytest.mark.parametrize(
    ("values", "told"),
    [
        (np.array([0, 1, np.nan]), "holds nan"),
        (np.array([0, 1.5]), "holds 1.5"),
        (np.array([0, 1e300]), "holds 1e+300"),
        (np.full(3, np.longdouble("1e4000")), "one whole number per point"),
        (np.full(3, -(2**63)), "holds -9223372036854775808"),
        (np.full(3, 2**63, "u8"), "holds 9223372036854775808"),
        (np.array([0, 1j]), "complex128"),
        (np.array([True, False]), "bool"),
        (np.array(["0", "1"]), "<U1"),
        (np.array([0, 1], "m8[s]"), "timedelta64[s]"),
        (np.zeros(3, [("x" * 300, "i4")]), "[('xxx"),
        (np.zeros((3, 3), int), "of shape (3, 3)"),
        (np.zeros((2,) * 14, int), "of shape (2, 2"),
        (np.array([0, None]), "object"),
    ],
)
def test_arrays_that_are_no_map(tmp_path, recwarn, values, told):
    np.savez(tmp_path / "a.npz", target_to_source=values)
    refused(tmp_path / "a.npz", told)
    assert not recwarn.list


@pytest.mark.parametrize("kind", ["<f8", "<f2", "g", ">i8", "u1", "<u8"])
def test_arrays_that_are_a_map(tmp_path, kind):
    np.savez(tmp_path / "a.npz", target_to_source=np.array([2, 0, 1], kind), notes=np.array([None, {}]))
    found = read_point_map(tmp_path / "a.npz")
    assert found.dtype == np.int64 and found.tolist() == [2, 0, 1]


@pytest.mark.parametrize("first", [2, 0.5, np.nan, [0, 1]])
def test_the_first_index_of_a_matlab_file_is_checked(tmp_path, first):
    scipy.io.savemat(tmp_path / "a.mat", {"map": np.arange(1, 6), "first_index": first})
    refused(tmp_path / "a.mat", "first_index is ", "must be 0 or 1; give base")
    np.testing.assert_array_equal(read_point_map(tmp_path / "a.mat", base=1), np.arange(5))


def test_names_in_archives_stay_on_one_line(tmp_path):
    np.savez(tmp_path / "a.npz", **{"a\nb\x1b": np.arange(5), "c" * 500: np.arange(5)})
    refused(tmp_path / "a.npz", "has no array 'target_to_source'")
