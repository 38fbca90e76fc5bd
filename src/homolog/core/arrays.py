"""Functions of tensors that take numpy arrays as well, and refuse in one line what does not fit their annotations."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, ParamSpec, Protocol, TypeVar, get_type_hints, overload

import numpy as np
import torch
from torch import Tensor

from homolog.core.errors import ArgumentError

P = ParamSpec("P")
R = TypeVar("R")
R_co = TypeVar("R_co", covariant=True)
N_co = TypeVar("N_co", covariant=True)

Array = TypeVar("Array", Tensor, np.ndarray)
"""Either kind of array: what a dataclass holds that comes out of a function of tensors or of numpy arrays."""


class ArrayFunction(Protocol[P, R_co, N_co]):
    """A function of tensors that takes numpy arrays as well, and then returns numpy arrays."""

    @overload
    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R_co: ...

    @overload
    def __call__(self, *args: np.ndarray, **kwargs: Any) -> N_co: ...


class _TakesArrays(Protocol):
    """A decorator that turns functions of tensors into an ``ArrayFunction``."""

    @overload
    def __call__(self, function: Callable[P, Tensor]) -> ArrayFunction[P, Tensor, np.ndarray]: ...

    @overload
    def __call__(
        self, function: Callable[P, tuple[Tensor, Tensor]]
    ) -> ArrayFunction[P, tuple[Tensor, Tensor], tuple[np.ndarray, np.ndarray]]: ...

    @overload
    def __call__(self, function: Callable[P, R]) -> ArrayFunction[P, R, Any]: ...


def _taking(function: Callable[..., Any], *, one_type: bool) -> Any:
    names, annotations = list(inspect.signature(function).parameters), _annotations(function)

    @functools.wraps(function)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        if not any(isinstance(value, np.ndarray) for value in (*args, *kwargs.values())):
            _check(annotations, dict(zip(names, args, strict=False)) | kwargs, one_type=one_type)
            return function(*args, **kwargs)
        # More than there are names for is for Python itself to refuse.
        given = [_to_tensor(name, value) for name, value in zip([*names, *args], args, strict=False)]
        named = {name: _to_tensor(name, value) for name, value in kwargs.items()}
        _check(annotations, dict(zip(names, given, strict=False)) | named, one_type=one_type)
        return _to_numpy(function(*given, **named))

    return wrapper


takes_arrays: _TakesArrays = functools.partial(_taking, one_type=True)
"""Let a function of tensors take numpy arrays: if any argument is one, its results are numpy arrays too.

Arguments that are annotated as ``Float[Tensor, "n d"]`` or ``Int[Tensor, " n"]`` are checked by that: dimensions, none
of them empty, equal where they have one name; and all real ones must have one type. What does not fit is an
``ArgumentError`` of one line.
"""

takes_arrays_of_any_precision: _TakesArrays = functools.partial(_taking, one_type=False)
"""The same for a function that does not mind if its arguments differ in precision."""


@dataclass(frozen=True)
class _Annotation:
    """What an annotation asks of a tensor: real numbers or integers, and the names of its dimensions."""

    real: bool
    dimensions: tuple[str, ...]

    @property
    def open_ended(self) -> bool:
        """Whether any number of dimensions may come before those that have names."""
        return self.dimensions[:1] == ("*batch",)

    @property
    def names(self) -> tuple[str, ...]:
        """Those of the last dimensions."""
        return self.dimensions[1:] if self.open_ended else self.dimensions

    def __str__(self) -> str:
        names = ["...", *self.names] if self.open_ended else [*self.names]
        return f"({', '.join(names)}{',' if len(names) == 1 else ''})"


def _annotations(function: Callable[..., Any]) -> dict[str, _Annotation]:
    """What is asked of each argument that is annotated as a tensor of some shape."""
    hints = {name: hint for name, hint in get_type_hints(function).items() if name != "return"}
    return {
        name: _Annotation("float32" in hint.dtypes, tuple(hint.dim_str.split()))
        for name, hint in hints.items()
        if getattr(hint, "array_type", None) is Tensor
    }


def _check(annotations: Mapping[str, _Annotation], values: Mapping[str, Any], *, one_type: bool) -> None:
    sizes: dict[str, tuple[int, str]] = {}
    first: str | None = None
    for name, asked in annotations.items():
        if name not in values:
            continue
        _check_tensor(name, values[name], asked)
        _check_sizes(name, values[name], asked, sizes)
        if first is not None:
            _check_alike(name, values[name], first, values[first], one_type=one_type and asked.real)
        elif asked.real:
            first = name


def _check_tensor(name: str, value: Any, asked: _Annotation) -> None:
    if not isinstance(value, Tensor):
        raise ArgumentError(f"{name} is a {type(value).__name__}, but must be a tensor or numpy array of shape {asked}")
    fits = value.is_floating_point() if asked.real else value.dtype in (torch.int32, torch.int64)
    if not fits:
        allowed = "real numbers, such as float32" if asked.real else "whole numbers, int64"
        raise ArgumentError(f"{name} holds {_dtype(value)}, but must hold {allowed}")


def _check_sizes(name: str, value: Tensor, asked: _Annotation, sizes: dict[str, tuple[int, str]]) -> None:
    """Compare with what is asked and with ``sizes``: for each name of a dimension its size, and who had it first."""
    n_dimensions, shape = len(asked.names), tuple(value.shape)
    if len(shape) < n_dimensions or (len(shape) > n_dimensions and not asked.open_ended):
        raise ArgumentError(f"{name} has shape {shape}, but must have shape {asked}")
    for dimension, size in zip(asked.names, shape[len(shape) - n_dimensions :], strict=True):
        if size == 0:
            raise ArgumentError(f"{name} has shape {shape}, but must have shape {asked}, and nothing may be empty")
        expected, who = (int(dimension), "") if dimension.isdigit() else sizes.setdefault(dimension, (size, name))
        if size != expected:
            like = f" with {dimension} = {expected}, as {who} has it" if who else ""
            raise ArgumentError(f"{name} has shape {shape}, but must have shape {asked}{like}")


def _check_alike(name: str, value: Tensor, first: str, other: Tensor, *, one_type: bool) -> None:
    if one_type and value.dtype != other.dtype:
        raise ArgumentError(f"{name} holds {_dtype(value)} and {first} {_dtype(other)}, but both must hold the same")
    if value.device != other.device:
        raise ArgumentError(
            f"{name} is on {value.device} and {first} on {other.device}, but both must be on one device"
        )


def _dtype(value: Tensor) -> str:
    return str(value.dtype).removeprefix("torch.")


def _to_tensor(name: str, value: Any) -> Any:
    if not isinstance(value, np.ndarray):
        return value
    # Copied where torch has no such tensors: read-only ones, and ones with negative strides.
    shared = value.flags.writeable and min(value.strides, default=0) >= 0
    try:
        return torch.from_numpy(value if shared else value.copy())
    except TypeError:
        raise ArgumentError(f"{name} holds {value.dtype}, but must hold numbers, such as float32 or int64") from None


def _to_numpy(value: Any) -> Any:
    if isinstance(value, Tensor):
        return value.detach().cpu().numpy()
    if is_dataclass(value) and not isinstance(value, type):
        return type(value)(**{f.name: _to_numpy(getattr(value, f.name)) for f in fields(value)})
    if isinstance(value, tuple):
        return tuple(_to_numpy(item) for item in value)
    return value
