"""The method ``registration``: coarse-to-fine non-rigid registration of full shapes, by positions."""

from __future__ import annotations

from homolog.maps import nearest_neighbour, registered_positions, registration_start
from homolog.methods.protocol import FunctionMethod
from homolog.pairs import Pair, PointMaps, Supports


def _point_maps(pair: Pair) -> PointMaps:
    x, y = pair.x.operators.points, pair.y.operators.points
    areas = {"areas_x": pair.x.operators.mass, "areas_y": pair.y.operators.mass}
    settings = pair.settings.registration
    start = registration_start(x, y, **areas, settings=settings) if pair.options.orient == "auto" else None
    on_y, on_x = registered_positions(x, y, **areas, start=start, settings=settings)
    return PointMaps(nearest_neighbour(on_y, y).index, nearest_neighbour(on_x, x).index)


_SUPPORTS = Supports(partial=False, needs_features=False, refinement=False, small_turns=True)

METHOD = FunctionMethod("registration", _point_maps, _SUPPORTS)
