"""Functions of tensors that take numpy arrays as well."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any, ParamSpec, TypeVar

import numpy as np
import torch
from torch import Tensor

P = ParamSpec("P")
R = TypeVar("R")


def takes_arrays(function: Callable[P, R]) -> Callable[P, R]:
    """Let a function of tensors take numpy arrays: if any argument is one, its results are numpy arrays too."""

    @functools.wraps(function)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        if not any(isinstance(value, np.ndarray) for value in (*args, *kwargs.values())):
            return function(*args, **kwargs)
        given = [_to_tensor(value) for value in args]
        named = {name: _to_tensor(value) for name, value in kwargs.items()}
        return _to_numpy(function(*given, **named))

    return wrapper


def _to_tensor(value: Any) -> Any:
    if not isinstance(value, np.ndarray):
        return value
    # Copied where torch has no such tensors: read-only ones, and ones with negative strides.
    shared = value.flags.writeable and min(value.strides, default=0) >= 0
    return torch.from_numpy(value if shared else value.copy())


def _to_numpy(value: Any) -> Any:
    if isinstance(value, Tensor):
        return value.detach().cpu().numpy()
    if is_dataclass(value) and not isinstance(value, type):
        return type(value)(**{f.name: _to_numpy(getattr(value, f.name)) for f in fields(value)})
    if isinstance(value, tuple):
        return tuple(_to_numpy(item) for item in value)
    return value
