"""What others wrote, made fit to stand in a message of one line."""

from __future__ import annotations

from typing import Any

# Of a message; paths may be long, and both ends say something.
_LONGEST, _LAST = 1000, 300
# Of a value that is quoted in it.
_LONGEST_VALUE = 80


def shorten(text: object, length: int = 50) -> str:
    """One line of at most ``length`` printable characters."""
    # What is far behind is not looked at.
    flat = "".join(c if c.isprintable() else " " for c in str(text)[: 100 * length])
    line = " ".join(flat.split())
    return line if len(line) <= length else line[: length - 3] + "..."


def shown(value: Any) -> str:
    """A value as a program writes it, cut short."""
    try:
        return shorten(repr(value), _LONGEST_VALUE)
    except (ValueError, RecursionError):  # of whole numbers of thousands of digits, and of lists within lists
        return f"a {type(value).__name__} that is too long to show"


def one_line(message: object) -> str:
    r"""A message without line breaks and control characters, which names of files may hold, and not too long.

    Examples:
        >>> one_line("the file a\nb.off is empty")
        'the file a\\nb.off is empty'
    """
    said = "".join(c if c.isprintable() else repr(c)[1:-1] for c in _without_middle(str(message)))
    return _without_middle(said)


def _without_middle(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - _LAST]} ... {text[-_LAST:]}"
