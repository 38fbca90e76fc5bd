"""Files that are read back through models."""

from dataclasses import dataclass

import pytest
from typing_extensions import NotRequired, TypedDict

from homolog.core.errors import DataError
from homolog.core.records import read_record, record, stored_record


@dataclass(frozen=True)
class Inner:
    share: float

    def __post_init__(self):
        if self.share > 1:
            raise ValueError("too large")


@record
class Outer(TypedDict):
    name: str
    inner: NotRequired[Inner | None]
    counts: NotRequired[dict[str, int]]


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "file.json"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def test_what_fits_the_model_is_as_the_file_has_it(written):
    path = written('{"name": "a", "inner": {"share": 1, "more": [1]}, "counts": {"b": 2}, "further": [null, 0.5]}')
    found = {"name": "a", "inner": {"share": 1, "more": [1]}, "counts": {"b": 2}, "further": [None, 0.5]}
    assert read_record(path, Outer, instead="go") == stored_record(path, Outer) == found


def test_names_that_are_no_utf_8_are_kept(written):
    assert read_record(written('{"name": "b\\udcff"}'), Outer, instead="go") == {"name": "b\udcff"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is damaged"),
        (b"\xff", "cannot be read"),
        ("[" * 100_000, "is damaged"),
        ('{"name": "a", "x": ' + "[" * 60 + "]" * 60 + "}", "is damaged .*nested too deep"),
        ('{"name": "a", "x": NaN}', "is damaged .*NaN"),
        ('{"name": "a", "x": -1e400}', "is damaged .*-1e400"),
        ('{"name": "a", "x": ' + "1" * 5000 + "}", "is damaged"),
        ("[1]", r"is damaged \(it is \[1\], but must be a table\)"),
        ("{}", r"cannot be used \(it has no entry 'name'; an older version of homolog may have written it\)"),
        ('{"name": 1}', r"is damaged \(its entry name is 1, but must be a text"),
        ('{"name": "a", "inner": 1}', r"is damaged \(its entry inner is 1, but must be a table"),
        ('{"name": "a", "inner": {"share": "1"}}', r"is damaged \(its entry inner\.share is '1', but must be a number"),
        ('{"name": "a", "inner": {"share": 2}}', r"is damaged \(its entry inner is not as it should be: too large"),
        ('{"name": "a", "counts": {"b": 1.5}}', r"is damaged \(its entry counts\.b is 1\.5, but must be a whole"),
        ('{"name": "a", "counts": {"b": true}}', r"is damaged \(its entry counts\.b is True, but must be a whole"),
    ],
)
def test_anything_else_is_one_line(written, text, said):
    path = written(text)
    with pytest.raises(DataError, match=rf"^{path} {said}.*; go$") as caught:
        read_record(path, Outer, instead="go")
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400
    assert stored_record(path, Outer) is None


def test_a_byte_order_mark_is_passed_over(written):
    assert read_record(written('\ufeff{"name": "a"}'), Outer, instead="go") == {"name": "a"}


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(DataError, match=r"none\.json cannot be read .*No such file"):
        read_record(tmp_path / "none.json", Outer, instead="go")
    assert stored_record(tmp_path / "none.json", Outer) is None
