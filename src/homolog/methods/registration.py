"""The method ``registration``: coarse-to-fine non-rigid registration of full shapes, by positions."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from homolog.geometry import Surface
from homolog.maps import nearest_neighbour, registered_positions, registration_start
from homolog.methods.protocol import FunctionMethod
from homolog.pairs import Pair, PointMaps, PreprocessedShape, Supports


def _point_maps(pair: Pair) -> PointMaps:
    x, y = pair.x.operators.points, pair.y.operators.points
    known: dict[str, Any] = {"areas_x": _areas(pair.x), "areas_y": _areas(pair.y)}
    known["settings"] = pair.settings.registration
    if pair.options.orient == "auto":
        normals: dict[str, Any] = (
            {"normals_x": _normals(pair.x), "normals_y": _normals(pair.y)} if pair.are_meshes else {}
        )
        known["start"] = registration_start(x, y, **known, **normals)
        known |= normals if known["start"].near_rigid else {}
    on_y, on_x = registered_positions(x, y, **known)
    return PointMaps(nearest_neighbour(on_y, y).index, nearest_neighbour(on_x, x).index)


def _areas(shape: PreprocessedShape) -> Tensor:
    """The area that each point stands for, times how much it counts."""
    mass, weights = shape.operators.mass, shape.point_weights
    return mass if weights is None else mass * weights


def _normals(shape: PreprocessedShape) -> Tensor:
    faces = shape.repaired.shape.faces
    assert faces is not None
    points = shape.operators.points
    return torch.from_numpy(Surface(points.cpu().numpy(), faces).vertex_normals).to(points)


_SUPPORTS = Supports(partial=False, needs_features=False, refinement=False, small_turns=True)

METHOD = FunctionMethod("registration", _point_maps, _SUPPORTS)
