"""What Python and its libraries say of damage, in our words."""

import io
import json
import zlib
from pathlib import Path

import numpy as np
import pytest

from homolog.core.array_files import ArrayFileError, open_npz, read_npy
from homolog.core.errors import ArgumentError
from homolog.core.reasons import reason_of
from homolog.core.settings import read_toml


def raised(call):
    with pytest.raises(Exception) as caught:
        call()
    return caught.value


def rows(text):
    return lambda: np.loadtxt(io.StringIO(text), ndmin=1)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: b"\xff".decode(), "it is no text in UTF-8"),
        (lambda: json.loads('{"a":\n 1,}'), "it is no valid JSON at line 2, column 4"),
        (lambda: Path("none.txt").read_bytes(), "No such file or directory"),
        (lambda: {}["method"], "it has no entry 'method'"),
        (lambda: [][3], "a number in it leads nowhere"),
        (lambda: None.size, "one of its entries is of another kind than it should be"),
        (lambda: zlib.decompress(b"no"), "its compressed data are damaged"),
        (rows("1\nx\n"), "row 2 holds 'x', which is no such number"),
        (rows("1\n2 3\n"), "row 2 has 2 columns, others have another number"),
    ],
)
def test_errors_of_python_and_its_libraries(call, said):
    found = reason_of(raised(call))
    assert found.startswith(said) and "\n" not in found


def test_text_that_is_no_utf_8_in_settings(tmp_path):
    path = tmp_path / "a.toml"
    path.write_bytes(b"a = '\xff'")
    with pytest.raises(ArgumentError) as caught:
        read_toml(path)
    assert str(caught.value) == f"{path} cannot be read (it is no text in UTF-8); give a TOML file"


def test_damaged_headers_and_archives_say_nothing_of_parsers(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, np.zeros(3))
    content = path.read_bytes()
    path.write_bytes(content.replace(b"'fortran_order'", b"((((((((((((((("))
    with pytest.raises(ArrayFileError) as caught:
        read_npy(path)
    assert str(caught.value) == "its array has a damaged header"
    np.savez_compressed(tmp_path / "a.npz", a=np.arange(1000))
    content = bytearray((tmp_path / "a.npz").read_bytes())
    content[60:100] = bytes(40)
    (tmp_path / "a.npz").write_bytes(content)
    with open_npz(tmp_path / "a.npz") as stored, pytest.raises(ArrayFileError, match="damaged") as caught:
        stored["a"]
    assert not any(word in str(caught.value) for word in ("Error", "CRC", "codec", "decompress"))
