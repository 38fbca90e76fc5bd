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
    "Operators": "Operators; compute them with Matcher.preprocess.operators or homolog.compute_operators",
    "OperatorSettings": "OperatorSettings; make them with homolog.geometry.OperatorSettings(...), or leave them out",
    "Pair": "a Pair; make one with Matcher.pair, or of preprocessed shapes with Matcher.paired",
    "PairOptions": "PairOptions; make them with homolog.PairOptions(...), or give their fields by name",
    "MatcherSettings": "MatcherSettings; make them with homolog.MatcherSettings(...), or leave them out",
    "DiffusionNet": "a network; give weight files to Matcher.from_weights, or read them with homolog.load_weights",
    "FeatureInfo": "FeatureInfo; homolog.load_weights gives it along with the network",
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


def check_number(
    name: str, value: Any, *, above: float | None = None, least: float = -np.inf, most: float = np.inf
) -> None:
    """Refuse what is no finite real number, or lies outside a range: above one bound, or from ``least`` to ``most``."""
    if not is_real(value) or value < least or value > most or (above is not None and value <= above):
        bounds = [] if above is None else [f"above {above:g}"]
        bounds += [f"at least {least:g}"] * bool(np.isfinite(least)) + [f"at most {most:g}"] * bool(np.isfinite(most))
        raise bad_value(name, value, " ".join(["a finite number", " and ".join(bounds)]).strip())


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
