"""The method ``registration``: coarse-to-fine non-rigid registration of full shapes, by positions."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from homolog.maps import RegistrationStart, SampledSurface, nearest_neighbour, registered_surfaces, registration_start
from homolog.methods.protocol import FunctionMethod
from homolog.pairs import Pair, PointMaps, PreprocessedShape, Supports


def started(pair: Pair) -> Pair:
    """An oriented pair with where its registration begins: that also tells whether the shapes are nearly rigid copies.

    Or whether they have a distinct form and are not bent against each other, as bones of one kind. Where the way round
    is trusted as given, nothing is looked at.
    """
    return replace(pair, start=_surfaces(pair)[2])


def _point_maps(pair: Pair) -> PointMaps:
    x, y, start = _surfaces(pair)
    on_y, on_x = registered_surfaces(x, y, start=start, settings=pair.settings.registration)
    return PointMaps(nearest_neighbour(on_y, y.points).index, nearest_neighbour(on_x, x.points).index)


def _surfaces(pair: Pair) -> tuple[SampledSurface, SampledSurface, RegistrationStart | None]:
    """Both, with normals if they are nearly rigid copies, and where x starts if the way round is looked for."""
    x, y = (SampledSurface(shape.operators.points, _areas(shape)) for shape in (pair.x, pair.y))
    if pair.options.orient != "auto":
        return x, y, None
    oriented = _with_normals(x, pair.x), _with_normals(y, pair.y)
    start = pair.start or registration_start(*oriented, settings=pair.settings.registration)
    return (*oriented, start) if start.near_rigid else (x, y, start)


def _areas(shape: PreprocessedShape) -> Tensor:
    """The area that each point stands for, times how much it counts."""
    mass, weights = shape.operators.mass, shape.point_weights
    return mass if weights is None else mass * weights


def _with_normals(points: SampledSurface, shape: PreprocessedShape) -> SampledSurface:
    """The points with normals, where the shape has faces."""
    if shape.surface is None:
        return points
    return replace(points, normals=torch.from_numpy(shape.surface.vertex_normals).to(points.points))


_SUPPORTS = Supports(partial=False, needs_features=False, refinement=False, small_turns=True)

METHOD = FunctionMethod("registration", _point_maps, _SUPPORTS)
