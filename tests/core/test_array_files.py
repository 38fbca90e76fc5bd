"""NumPy's files: what NumPy wrote is read, and what lies about its size is refused before memory is taken."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from homolog.core.array_files import ArrayFileError, open_npz, read_npy
from homolog.core.errors import ArgumentError


def head(shape: tuple[int, ...], dtype: str = "<f8") -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": dtype, "fortran_order": False, "shape": shape})
    return stream.getvalue()


@pytest.mark.parametrize("dtype", ["<f4", ">f8", "i2", "?", "<U3", "<c16"])
@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("shape", [(5, 3), (4,), (), (0, 3)])
def test_what_numpy_wrote(tmp_path: Path, dtype: str, order: str, shape: tuple[int, ...]) -> None:
    values = np.ones(shape, dtype=dtype)
    np.save(tmp_path / "a.npy", np.asarray(values, order=order))  # type: ignore[call-overload]
    np.savez(tmp_path / "a.npz", a=values)
    np.savez_compressed(tmp_path / "b.npz", a=values, b=values)
    with open_npz(tmp_path / "a.npz") as one, open_npz(tmp_path / "b.npz") as two:
        assert (one.names, two.names) == (["a"], ["a", "b"])
        found = [read_npy(tmp_path / "a.npy"), one["a"], two["b"]]
    for array in found:
        assert array.dtype == values.dtype
        np.testing.assert_array_equal(array, values)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (head((10**12, 3)), "announces 3000000000000 numbers"),
        (head((2**62, 2**62)), "announces"),
        (head((3,), "|O"), "object"),
        (head((3,))[:-20] + b"\n" + bytes(24), "damaged header|ends"),
        (b"\x93NUMPY\1\0\xff\xff{'shape': ((((((", "damaged header"),
        (head((40,)) + bytes(8), "announces 40 numbers"),
        (b"PK\3\4 no array", "no NumPy array"),
        (head((3,), "<V99999999"), "announces"),
    ],
)
def test_headers_that_lie(tmp_path: Path, content: bytes, reason: str) -> None:
    (tmp_path / "a.npy").write_bytes(content)
    with pytest.raises(ArrayFileError, match=reason):
        read_npy(tmp_path / "a.npy")
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", content)
    with open_npz(tmp_path / "a.npz") as stored, pytest.raises(ArrayFileError, match=reason):
        stored["a"]


def test_expansion_is_bounded_and_the_bound_can_be_raised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.savez_compressed(tmp_path / "a.npz", a=np.zeros(15_000_000))
    with open_npz(tmp_path / "a.npz") as stored:
        with pytest.raises(ArrayFileError, match=r"a.npy.*228.9 MB.*HOMOLOG_EXPANSION_MB"):
            stored["a"]
        monkeypatch.setenv("HOMOLOG_EXPANSION_MB", "300")
        assert stored["a"].shape == (15_000_000,)
        monkeypatch.setenv("HOMOLOG_EXPANSION_MB", "much")
        with pytest.raises(ArgumentError, match="HOMOLOG_EXPANSION_MB is 'much'"):
            stored["a"]


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_compression_is_refused(tmp_path: Path, method: int) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w", method) as archive:
        archive.writestr("a.npy", head((3,)) + bytes(24))
    with open_npz(tmp_path / "a.npz") as stored, pytest.raises(ArrayFileError, match="NumPy does not write"):
        stored["a"]


def test_damaged_archives(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "a.npz", a=np.random.default_rng(0).random(1000))
    content = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(content[:-30])
    with pytest.raises(ArrayFileError, match="no archive"), open_npz(tmp_path / "cut.npz"):
        pass
    (tmp_path / "flipped.npz").write_bytes(content[:3000] + b"x" * 9 + content[3009:])
    with open_npz(tmp_path / "flipped.npz") as stored, pytest.raises(ArrayFileError, match=r"a.npy.* is damaged"):
        stored["a"]
