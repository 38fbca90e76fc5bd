"""Random parameters: a number that is given, or one sampled uniformly from a range."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from homolog.core.arguments import is_real
from homolog.core.errors import bad_value

# A number, or the ends of the range that it is sampled from.
Range = float | tuple[float, float]


def check_range(name: str, found: Any, allowed: Callable[[float], bool], described: str) -> None:
    """Refuse what is neither an allowed number nor a range of allowed numbers.

    Raises:
        ArgumentError: naming the argument, and what is allowed in the words of ``described``.
    """
    ends = found if isinstance(found, tuple) else (found, found)
    if not (len(ends) == 2 and all(is_real(end) and allowed(end) for end in ends) and ends[0] <= ends[1]):
        raise bad_value(name, found, f"{described}, or two such numbers, the smaller one first")


def check_number(name: str, found: Any, low: float) -> None:
    """Refuse what is no finite number of at least ``low``.

    Raises:
        ArgumentError: naming the argument, and what is allowed.
    """
    if not (is_real(found) and found >= low):
        raise bad_value(name, found, f"a finite number of at least {low:g}")


def sample(value: Range, random: np.random.Generator) -> float:
    """The number, or one sampled uniformly from the range.

    Examples:
        >>> sample(0.5, np.random.default_rng(0)), 1.0 <= sample((1.0, 2.0), np.random.default_rng(0)) < 2.0
        (0.5, True)
    """
    return float(random.uniform(*value)) if isinstance(value, tuple) else float(value)


def sample_count(value: int | tuple[int, int], random: np.random.Generator) -> int:
    """The whole number, or one sampled uniformly from the range, its ends included."""
    return int(random.integers(value[0], value[1] + 1)) if isinstance(value, tuple) else int(value)


def sample_direction(random: np.random.Generator) -> Float[np.ndarray, " 3"]:
    """Sample a direction uniformly from the unit sphere."""
    vector = random.standard_normal(3)
    direction: np.ndarray = vector / np.linalg.norm(vector)
    return direction


def checked_direction(name: str, found: ArrayLike) -> Float[np.ndarray, " 3"]:
    """A direction that a caller gave, of any length.

    Raises:
        ArgumentError: naming the argument, if it is no direction.
    """
    direction = np.asarray(found, dtype=float)
    if direction.shape != (3,) or not np.isfinite(direction).all() or not direction.any():
        raise bad_value(name, found, "three finite numbers, not all zero")
    return direction
