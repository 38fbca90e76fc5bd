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
    (r"field larger than field limit \((?P<row>\d+)\)", "it has a cell of more than {row} characters", 0),
    (r"input contained no data", "it holds no numbers", 0),
    (r"PytorchStreamReader|Weights only load failed", "it is damaged, or PyTorch has not written it", 0),
    (r"deserializing header", "its header is damaged, or it is no safetensors file", 0),
    (r"limit .* for integer string conversion", "it holds a whole number of more than 64 bits", 0),
    (r"could not convert string to float: (?P<found>'.*')", "{found} stands where a number should", 0),
    (r"invalid literal for int\(\) with base 10: (?P<found>'.*')", "{found} stands where a whole number should", 0),
    (r"not enough values to unpack", "one of its lines or entries is too short", 0),
    (r"too many values to unpack", "one of its lines or entries is too long", 0),
    (r"Storage size calculation overflowed|multiplication overflow", "its sizes are too large for any computer", 0),
    (r"Trying to create tensor with negative dimension", "one of its sizes is below 0", 0),
    (r"Unknown mat file type", "it is damaged, or MATLAB has not written it", 0),
)
# What Python says of TOML, and what is allowed there instead.
_TOML: tuple[tuple[str, str], ...] = (
    (r"Invalid value", "what follows = must be a number, true, false, a text in quotes, a list or a table"),
    (r"Expected '=' after a key", "a key must be followed by = and its value"),
    (r"Expected newline or end of document", "a line must hold one entry, and texts stand in quotes"),
    (r"Duplicate inline table key|Cannot overwrite a value", "a key must not stand twice in its section"),
    (r"Cannot declare", "a section must not stand twice"),
    (r"immutable namespace|Cannot redefine", "a list or table in one line must hold all its entries there"),
    (r"Unclosed array", "a list must end with ]"),
    (r"Unclosed inline table", "a table in one line must end with }"),
    (r"Unterminated string|Expected [\"']+$", "a text must end with the quotes that it begins with"),
    (r"character '\\[nr]'", "a text in quotes must end on its line, unless there are three quotes"),
    (r"Illegal character|Found invalid character", "a text must have no control characters"),
    (r"Unescaped|Invalid hex|Unicode scalar", r"in double quotes a \ must be written as \\, or the quotes be single"),
    (r"Invalid initial character", "a key must be of letters, digits, _ and -, or stand in quotes"),
    (r"Invalid date", "a date must exist, and texts stand in quotes"),
    (r"Expected '\]+' at", "a section must end with as many ] as it begins with ["),
    (r"Invalid statement", "an entry must be key = value, and a section [name]"),
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


def reason_with_remedy(error: BaseException, remedy: str) -> str:
    """``reason_of`` an error, and what to do, where the reason itself does not say so.

    Examples:
        >>> reason_with_remedy(EOFError(), "copy it again")
        'it ends too early; copy it again'
    """
    reason = reason_of(error, 400)
    if isinstance(error, FileNotFoundError):
        remedy = "give a file that is there"
    elif isinstance(error, OSError):
        remedy = "give an ordinary file that may be read"
    return reason if "; " in reason else f"{reason}; {remedy}"


def image_reason(error: BaseException) -> str:
    """Why Pillow cannot read an image, and what to do; it names addresses in memory and limits of its own."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.strerror}; put an image there"
    if pixels := re.search(r"Image size \((\d+) pixels\)", str(error)):
        return f"it has {pixels[1]} pixels, more than an image may have; make it smaller"
    if "cannot identify" in str(error):
        return "it is no image that Pillow knows, or it is cut off; export it again"
    if isinstance(error, MemoryError):
        return "it does not fit into memory; make it smaller"
    return "it is damaged, or cut off; export it again"


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


def toml_reason(error: ValueError, text: str) -> str:
    r"""Why a text is no TOML: the line and column, what stands there, and what is allowed.

    Args:
        error: what ``tomllib`` raised of it.
        text: as it was given to ``tomllib``.

    Examples:
        >>> toml_reason(ValueError("Invalid value (at line 2, column 5)"), "a = 1\nb = yes\n")
        "at line 2, column 5, it has 'b = yes', but what follows = must be a number, true, false, a text in quotes, ..."
    """
    said, _, place = str(error).rpartition(" (at ")
    allowed = next((words for pattern, words in _TOML if re.search(pattern, said)), "this is not how TOML is written")
    lines = text.rstrip().split("\n")
    numbers = re.match(r"line (\d+), column (\d+)", place)  # of the end of the file it tells none
    line, column = map(int, numbers.groups()) if numbers else (len(lines), len(lines[-1]) + 1)
    found = lines[min(line, len(lines)) - 1].strip()
    return f"at line {line}, column {column}, it has {shown(found)}, but {allowed}"


def _mistake(details: ErrorDetails) -> str:
    """The first mistake that pydantic found."""
    entry = ".".join(map(str, details["loc"]))
    subject = f"its entry {entry}" if entry else "it"
    if details["type"] == "missing":
        return f"it has no entry {entry!r}"
    context: dict[str, Any] = details.get("ctx", {})
    if details["type"] == "value_error":
        return f"{subject} is not as it should be: {context['error']}"
    allowed = _ALLOWED.get(details["type"], "of another kind")
    return f"{subject} is {shown(details['input'])}, but must be {allowed.format(**context)}"
