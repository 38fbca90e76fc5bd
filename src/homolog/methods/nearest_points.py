"""The method ``nearest-points``: the nearest points of shapes that stand alike. A baseline."""

from __future__ import annotations

from homolog.maps import nearest_neighbour
from homolog.methods.protocol import FunctionMethod, Supports
from homolog.pairs import Pair, PointMaps


def _point_maps(pair: Pair) -> PointMaps:
    x, y = pair.x.operators.points, pair.y.operators.points
    return PointMaps(nearest_neighbour(x, y).index, nearest_neighbour(y, x).index)


METHOD = FunctionMethod("nearest-points", _point_maps, Supports(needs_features=False, refinement=False))
