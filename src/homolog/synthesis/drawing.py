"""Numbers that are given, or drawn from a range that is."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from homolog.arguments import is_real
from homolog.errors import bad_value

# A number, or the lowest and the highest that may be drawn.
Range = float | tuple[float, float]


def check_range(name: str, found: Any, low: float, high: float = np.inf, *, open_low: bool = False) -> None:
    """Refuse what is neither a number from ``low`` to ``high`` nor two of them in order.

    Raises:
        ArgumentError: naming the argument, and what is allowed.
    """
    ends = found if isinstance(found, tuple) else (found, found)
    numbers = len(ends) == 2 and all(map(is_real, ends))
    if not (numbers and low <= ends[0] <= ends[1] <= high and not (open_low and ends[0] == low)):
        least = "above" if open_low else "of at least"
        most = f" and at most {high:g}" if np.isfinite(high) else ""
        raise bad_value(name, found, f"a number {least} {low:g}{most}, or two of them, the smaller one first")


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
