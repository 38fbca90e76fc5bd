"""What Python and the libraries that read files say of damage, in the words of this package: the one place for that."""

from __future__ import annotations

import json
import lzma
import re
import struct
import zipfile
import zlib
from typing import TYPE_CHECKING, Any

from homolog.core.messages import shorten, shown

if TYPE_CHECKING:  # loaded once something is checked
    from pydantic_core import ErrorDetails

# What errors of a kind mean, whatever they say.
_KINDS: tuple[tuple[tuple[type[BaseException], ...], str], ...] = (
    ((RecursionError,), "its values lie too deep in each other"),
    ((MemoryError,), "it does not fit into memory"),
    ((EOFError, struct.error), "it ends too early"),
    ((zlib.error, lzma.LZMAError, zipfile.BadZipFile), "its compressed data are damaged"),
    ((IndexError,), "a number in it leads nowhere"),
    ((TypeError, AttributeError), "one of its entries is of another kind than it should be"),
)
# What libraries say, NumPy of text above all, and the same in words that name what is in the file; and what is to be
# added to the number of a row, so that all count from 1.
_SAID: tuple[tuple[str, str, int], ...] = (
    (
        r"could not convert string (?P<found>'.*') to \w+ at row (?P<row>\d+)",
        "row {row} holds {found}, which is no such number",
        1,
    ),
    (
        r"the number of columns changed from \d+ to (?P<found>\d+) at row (?P<row>\d+)",
        "row {row} has {found} columns, others have another number",
        0,
    ),
    (r"input contained no data", "it holds no numbers", 0),
    (r"PytorchStreamReader|Weights only load failed", "it is damaged, or PyTorch has not written it", 0),
    (r"deserializing header", "its header is damaged, or it is no safetensors file", 0),
    (r"Unknown mat file type", "it is damaged, or MATLAB has not written it", 0),
)
# pydantic's names of mistakes, and what is allowed instead.
_ALLOWED = {
    "string_type": "a text",
    "bool_type": "true or false",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "list_type": "a list",
    "tuple_type": "a list",
    "none_required": "null",
    **dict.fromkeys(("dict_type", "model_type", "dataclass_type", "dataclass_exact_type", "mapping_type"), "a table"),
    "greater_than_equal": "at least {ge:g}",
    "greater_than": "above {gt:g}",
    "less_than_equal": "at most {le:g}",
    "less_than": "below {lt:g}",
    "literal_error": "one of {expected}",
}


def reason_of(error: BaseException, length: int = 160) -> str:
    r"""Why a file cannot be read, as one line that a user understands, without the file's name.

    Args:
        error: what was raised.
        length: of the line at most.

    Examples:
        >>> reason_of(UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte"))
        'it is no text in UTF-8'
    """
    return shorten(_reason(error), length)


def _reason(error: BaseException) -> str:
    if isinstance(error, UnicodeDecodeError):
        return f"it is no text in {error.encoding.upper()}"
    if isinstance(error, json.JSONDecodeError):
        return f"it is no valid JSON at line {error.lineno}, column {error.colno}"
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    if isinstance(error, KeyError):
        return (
            f"it has no entry {shown(error.args[0])}"
            if error.args and isinstance(error.args[0], str)
            else "it is damaged"
        )
    if type(error).__name__ == "ValidationError" and hasattr(error, "errors"):
        return _mistake(error.errors(include_url=False)[0])
    words = next((words for kinds, words in _KINDS if isinstance(error, kinds)), None)
    return words or _in_our_words(str(error)) or type(error).__name__


def _in_our_words(said: str) -> str:
    """What was said, in our words where a library is known to say it."""
    for pattern, words, missing in _SAID:
        if found := re.search(pattern, said):
            parts = found.groupdict()
            return words.format(found=shorten(parts.get("found"), 40), row=int(parts.get("row", 0)) + missing)
    return said


def _mistake(details: ErrorDetails) -> str:
    """The first mistake that pydantic found."""
    entry = ".".join(map(str, details["loc"])) or "it"
    if details["type"] == "missing":
        return f"it has no entry {entry!r}"
    context: dict[str, Any] = details.get("ctx", {})
    if details["type"] == "value_error":
        return f"its entry {entry} is not as it should be: {context['error']}"
    allowed = _ALLOWED.get(details["type"], "of another kind")
    return f"its entry {entry} is {shown(details['input'])}, but must be {allowed.format(**context)}"
