"""Typed settings, checked by pydantic: an unknown key or a wrong value is one line that says where and what instead."""

from __future__ import annotations

import sys
import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from functools import cache
from os import PathLike, fspath
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Literal,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from annotated_types import Ge, Gt, Le, Lt
from typing_extensions import Self

from homolog.core.errors import ArgumentError, bad_choice, bad_value
from homolog.core.files import read_text
from homolog.core.messages import shown
from homolog.core.reasons import reason_of, toml_reason
from homolog.core.records import check_plain

if TYPE_CHECKING:  # loaded once something is checked
    from pydantic import TypeAdapter, ValidationError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

S = TypeVar("S")

# A text in ``Annotated`` is added to what messages say is allowed, such as "0 for none".
Positive = Annotated[float, Gt(0)]
NotNegative = Annotated[float, Ge(0)]
Share = Annotated[float, Ge(0), Lt(1)]
Count = Annotated[int, Ge(1)]
CountOrZero = Annotated[int, Ge(0)]

_WORDS: dict[Any, str] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a text in quotes",
    dict: "a table",
}
_LIMITS: tuple[tuple[type, str, str], ...] = (
    (Gt, "gt", "above"),
    (Ge, "ge", "of at least"),
    (Lt, "lt", "below"),
    (Le, "le", "of at most"),
)


class Settings:
    """Base of settings: frozen dataclasses whose values are checked against their annotations as they are made.

    Lists become tuples, paths texts, and whole numbers floats where the annotations say so. ``typing.Annotated`` adds
    limits, such as ``Annotated[int, Ge(1)]``; see also ``Positive``, ``Count`` and others in this module.

    Raises:
        ArgumentError: if a value is not as annotated, a word is no field, or ``check`` refuses them.

    Examples:
        >>> from dataclasses import dataclass
        >>> @dataclass(frozen=True, kw_only=True)
        ... class Sampling(Settings):
        ...     points: Count = 1200
        >>> Sampling(points=0)
        Traceback (most recent call last):
        homolog.core.errors.ArgumentError: points is 0, but must be a whole number of at least 1
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]  # subclasses are dataclasses

    def __new__(cls, *_: Any, **words: Any) -> Self:
        """Refuse a word that is no field, before ``__init__`` would by a ``TypeError`` without the nearest one."""
        for word in words:
            if word not in cls.__dataclass_fields__:
                raise ArgumentError(f"{cls.__name__} {unknown_key(word, [*cls.__dataclass_fields__])}")
        return super().__new__(cls)

    def __post_init__(self) -> None:
        for name, value in _checked(type(self), vars(self)).items():
            object.__setattr__(self, name, value)
        self.check()

    def check(self) -> None:
        """Refuse values that do not fit each other; subclasses say which, by an ``ArgumentError``."""


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        ArgumentError: if it cannot be read, or is no TOML.
    """
    try:
        text = read_text(path)
        tables = tomllib.loads(text)
        check_plain(tables)
    except tomllib.TOMLDecodeError as error:
        raise ArgumentError(f"{path} is not valid TOML: {toml_reason(error, text)}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ArgumentError(f"{path} cannot be read ({reason_of(error)}); give a TOML file") from None
    except (ValueError, RecursionError) as error:  # of what is nested too deep, and of numbers that are too long
        raise ArgumentError(f"{path} is not valid TOML: {reason_of(error)}") from None
    return tables


def toml_value(text: str) -> Any:
    """The value that a text is in TOML, or the text itself where it is none.

    Examples:
        >>> toml_value("[0.3, 0.5]"), toml_value("bf16")
        ([0.3, 0.5], 'bf16')
    """
    try:
        table = tomllib.loads(f"value = {text}")
        check_plain(table)
    except (ValueError, RecursionError):
        return text
    return table["value"] if table.keys() == {"value"} else text


def read_settings(settings: type[S], table: Mapping[str, Any], where: str) -> S:
    """Build settings from a table whose keys are the names of their fields; fields that are settings are tables.

    Args:
        settings: a dataclass, of ``Settings`` or not.
        table: as ``tomllib`` reads it.
        where: the file, and the section in brackets, for messages.

    Raises:
        ArgumentError: at an unknown key, a value of another type, or one that the settings themselves refuse.
    """
    types_of = get_type_hints(settings)
    for key in table:
        if key not in types_of:
            raise ArgumentError(f"{where} {unknown_key(key, [field.name for field in fields(settings)])}")  # type: ignore[arg-type]
    values = {key: _nested(types_of[key], value, key, where) for key, value in table.items()}
    try:
        return settings(**_checked(settings, values))
    except ArgumentError as error:
        raise ArgumentError(f"{where} {error}") from None


def unknown_key(key: str, known: list[str]) -> str:
    """What to say of a key that is not among those known: the nearest one, or all of them."""
    near = get_close_matches(key, known, n=1)
    instead = f"did you mean {near[0]!r}?" if near else f"it knows {', '.join(known)}"
    return f"has an unknown key {shown(key)}; {instead}"


def argument_error(error: ValidationError, settings: type) -> ArgumentError:
    """The first of pydantic's complaints about a value of such settings, as one line in our words."""
    first = error.errors(include_url=False)[0]
    key, *inside = first["loc"]
    annotation = get_type_hints(settings, include_extras=True)[str(key)]
    words = _words_of(annotation)
    if words and isinstance(first["input"], str):
        return bad_choice(str(key), first["input"], words)
    found = list(first["input"]) if isinstance(first["input"], tuple) else first["input"]
    if inside and first["type"] != "missing":
        return ArgumentError(f"{key} holds {shown(found)}, but must be {described(annotation)}")
    return bad_value(str(key), found, described(annotation))


def described(annotation: Any) -> str:
    """What an annotation allows, for messages and tables: "a whole number of at least 1"."""
    annotation, notes = _parts(annotation)
    limits = " and ".join(
        f"{word} {getattr(note, key):g}" for note in notes for kind, key, word in _LIMITS if type(note) is kind
    )
    remarks = "".join(f", {note}" for note in notes if isinstance(note, str))
    return " ".join(filter(None, [_kind(annotation), limits])) + remarks


def _kind(annotation: Any) -> str:
    if words := _words_of(annotation):
        return f"one of {', '.join(map(repr, words))}"
    if get_origin(annotation) is tuple:
        *kinds, last = get_args(annotation)
        if last is Ellipsis:
            return f"a list, each of them {described(kinds[0])}"
        parts = [described(kind) for kind in (*kinds, last)]
        alike = len(set(parts)) == 1
        return f"a list of {len(parts)}{', each of them ' + parts[0] if alike else ': ' + ', '.join(parts)}"
    return _WORDS.get(get_origin(annotation) or annotation) or str(annotation.__name__)


def _parts(annotation: Any) -> tuple[Any, tuple[Any, ...]]:
    """The type in an annotation, without None, and what is noted about it."""
    if get_origin(annotation) in (Union, types.UnionType):
        # TOML has no word for None, a key that is absent stands for it.
        return _parts(next(part for part in get_args(annotation) if part is not type(None)))
    if get_origin(annotation) is Annotated:
        inner, notes = _parts(get_args(annotation)[0])
        return inner, (*notes, *annotation.__metadata__)
    return annotation, ()


def _words_of(annotation: Any) -> tuple[str, ...]:
    annotation = _parts(annotation)[0]
    return get_args(annotation) if get_origin(annotation) is Literal else ()


def _nested(annotation: Any, value: Any, key: str, where: str) -> Any:
    kind = _parts(annotation)[0]
    if value is None or not is_dataclass(kind):
        return value
    if not isinstance(value, Mapping):
        raise ArgumentError(f"{where} {key} is {value!r}, but must be a section [{key}]")
    return read_settings(kind, value, f"{where} [{key}]")  # type: ignore[arg-type]


def _checked(settings: type, values: Mapping[str, Any]) -> dict[str, Any]:
    """Values of some of a dataclass's fields, in the types that their annotations name."""
    from pydantic import ValidationError

    try:
        return _table_of(settings).validate_python({key: _plain(value) for key, value in values.items()})
    except ValidationError as error:
        raise argument_error(error, settings) from None


@cache
def _table_of(settings: type) -> TypeAdapter[dict[str, Any]]:
    from pydantic import ConfigDict, TypeAdapter
    from typing_extensions import TypedDict  # before Python 3.12 pydantic takes no other

    hints = get_type_hints(settings, include_extras=True)
    make: Any = TypedDict
    table = make("table", {field.name: hints[field.name] for field in fields(settings)}, total=False)
    table.__pydantic_config__ = ConfigDict(strict=True, allow_inf_nan=False, arbitrary_types_allowed=True)
    return TypeAdapter(table)


def _plain(value: Any) -> Any:
    if isinstance(value, PathLike):
        return fspath(value)
    if type(value).__module__ == "numpy" and hasattr(value, "tolist"):  # numpy's numbers count as Python's
        value = value.tolist()
    return tuple(map(_plain, value)) if isinstance(value, list) else value
