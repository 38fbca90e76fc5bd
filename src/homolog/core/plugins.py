"""What installed packages offer by entry points: methods, losses, formats."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from homolog.core.errors import ArgumentError, HomologError

_log = logging.getLogger(__name__)


@cache
def offered(group: str, own: tuple[str, ...] = ()) -> dict[str, EntryPoint]:
    """The entry points of a group by their names, none of them loaded.

    One whose name is taken is left out and logged, so that a fault of another package does not stop this one.

    Args:
        group: such as ``"homolog.methods"``.
        own: the names that Homolog itself has.
    """
    found: dict[str, EntryPoint] = {}
    for point in entry_points(group=group):
        if point.name in own or point.name in found:
            owner = "Homolog" if point.name in own else described(found[point.name])
            _log.warning("%s is left out, as %s has that name already; give it another", described(point), owner)
        else:
            found[point.name] = point
    return found


def described(point: EntryPoint) -> str:
    """An entry point in words, with its group and package."""
    package = f" of package {point.dist.name}" if point.dist else ""
    return f"entry point {point.name} = {point.value} in {point.group}{package}"


def fault(error: Exception) -> str:
    """An error of another package on one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}".rstrip(": ")


@contextmanager
def blamed_on(who: str, where: str = "", *, hint: str = "") -> Iterator[None]:
    """Around a call of a function of a user's: what it raises becomes one line that names it; the cause is kept.

    Errors of Homolog's own pass, as they say themselves what is wrong.

    Args:
        who: what is called.
        where: the shape or the pair that it is called with.
        hint: what else to know.

    Raises:
        ArgumentError: from what was raised.

    Examples:
        >>> with blamed_on("method 'mine'", "a -> b"):
        ...     1 / 0
        Traceback (most recent call last):
        homolog.core.errors.ArgumentError: method 'mine' failed on a -> b: ZeroDivisionError: division by zero
    """
    try:
        yield
    except HomologError:
        raise
    except Exception as error:
        place, more = (f" on {where}" if where else ""), (f"; {hint}" if hint else "")
        raise ArgumentError(f"{who} failed{place}: {fault(error)}{more}") from error
