"""Checks of arguments before any work begins: their class, numbers, counts, indices of points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from homolog.core.errors import ArgumentError, bad_choice, bad_value

if TYPE_CHECKING:  # reading a shape does without torch, which takes long to load
    from torch import Tensor

S = TypeVar("S")

# For each class, by name, what to give and how to get it. The classes are defined on floors above this one.
_WAYS_TO = {
    "Shape": "a Shape; read files with homolog.read_shape, or make one with homolog.Shape(points, faces)",
    "Operators": "Operators; compute them with Matcher.preprocess.operators or homolog.compute_operators",
    "OperatorSettings": "OperatorSettings; make them with homolog.geometry.OperatorSettings(...), or leave them out",
    "RefinementSettings": "RefinementSettings; make them with homolog.maps.RefinementSettings(...), or leave them out",
    "ConfidenceSettings": "ConfidenceSettings; make them with homolog.maps.ConfidenceSettings(...), or leave them out",
    "RegistrationSettings": "RegistrationSettings; make them with homolog.maps.RegistrationSettings(...), or leave "
    "them out",
    "Matcher": "a Matcher; make one with homolog.Matcher(...) or homolog.Matcher.from_weights",
    "PreprocessedShape": "a preprocessed shape; make one with Matcher.preprocess",
    "ShapeFolder": "a ShapeFolder; open one with homolog.datasets.ShapeFolder.open",
    "Protocol": "a Protocol; make one with homolog.evaluation.Protocol(...), or leave it out",
    "Pair": "a Pair; make one with Matcher.pair, or of preprocessed shapes with Matcher.paired",
    "Match": "a Match; make one with homolog.match, or read one with homolog.Match.load",
    "PairOptions": "PairOptions; make them with homolog.PairOptions(...), or give their fields by name",
    "MatcherSettings": "MatcherSettings; make them with homolog.MatcherSettings(...), or leave them out",
    "DiffusionNet": "a network; give weight files to Matcher.from_weights, or read them with homolog.load_weights",
    "FeatureInfo": "FeatureInfo; homolog.load_weights gives it along with the network",
    "PathLike": "a path, that is a str or a pathlib.Path",
}


def check_kind(name: str, found: object, *kinds: type) -> None:
    """Refuse an argument of none of these classes, and say how to get one of the first."""
    if not isinstance(found, kinds):
        kind = type(found).__name__
        given = "None" if found is None else f"{'an' if kind[0] in 'aeiouAEIOU' else 'a'} {kind}"
        raise ArgumentError(f"{name} is {given}, but must be {_WAYS_TO[kinds[0].__name__]}")


def check_choice(name: str, value: Any, allowed: Sequence[str]) -> None:
    """Refuse what is not one of these words."""
    if not (isinstance(value, str) and value in allowed):
        raise bad_choice(name, value, allowed)


def given_or_default(name: str, given: S | None, kind: type[S]) -> S:
    """Settings as they were given, or the default ones; anything else is refused, see ``check_kind``."""
    if given is None:
        return kind()
    check_kind(name, given, kind)
    return given


def is_number(value: Any) -> bool:
    """Whether a value is a real number, infinite and NaN included."""
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def is_real(value: Any) -> bool:
    """Whether a value is a finite real number."""
    return is_number(value) and bool(np.isfinite(value))


def is_count(value: Any, *, least: int = 1) -> bool:
    """Whether a value is a whole number of at least ``least``."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and bool(value >= least)


def check_count(name: str, value: Any, *, least: int = 1) -> None:
    """Refuse what is not a whole number of at least ``least``."""
    if not is_count(value, least=least):
        raise bad_value(name, value, f"a whole number of at least {least}")


def check_finite(name: str, values: Tensor) -> None:
    """Refuse numbers of which any is NaN or infinite."""
    if not values.isfinite().all():
        raise ArgumentError(f"{name} holds NaN or infinite numbers, but must be finite")


def check_indices(name: str, indices: Tensor, n_points: int) -> None:
    """Refuse a point map with an index outside the shape that it leads to, -1 for "none" included."""
    low, high = int(indices.min()), int(indices.max())
    if low < 0 or high >= n_points:
        found = f"{name} holds {low if low < 0 else high}"
        raise ArgumentError(
            f"{found}, but must hold indices from 0 to {n_points - 1}; leave points without a counterpart out first"
        )
