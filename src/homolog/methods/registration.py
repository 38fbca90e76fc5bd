"""The method ``registration``: coarse-to-fine non-rigid registration of full shapes, by positions."""

from __future__ import annotations

from dataclasses import replace

import torch

from homolog.geometry import areas_by_density, lies_in_lines
from homolog.maps import RegistrationStart, SampledSurface, nearest_neighbour, registered_surfaces, registration_start
from homolog.methods.protocol import FunctionMethod
from homolog.pairs import Pair, PointMaps, PreprocessedShape, Supports


def started(pair: Pair) -> Pair:
    """An oriented pair with where its registration begins: that also tells whether the shapes are nearly rigid copies.

    Or whether they have a distinct form and are not bent against each other, as bones of one kind. Where the way round
    is trusted as given, nothing is looked at.
    """
    return replace(pair, start=_start(pair, *_surfaces(pair))) if pair.options.orient == "auto" else pair


def _point_maps(pair: Pair) -> PointMaps:
    x, y = _surfaces(pair)
    start = pair.start or _start(pair, x, y)
    if not start.near_rigid:
        x, y = replace(x, normals=None), replace(y, normals=None)
    on_y, on_x = registered_surfaces(x, y, start=start, settings=pair.settings.registration)
    return PointMaps(nearest_neighbour(on_y, y.points).index, nearest_neighbour(on_x, x.points).index)


def _start(pair: Pair, x: SampledSurface, y: SampledSurface) -> RegistrationStart:
    """Where x starts; poses that are trusted are turned for nearly rigid copies alone."""
    return registration_start(x, y, turns=pair.options.orient == "auto", settings=pair.settings.registration)


def _surfaces(pair: Pair) -> tuple[SampledSurface, SampledSurface]:
    return _surface(pair.x), _surface(pair.y)


def _surface(shape: PreprocessedShape) -> SampledSurface:
    """The points, with the area that each stands for, times how much it counts; with normals where there are faces."""
    points, areas, weights = shape.operators.points, shape.operators.mass, shape.point_weights
    if shape.surface is not None:
        normals = torch.from_numpy(shape.surface.vertex_normals).to(points)
        return SampledSurface(points, areas if weights is None else areas * weights, normals)
    positions = points.double().cpu().numpy()
    if in_lines := lies_in_lines(positions):
        areas = torch.from_numpy(areas_by_density(positions)).to(areas)
    return SampledSurface(points, areas if weights is None else areas * weights, in_lines=in_lines)


_SUPPORTS = Supports(partial=False, needs_features=False, refinement=False, small_turns=True)

METHOD = FunctionMethod("registration", _point_maps, _SUPPORTS)
