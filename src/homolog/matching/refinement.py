"""Refining the point maps of a pair."""

from __future__ import annotations

from homolog.maps import normalised, zoomout, zoomout_partial
from homolog.pairs import Pair, PointMaps


def refine(pair: Pair, maps: PointMaps) -> PointMaps:
    """Point maps refined by ZoomOut, guided by features; as they are where the settings say so.

    Nothing is refined whose method gives no near-isometric maps, or whose features are for other shapes.

    Args:
        pair: the shapes, with features.
        maps: between them.
    """
    settings = pair.settings.refinement
    if settings is None or not (pair.near_isometric and pair.method.supports.refinement):
        return maps
    x, y = pair.x.operators, pair.y.operators
    features = normalised(pair.x.needed_features()), normalised(pair.y.needed_features())
    if pair.is_partial:
        y_to_x, x_to_y = zoomout_partial(
            maps.y_to_x,
            x.eigenvectors,
            y.eigenvectors,
            x.eigenvalues,
            y.eigenvalues,
            *features,
            settings=settings,
        )
    else:
        y_to_x, x_to_y = zoomout(maps.y_to_x, maps.x_to_y, x.eigenvectors, y.eigenvectors, *features, settings=settings)
    return PointMaps(x_to_y=x_to_y, y_to_x=y_to_x)
