"""The method ``registration``: coarse-to-fine non-rigid registration of full shapes that stand alike, by positions."""

from __future__ import annotations

from homolog.maps import nearest_neighbour, registered_positions
from homolog.methods.protocol import FunctionMethod
from homolog.pairs import Pair, PointMaps, Supports


def _point_maps(pair: Pair) -> PointMaps:
    x, y = pair.x.operators.points, pair.y.operators.points
    on_y, on_x = registered_positions(x, y, settings=pair.settings.registration)
    return PointMaps(nearest_neighbour(on_y, y).index, nearest_neighbour(on_x, x).index)


METHOD = FunctionMethod("registration", _point_maps, Supports(partial=False, needs_features=False, refinement=False))
