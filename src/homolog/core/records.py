"""JSON files that are read back: each has a model of what is read of it, checked before anything of it is believed."""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

from homolog.core.errors import DataError
from homolog.core.files import read_text
from homolog.core.reasons import reason_of
from homolog.core.versions import version_of

if TYPE_CHECKING:  # loaded once something is checked
    from pydantic import TypeAdapter

K = TypeVar("K", bound=type[Any])

# No file of ours nests so deep, and what walks through its entries may do so by recursion.
_DEEPEST = 50
_TOO_LARGE = 2**63


class MissingEntryError(ValueError):
    """A file lacks an entry that files of this version have."""


def record(kind: K) -> K:
    """A decorator of typed dictionaries and dataclasses that are models of what files hold.

    Types are kept to, numbers are finite, and further entries are allowed.
    """
    kind.__pydantic_config__ = {"strict": True, "extra": "allow", "allow_inf_nan": False}
    return kind


def read_record(path: Path, kind: Any, *, instead: str) -> dict[str, Any]:
    """The object in a JSON file, checked against a model; what the model does not name is as the file has it.

    Args:
        path: the file.
        kind: a type with the decorator ``record``, or a dictionary of such. Its entries may be dataclasses, whose own
            checks count.
        instead: what to do about a damaged file, for messages.

    Raises:
        DataError: if it cannot be read, or an entry is not as the model says; numbers that are not finite never are.
    """
    try:
        text = read_text(path)
    except (OSError, ValueError) as error:
        raise DataError(f"{path} cannot be read ({reason_of(error)}); {instead}") from None
    try:
        return checked_json(text, kind)
    except MissingEntryError as error:
        raise DataError(f"{path} cannot be used ({error}); {instead}") from None
    except ValueError as error:
        raise DataError(f"{path} is damaged ({error}); {instead}") from None


def checked_json(text: str, kind: Any) -> dict[str, Any]:
    """As ``read_record``, of a text.

    Raises:
        MissingEntryError: if an entry is missing.
        ValueError: with one line that says what else is wrong.
    """
    from pydantic import ValidationError

    try:
        content = json.loads(text, parse_constant=_refuse, parse_float=_finite)
        check_plain(content)
        # Names of files that are no UTF-8 stand in it as Python has them, and in no JSON that others read.
        _model(kind).validate_json(json.dumps(content, ensure_ascii=False).encode(errors="replace"))
    except ValidationError as error:
        if error.errors(include_url=False)[0]["type"] == "missing":
            raise MissingEntryError(f"{reason_of(error)}; {_writer(content)} may have written it") from None
        raise ValueError(reason_of(error)) from None
    except (ValueError, RecursionError) as error:
        raise ValueError(reason_of(error)) from None
    return dict(content)


def check_record(content: Any, kind: Any) -> None:
    """Refuse an object of JSON, which others wrote, where it is not as a model says.

    Raises:
        ValueError: with one line that says what is wrong.
    """
    from pydantic import ValidationError

    try:
        _model(kind).validate_python(content)
    except ValidationError as error:
        raise ValueError(reason_of(error)) from None


def _writer(content: dict[str, Any]) -> str:
    """What may have written a file that lacks an entry: an older version, by its number where the file tells it."""
    told = content.get("versions")
    version = told.get("homolog") if isinstance(told, dict) else None
    ours = version_of("homolog")
    return f"homolog {version}, where this is {ours}," if version not in (None, ours) else "an older version of homolog"


def stored_record(path: Path, kind: Any) -> dict[str, Any] | None:
    """As ``read_record``, but None if the file is not there or not as the model says."""
    try:
        return read_record(path, kind, instead="")
    except DataError:
        return None


@cache
def _model(kind: Any) -> TypeAdapter[Any]:
    from pydantic import TypeAdapter

    return TypeAdapter(kind)


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"it holds {constant}")


def _finite(number: str) -> float:
    value = float(number)
    return value if math.isfinite(value) else _refuse(number)


def check_plain(content: Any, left: int = _DEEPEST) -> None:
    """Refuse what no file of ours holds, and what further work or a message could fail on.

    Args:
        content: tables and lists, as JSON and TOML have them.
        left: how deep they may be nested.

    Raises:
        ValueError: if they are nested deeper, or a whole number has more than 64 bits.
    """
    if left == 0:
        raise ValueError("its entries are nested too deep")
    if isinstance(content, int) and abs(content) >= _TOO_LARGE:
        raise ValueError("it holds a whole number of more than 64 bits")
    if isinstance(content, dict | list):
        for entry in content.values() if isinstance(content, dict) else content:
            check_plain(entry, left - 1)
