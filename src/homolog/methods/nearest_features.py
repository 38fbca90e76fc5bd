"""The method ``nearest-features``: features compared directly, by a soft map that Sinkhorn's algorithm balances."""

from __future__ import annotations

from homolog.maps import most_similar, sinkhorn_matches
from homolog.methods.protocol import FunctionMethod
from homolog.pairs import Pair, PointMaps, Supports


def _point_maps(pair: Pair) -> PointMaps:
    x, y = pair.x.needed_features(), pair.y.needed_features()
    settings = pair.settings.soft_map
    if settings.normalise:
        x, y = pair.x.unit_features(), pair.y.unit_features()
    if pair.options.partial is not None:
        # The softmax over the full shape: its argmax is the most similar point, at any temperature. Nor can it be
        # balanced between two parts: what one lacks of the other is not known yet.
        return PointMaps(most_similar(x, y).index, most_similar(y, x).index)
    soft = sinkhorn_matches(y, x, temperature=pair.temperature, iterations=settings.iterations)
    return PointMaps(x_to_y=soft.x_to_y, y_to_x=soft.y_to_x)


METHOD = FunctionMethod("nearest-features", _point_maps, Supports(parts=True))
