"""Typed settings from TOML tables: an unknown key or a wrong type is one line that says where and what instead."""

from __future__ import annotations

import sys
import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from homolog.core.errors import ArgumentError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

S = TypeVar("S")

_WORDS: dict[type, str] = {bool: "true or false", int: "a whole number", float: "a number", str: "a text in quotes"}


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        ArgumentError: if it cannot be read, or is no TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ArgumentError(f"{path} cannot be read ({error}); give a TOML file") from None
    except tomllib.TOMLDecodeError as error:
        raise ArgumentError(f"{path} is not valid TOML: {error}") from None


def read_table(settings: type[S], table: Mapping[str, Any], where: str) -> S:
    """Build settings from a table whose keys are the names of their fields; fields that are settings are tables.

    Args:
        settings: a dataclass whose fields are numbers, texts, words of a ``Literal``, tuples of these, or dataclasses.
        table: as ``tomllib`` reads it.
        where: the file, and the section in brackets, for messages.

    Raises:
        ArgumentError: at an unknown key, a value of another type, or one that the settings themselves refuse.
    """
    wanted = get_type_hints(settings)
    names = [field.name for field in fields(settings)]  # type: ignore[arg-type]
    for key in table:
        if key not in names:
            raise ArgumentError(_unknown(key, names, where))
    values = {key: _read(wanted[key], value, key, where) for key, value in table.items()}
    try:
        return settings(**values)
    except ArgumentError as error:
        raise ArgumentError(f"{where} {error}") from None


def _unknown(key: str, names: list[str], where: str) -> str:
    near = get_close_matches(key, names, n=1)
    instead = f"did you mean {near[0]!r}?" if near else f"it knows {', '.join(names)}"
    return f"{where} has an unknown key {key!r}; {instead}"


def _read(wanted: Any, value: Any, key: str, where: str) -> Any:
    wanted = _without_none(wanted)
    if is_dataclass(wanted):
        if not isinstance(value, Mapping):
            raise ArgumentError(f"{where} {key} is {value!r}, but must be a section [{key}]")
        return read_table(wanted, value, f"{where} [{key}]")  # type: ignore[arg-type]
    if not _fits(wanted, value):
        raise ArgumentError(f"{where} {key} is {value!r}, but must be {_described(wanted)}")
    return _converted(wanted, value)


def _without_none(wanted: Any) -> Any:
    """The other part of ``X | None``: TOML has no word for None, a key that is absent stands for it."""
    if get_origin(wanted) in (Union, types.UnionType):
        return next(part for part in get_args(wanted) if part is not type(None))
    return wanted


def _fits(wanted: Any, value: Any) -> bool:
    if get_origin(wanted) is Literal:
        return isinstance(value, str)  # whether it is one of the words, the settings themselves say
    if get_origin(wanted) is tuple:
        parts = get_args(wanted)
        open_ended = len(parts) == 2 and parts[1] is Ellipsis
        right_length = isinstance(value, list) and (open_ended or len(value) == len(parts))
        return right_length and all(_fits(parts[0], item) for item in value)
    if isinstance(value, bool):
        return wanted is bool
    return isinstance(value, (int, float) if wanted is float else wanted)


def _converted(wanted: Any, value: Any) -> Any:
    if get_origin(wanted) is tuple:
        return tuple(_converted(get_args(wanted)[0], item) for item in value)
    return float(value) if wanted is float else value


def _described(wanted: Any) -> str:
    if get_origin(wanted) is Literal:
        return f"one of {', '.join(map(repr, get_args(wanted)))}"
    if get_origin(wanted) is tuple:
        parts = get_args(wanted)
        size = "a list" if parts[-1] is Ellipsis else f"a list of {len(parts)}"
        return f"{size}, each of them {_WORDS[parts[0]]}"
    return _WORDS[wanted]
