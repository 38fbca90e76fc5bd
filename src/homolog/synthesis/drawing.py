"""Numbers that are given, or drawn from a range that is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from homolog.core.arguments import is_real
from homolog.core.errors import bad_value

# A number, or the lowest and the highest that may be drawn.
Range = float | tuple[float, float]


def check_range(name: str, found: Any, allowed: Callable[[float], bool], described: str) -> None:
    """Refuse what is neither a number that is allowed, nor two of them in order.

    Raises:
        ArgumentError: naming the argument, and what is allowed, as ``described``.
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


def drawn(value: Range, random: np.random.Generator) -> float:
    """The number, or one drawn evenly from the range."""
    return float(random.uniform(*value)) if isinstance(value, tuple) else float(value)


def drawn_count(value: int | tuple[int, int], random: np.random.Generator) -> int:
    """The whole number, or one drawn from those of the range, its ends included."""
    return int(random.integers(value[0], value[1] + 1)) if isinstance(value, tuple) else int(value)


def drawn_direction(random: np.random.Generator) -> Float[np.ndarray, " 3"]:
    """A unit vector, every one as likely."""
    vector = random.standard_normal(3)
    direction: np.ndarray = vector / np.linalg.norm(vector)
    return direction


def given_direction(name: str, found: ArrayLike) -> Float[np.ndarray, " 3"]:
    """A vector of any length that a caller gave.

    Raises:
        ArgumentError: naming the argument, if it is no direction.
    """
    direction = np.asarray(found, dtype=float)
    if direction.shape != (3,) or not np.isfinite(direction).all() or not direction.any():
        raise bad_value(name, found, "three finite numbers, not all zero")
    return direction
