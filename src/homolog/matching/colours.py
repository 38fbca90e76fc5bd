"""Colours that show a match: the same colour marks the same point."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, UInt8

if TYPE_CHECKING:
    from homolog.matching.result import Match

# What has no counterpart, or cannot be coloured, is grey.
_NO_COLOUR = (160, 160, 160)


def matched_colours(match: Match) -> tuple[UInt8[np.ndarray, "n_source 3"], UInt8[np.ndarray, "n_target 3"]]:
    """Colours by the source's position, and the same on the target by its map to the source; grey without a match.

    A source point that is some target point's match has its colour even where it has no counterpart of its own.
    """
    has_match = match.source_to_target >= 0
    has_match[match.target_to_source[match.target_to_source >= 0]] = True
    by_position = position_colours(match.source.points, spanned_by=has_match)
    source_colours = np.where(has_match[:, None], by_position, _grey())
    back = match.target_to_source
    return source_colours, np.where(back[:, None] >= 0, by_position[back], _grey())


def position_colours(
    points: Float[np.ndarray, "n 3"], *, spanned_by: Bool[np.ndarray, " n"] | None = None
) -> UInt8[np.ndarray, "n 3"]:
    """Smooth colours from positions: the bounding box becomes the colour cube, a little lightened.

    Args:
        points: those that are not finite become grey.
        spanned_by: the points whose bounding box counts, if there are any; all by default. Stray ones would leave one
            colour for the rest.
    """
    finite = np.isfinite(points).all(axis=1)
    colours = np.full(points.shape, _NO_COLOUR, dtype=np.uint8)
    counted = finite if spanned_by is None or not (finite & spanned_by).any() else finite & spanned_by
    low, high = points[counted].min(axis=0), points[counted].max(axis=0)
    share = (points[finite] - low) / np.where(high > low, high - low, 1.0)
    colours[finite] = np.round(40 + 215 * share.clip(0, 1))
    return colours


def _grey() -> UInt8[np.ndarray, " 3"]:
    return np.array(_NO_COLOUR, dtype=np.uint8)
