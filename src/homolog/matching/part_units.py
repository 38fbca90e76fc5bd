"""Noticing a part that is not in the units of its complete partner: both are matched at one scale."""

from __future__ import annotations

from homolog.geometry import surface_area
from homolog.shapes import Repaired

# Shares of the complete shape's area that a part may have. One of more than the whole can only be an estimate that is
# off, by a few per cent between clouds; less than a hundredth shows nothing that could be recognised.
_LARGEST_SHARE = 1.2
_SMALLEST_SHARE = 0.01


def unit_warnings(part: Repaired, *, factor: float, complete_area: float) -> list[str]:
    """Say if a part's area cannot be that of a part.

    Args:
        part: the clean part, in its own units.
        factor: by how much its lengths are multiplied to be in the complete shape's units.
        complete_area: of the complete shape, in its own units squared.

    Returns:
        At most one line, that names both areas and what to give.
    """
    own = part.report.area  # of the faces, also where they are not used otherwise
    area = factor**2 * (surface_area(part.shape) if own is None else own)
    if _SMALLEST_SHARE <= area / complete_area <= _LARGEST_SHARE:
        return []
    swapped = ", or name the other shape as the partial one" if area > complete_area else ""
    return [
        f"the partial shape's area is {area:.3g}, the complete one's {complete_area:.3g}: their units seem to differ; "
        f"give partial_scale (--partial-scale), by how much the partial shape's lengths are to be multiplied{swapped}"
    ]
