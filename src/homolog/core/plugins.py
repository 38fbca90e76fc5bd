"""What installed packages offer by entry points: methods, losses, formats."""

from __future__ import annotations

import logging
from functools import cache
from importlib.metadata import EntryPoint, entry_points

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
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
