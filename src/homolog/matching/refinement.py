"""The point maps of a pair: by its method, and refined."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

from homolog.core.method_names import own_methods
from homolog.core.plugins import blamed_on
from homolog.core.unchanged import left_unchanged
from homolog.maps import zoomout, zoomout_partial
from homolog.matching.parts import maps_of_parts
from homolog.matching.result import checked_maps
from homolog.pairs import Pair, PointMaps


def method_maps(pair: Pair) -> PointMaps:
    """The point maps that the pair's method finds, checked, as it may be anyone's.

    Raises:
        ArgumentError: if they do not fit the pair, or a method of another's fails, or changes what it is lent.
    """
    who, where = f"method {pair.method.name!r}", f"{pair.source.name} -> {pair.target.name}"
    lent = {f"{name} of {one.name}": t for one in (pair.x, pair.y) for name, t in one.tensors().items()}
    # What fails in a method of Homolog's own is no mistake of a user's.
    blame = nullcontext() if pair.method.name in own_methods() else blamed_on(who, where)
    with left_unchanged(who, lent), blame:
        maps = pair.method(pair)
    return checked_maps(pair, maps)


def refine(pair: Pair, maps: PointMaps) -> PointMaps:
    """Point maps refined by ZoomOut, guided by features and landmarks; as they are where the settings say so.

    Those of two parts by a method of Homolog's own are made anew, see ``maps_of_parts``. Nothing is refined whose
    method gives no near-isometric maps, or whose features are for other shapes. Where there are no features, it is
    ZoomOut as published.

    Args:
        pair: the shapes, with features or without.
        maps: between them.
    """
    settings = pair.settings.refinement
    if pair.are_parts:
        is_own = pair.method.name in own_methods() and pair.method.supports.refinement
        return maps_of_parts(pair) if is_own and settings is not None and pair.fit is not None else maps
    if settings is None or not (pair.near_isometric and pair.method.supports.refinement):
        return maps
    x, y = pair.x.operators, pair.y.operators
    features = pair.x.unit_features(), pair.y.unit_features()
    landmarks = None if pair.guidance is None else pair.guidance.rows(pair.settings.guidance.rows)
    weights: dict[str, Any] = {"weights_x": pair.x.point_weights, "weights_y": pair.y.point_weights}
    if pair.is_partial:
        y_to_x, x_to_y = zoomout_partial(
            maps.y_to_x,
            x.eigenvectors,
            y.eigenvectors,
            x.eigenvalues,
            y.eigenvalues,
            *features,
            settings=settings,
            landmarks=landmarks,
            **weights,
        )
    else:
        y_to_x, x_to_y = zoomout(
            maps.y_to_x,
            maps.x_to_y,
            x.eigenvectors,
            y.eigenvectors,
            *features,
            settings=settings,
            landmarks=landmarks,
            **weights,
        )
    return PointMaps(x_to_y=x_to_y, y_to_x=y_to_x)
