"""What objects look like in a console, one line and never whole arrays, and what functions are called."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

# Arrays of at most so many numbers are written out, such as positions and centres.
_FEW = 4


def function_name(function: Any) -> str:
    """What a function is called, or the class of an object that is called like one."""
    return str(getattr(function, "__name__", type(function).__name__))


def named_function(name: str, function: Any) -> str:
    """A name that a function goes by, and what it is called itself where that differs."""
    called = function_name(function)
    return repr(name) if called == name else f"{name!r} of {called}"


def short_repr(self: Any) -> str:
    """A dataclass on one line, with arrays as their type and shape; to be set as its ``__repr__``."""
    shown = (f"{field.name}={_shown(getattr(self, field.name))}" for field in fields(self) if field.repr)
    return f"{type(self).__name__}({', '.join(shown)})"


def _shown(value: Any) -> str:
    if not (hasattr(value, "dtype") and hasattr(value, "shape")):
        return repr(value)
    shape, kind = tuple(value.shape), str(value.dtype).removeprefix("torch.")
    if len(shape) == 1 and shape[0] <= _FEW:
        return f"[{', '.join(f'{number:.4g}' for number in value.tolist())}]"
    return f"{kind} {shape}"
