"""What Python and its libraries say of damage, in our words."""

import csv
import io
import json
import zlib
from pathlib import Path

import numpy as np
import pytest
import torch

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
        (lambda: list(csv.reader(["a" * 200_000])), "it has a cell of more than 131072 characters"),
        (lambda: float("x"), "'x' stands where a number should"),
        (lambda: int("x"), "'x' stands where a whole number should"),
        (lambda: torch.empty(10**9, 10**10, device="meta"), "its sizes are too large for any computer"),
        (lambda: torch.empty(-1, device="meta"), "one of its sizes is below 0"),
        (lambda: int("9" * 5000), "it holds a whole number of more than 64 bits"),
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


@pytest.mark.parametrize(
    ("line", "column", "said"),
    [
        ("a = yes", 5, "what follows = must be a number, true, false, a text in quotes, a list or a table"),
        ("a 5", 3, "a key must be followed by = and its value"),
        ("a = 1 2", 7, "a line must hold one entry, and texts stand in quotes"),
        ("first = 2 # again", 10, "a key must not stand twice in its section"),
        ("a = {b = 1, b = 2}", 18, "a key must not stand twice in its section"),
        ("[s]", 3, "a section must not stand twice"),
        ("[[table]]", 8, "a list or table in one line must hold all its entries there"),
        ("a = [1, 2}", 10, "a list must end with ]"),
        ("a = {b = 1]", 11, "a table in one line must end with }"),
        ('a = "x', 7, "a text in quotes must end on its line, unless there are three quotes"),
        ('a = "\x01"', 6, "a text must have no control characters"),
        (r'a = "C:\data"', 10, r"in double quotes a \ must be written as \\, or the quotes be single"),
        ("a. = 1", 4, "a key must be of letters, digits, _ and -, or stand in quotes"),
        ("a = 2023-02-30", 5, "a date must exist, and texts stand in quotes"),
        ("[[a]", 4, "a section must end with as many ] as it begins with ["),
        ("just words!", 6, "a key must be followed by = and its value"),
        ("= 3", 1, "an entry must be key = value, and a section [name]"),
    ],
)
def test_text_that_is_no_toml(tmp_path, line, column, said):
    path = tmp_path / "a.toml"
    before = "first = 1\ntable = [1]\n" + ("[s]\n" if line == "[s]" else "\n")
    path.write_text(f"{before}{line}\nlast = 1\n")
    with pytest.raises(ArgumentError) as caught:
        read_toml(path)
    shown = f"at line 4, column {column}, it has {line!r}, but {said}"
    assert str(caught.value) == f"{path} is not valid TOML: {shown}".replace("\x01", "\\x01")


@pytest.mark.parametrize("text", ["a = 1\nb =\n\n", "a = 1\nb = ", "a = 1\nb = # a remark", "a = 1\nb = [1,\n\n"])
def test_the_end_of_toml_is_its_last_line(tmp_path, text):
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(ArgumentError, match=r"at line 2, column \d+, it has 'b = ?.*', but .* must"):
        read_toml(tmp_path / "a.toml")


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
