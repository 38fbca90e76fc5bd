"""What an argument must be before any work begins: of a kind, a number, a whole number, indices of points."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from homolog.core.errors import ArgumentError, bad_value

if TYPE_CHECKING:  # reading a shape does without torch, which takes long to load
    from torch import Tensor

# For each class, by its name, what to give and how to come by it: the classes live on floors above this one.
_WAYS_TO = {
    "Shape": "a Shape; read files with homolog.read_shape, or make one with homolog.Shape(points, faces)",
    "Operators": "Operators; compute them with Matcher.operators or homolog.compute_operators",
    "OperatorSettings": "OperatorSettings; make them with homolog.geometry.OperatorSettings(...), or leave them out",
    "Prepared": "a prepared shape; make one with Matcher.prepare",
    "MatcherSettings": "MatcherSettings; make them with homolog.MatcherSettings(...), or leave them out",
    "DiffusionNet": "a network; give weight files to Matcher.from_weights, or read them with homolog.load_weights",
    "WeightsInfo": "WeightsInfo; homolog.load_weights gives it along with the network",
    "PathLike": "a path, that is a str or a pathlib.Path",
}


def check_kind(name: str, found: object, *kinds: type) -> None:
    """Refuse an argument of none of these classes, and say how to come by the first of them."""
    if not isinstance(found, kinds):
        raise ArgumentError(f"{name} is {_described(found)}, but must be {_WAYS_TO[kinds[0].__name__]}")


def _described(found: object) -> str:
    kind = type(found).__name__
    return "None" if found is None else f"{'an' if kind[0] in 'aeiouAEIOU' else 'a'} {kind}"


def is_number(value: Any) -> bool:
    """Whether a value is a real number, be it infinite or NaN."""
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def is_real(value: Any) -> bool:
    """Whether a value is a finite real number."""
    return is_number(value) and bool(np.isfinite(value))


def is_count(value: Any, *, least: int = 1) -> bool:
    """Whether a value is a whole number of at least ``least``."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and bool(value >= least)


def check_count(name: str, value: Any, *, least: int = 1) -> None:
    """Refuse what is no whole number, or a smaller one."""
    if not is_count(value, least=least):
        raise bad_value(name, value, f"a whole number of at least {least}")


def check_finite(name: str, values: Tensor) -> None:
    """Refuse numbers of which any is NaN or infinite."""
    if not values.isfinite().all():
        raise ArgumentError(f"{name} holds NaN or infinite numbers, but must be finite")


def check_indices(name: str, indices: Tensor, n_points: int) -> None:
    """Refuse a point map that leaves the points it leads to, -1 for "none" included."""
    low, high = int(indices.min()), int(indices.max())
    if low < 0 or high >= n_points:
        found = f"{name} holds {low if low < 0 else high}"
        raise ArgumentError(
            f"{found}, but must hold indices from 0 to {n_points - 1}; leave points without a counterpart out first"
        )
