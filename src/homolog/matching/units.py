"""Whether a partial shape is in the units of its full one, as far as its size tells."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial import KDTree

from homolog.geometry import OperatorSettings, compute_operators, surface_area
from homolog.maps import Similarity, composed
from homolog.pairs import Pair, PreprocessedShape, Preprocessor

LIKELY_SHARE = 0.35
"""The share of the full shape's area that a part in unknown units is taken to have until its size is found."""

# Shares of the full shape's area that a partial shape may have. One of more than all can only be an estimate that is
# off, by a few per cent between clouds; less than a hundredth shows nothing that could be recognised.
_LARGEST_SHARE = 1.2
_SMALLEST_SHARE = 0.01
# The same of lengths: how far half of the points lie from their middle, over that of the full shape. Of 27 cuts, views
# and their clouds of the two bodies that ship it is 0.5 to 0.8; other units differ by 2.5 at least.
_LARGEST_SIZE = 1.1
_SMALLEST_SIZE = 0.15
# An outlier's third neighbour is so many times as far away as others' are.
_NEIGHBOURS = 3
_FAR_AWAY = 5.0
_MANY_OUTLIERS = 0.001


@dataclass(frozen=True)
class PartAreas:
    """The areas of a partial shape and of its full one, in the full one's units.

    Args:
        partial: of the part.
        full: of the whole.
        are_possible: whether one can be a part of the other.
    """

    partial: float
    full: float
    are_possible: bool


def part_areas(pair: Pair) -> PartAreas:
    """The areas of a partial shape and of its full one, as both were given, times ``partial_scale``.

    Outliers make areas of any size, but hardly move a median: where there are some, lengths are compared as well.
    """
    partial, full = pair.y, pair.x.operators.scale
    area = pair.options.partial_scale**2 * _own_area(partial)
    too_large, too_small = area > _LARGEST_SHARE * full**2, area < _SMALLEST_SHARE * full**2
    if (too_large and _has_outliers(partial)) or (too_small and _has_outliers(pair.x)):
        size = pair.options.partial_scale * _half_size(partial) / _half_size(pair.x)
        too_large, too_small = too_large and size > _LARGEST_SIZE, too_small and size < _SMALLEST_SIZE
    return PartAreas(area, full**2, not (too_large or too_small))


def _own_area(shape: PreprocessedShape) -> float:
    """The area in the file's units: of the faces, also where they are not used otherwise."""
    own = shape.repaired.report.area
    return surface_area(shape.repaired.shape) if own is None else own


def in_likely_units(pair: Pair) -> Pair:
    """A pair whose partial shape is in unknown units, with operators in units in which it may be a part.

    Operators of a shape that is much too large or small are not those of the right size, only larger: where the
    gradients of functions are fitted, lengths count as they are.
    """
    y, old = pair.y, pair.y.operators
    scale = math.sqrt(_own_area(y) / LIKELY_SHARE)
    settings = pair.settings.operators or OperatorSettings()
    new = compute_operators(y.repaired.shape, settings=settings, scale=scale).to(old.points.device)
    # From the new positions to the old ones, about which the orienter spoke.
    to_old = Similarity(torch.eye(3), scale / old.scale, ((new.centre - old.centre) / old.scale).float())
    orientations = tuple(
        each if each.upright is None else replace(each, upright=composed(each.upright, to_old.to(each.upright.shift)))
        for each in y.orientations
    )
    operators = new.turned(y.rotation)
    features = Preprocessor(extractor=pair.extractor).features(operators, shape=y.name)
    return pair.with_y(replace(y, operators=operators, features=features, orientations=orientations))


def has_unknown_units(pair: Pair) -> bool:
    """Whether a partial shape is in units that differ from its full one's, and no one said how."""
    return pair.is_partial and pair.options.partial_scale == 1 and not part_areas(pair).are_possible


def unit_warnings(pair: Pair) -> tuple[str, ...]:
    """Say if the area of a partial shape cannot be that of a part of the full one.

    Returns:
        At most one line, that names both areas and what to give.
    """
    if not pair.is_partial:
        return ()
    areas = part_areas(pair)
    if areas.are_possible:
        return ()
    estimated = "its size is estimated; " if has_unknown_units(pair) else ""
    exchanged = ", or name the other shape as the partial one" if areas.partial > areas.full else ""
    return (
        f"the partial shape's area is {areas.partial:.3g}, the full one's {areas.full:.3g}: their units seem to differ"
        f"; {estimated}give partial_scale, by how much the partial shape's lengths are to be multiplied{exchanged}",
    )


def _has_outliers(shape: PreprocessedShape) -> bool:
    """Whether some points lie far from all others."""
    points = shape.operators.points.cpu().numpy()
    away = KDTree(points).query(points, k=_NEIGHBOURS + 1)[0][:, -1]
    return bool(np.mean(away > _FAR_AWAY * np.median(away)) > _MANY_OUTLIERS)


def _half_size(shape: PreprocessedShape) -> float:
    """The median distance of a shape's points from their median, in the file's units."""
    points = shape.repaired.shape.points
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))
