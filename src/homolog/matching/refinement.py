"""Refining the point maps of a pair."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from homolog.maps import normalised, zoomout, zoomout_partial
from homolog.pairs import Pair, PointMaps, PreprocessedShape


def refine(pair: Pair, maps: PointMaps) -> PointMaps:
    """Point maps refined by ZoomOut, guided by features; as they are where the settings say so.

    Nothing is refined whose method gives no near-isometric maps, or whose features are for other shapes. Where there
    are no features, it is ZoomOut as published.

    Args:
        pair: the shapes, with features or without.
        maps: between them.
    """
    settings = pair.settings.refinement
    if settings is None or not (pair.near_isometric and pair.method.supports.refinement):
        return maps
    x, y = pair.x.operators, pair.y.operators
    features = _guides(pair.x), _guides(pair.y)
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


def _guides(shape: PreprocessedShape) -> Float[Tensor, "n d"]:
    """Features of unit norm; where there are none, what is the same everywhere and guides to nowhere."""
    if shape.features is None:
        return shape.operators.points.new_zeros(shape.operators.n_points, 1)
    return normalised(shape.features)
