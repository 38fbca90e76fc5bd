"""Messages are one line of printable characters, whatever is quoted in them."""

from __future__ import annotations

from homolog.core.errors import ShapeError, bad_choice, bad_value
from homolog.core.messages import one_line, shorten, shown


def test_whatever_is_quoted_a_message_is_one_printable_line() -> None:
    message = str(ShapeError("a\nb\x1b[31m\u202e\udcff.off is empty"))
    assert message == "a\\nb\\x1b[31m\\u202e\\udcff.off is empty"
    assert str(ShapeError("\\d is kept, é too")) == "\\d is kept, é too"
    long = str(ShapeError("begin " + "x" * 100_000 + " end"))
    assert len(long) < 1100
    assert (long[:6], long[-4:]) == ("begin ", " end")


def test_values_are_cut_short() -> None:
    nested: list[object] = []
    for _ in range(100_000):
        nested = [nested]
    for value in ("a" * 9999, 10**9999, nested, [1] * 9999):
        assert len(shown(value)) <= 80
        assert len(str(bad_value("seed", value, "a number"))) < 150
    assert len(str(bad_choice("kind", "k" * 9999, ["one", "two"]))) < 150
    assert shorten("a\n\tb" + " " * 9, 10) == "a b"
    assert one_line(7) == "7"
