"""What leaves a match: distances of counterparts, displacement fields, particles."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import torch
from jaxtyping import Float

from homolog.core.arguments import check_choice
from homolog.core.choices import System
from homolog.core.errors import ArgumentError
from homolog.core.files import atomic_path, made_folder, write_csv
from homolog.core.progress import Progress, ignore
from homolog.geometry.projection import SurfaceProjector
from homolog.maps import best_similarity, rigid_motion
from homolog.matching import Match
from homolog.shapes import drawable, write_shape
from homolog.transfer.landmarks import system_of
from homolog.transfer.smooth_map import surface_map
from homolog.volumes import DisplacementField, displacement_field

Align = Literal["none", "rigid", "similarity"]
"""How the target is brought onto the source before distances are measured."""
PARTICLES = ("source.particles", "target.particles")
"""The files of ``write_particles``."""
_LPS_TO_RAS = np.array([-1.0, -1.0, 1.0])


@dataclass(frozen=True, eq=False)
class PointDistances:
    """How far the points of a match's source lie from their counterparts.

    Args:
        positions: the counterpart of each source point, on the target's surface, in the target's coordinates or, where
            that was aligned, in the source's; NaN without a counterpart (n, 3).
        distances: of each, in the unit of the coordinates (n,).
        along_normals: the part of the displacement along the source's normal, positive outward; NaN for clouds (n,).
    """

    positions: Float[np.ndarray, "n 3"]
    distances: Float[np.ndarray, " n"]
    along_normals: Float[np.ndarray, " n"]


def point_distances(match: Match, *, align: Align = "none") -> PointDistances:
    """The distance of each source point from its counterpart, along a smooth map between the surfaces.

    Args:
        match: of two shapes in one frame, or in two that ``align`` brings together.
        align: ``"rigid"`` turns and shifts the target onto the source, so that counterparts lie near: robustly, so that
            what has changed counts little (``homolog.maps.rigid_motion``). ``"similarity"`` also scales it, in least
            squares.

    Raises:
        ArgumentError: if there is no such way to align, or no point has a counterpart.

    Examples:
        >>> import homolog
        >>> from homolog.transfer import point_distances
        >>> body = homolog.demo_shapes()[0]
        >>> moved = homolog.Shape(body.points + [0, 0, 2], body.faces)
        >>> indices = np.arange(body.n_points)
        >>> same = homolog.Match(body, moved, indices, indices)
        >>> bool(np.allclose(point_distances(same).distances, 2, atol=0.05))
        True
        >>> bool(np.allclose(point_distances(same, align="rigid").distances, 0, atol=0.05))
        True
    """
    check_choice("align", align, get_args(Align))
    source = SurfaceProjector(match.source)
    positions = surface_map(source, match.target, match).positions
    known, points = np.isfinite(positions).all(axis=1), match.source.points
    if align == "rigid":
        turn, shift = rigid_motion(positions[known], points[known])
        positions = positions @ turn.T + shift
    elif align == "similarity":
        found = best_similarity(torch.from_numpy(positions[known]), torch.from_numpy(points[known]))
        positions = found(torch.from_numpy(positions)).numpy()
    away = positions - points
    along = np.full(len(points), np.nan)
    if source.surface is not None:
        normals = source.repaired.to_original(source.surface.vertex_normals, fill=np.nan)
        along = np.einsum("nk,nk->n", away, normals)
    return PointDistances(positions, np.linalg.norm(away, axis=1), along)


def write_distances(path: str | Path, match: Match, found: PointDistances, colours: np.ndarray) -> None:
    """Write the source as PLY with the numbers ``distance`` and ``along_normal`` of its points.

    Args:
        path: a ``.ply``.
        match: that was measured.
        found: the distances.
        colours: of the source's points, such as those of a heat map (n, 3).
    """
    numbers = {"distance": found.distances, "along_normal": found.along_normals}
    write_shape(path, drawable(match.source), colours=colours, numbers=numbers)


def write_distance_table(path: str | Path, match: Match, found: PointDistances) -> None:
    """Write a row per source point: its counterpart's place, distance, part along the normal, and confidence."""
    numbers = np.column_stack([found.positions, found.distances, found.along_normals]).tolist()
    rows = [
        (point, *(value if np.isfinite(value) else None for value in row), trust)
        for point, (row, trust) in enumerate(zip(numbers, match.source_confidence.tolist(), strict=True))
    ]
    write_csv(path, [("point", "x", "y", "z", "distance", "along_normal", "confidence"), *rows])


def write_particles(folder: str | Path, match: Match) -> list[Path]:
    """Write points of both shapes in correspondence as ShapeWorks reads them: a point a line, equal lines correspond.

    Those are the source's points that have a counterpart, and their places on the target.

    Returns:
        The files that were written.
    """
    positions = surface_map(match.source, match.target, match).positions
    known = np.isfinite(positions).all(axis=1)
    paths = [made_folder(folder) / name for name in PARTICLES]
    for path, points in zip(paths, (match.source.points[known], positions[known]), strict=True):
        with atomic_path(path) as temporary:
            np.savetxt(temporary, points, fmt="%.17g", newline="\n")
    return paths


def field_of_match(
    match: Match,
    *,
    axes: System | None = None,
    spacing: float | None = None,
    margin: float = 0.1,
    progress: Progress = ignore,
) -> tuple[DisplacementField, tuple[float, float]]:
    """The displacement field around the target that leads to the source, in LPS coordinates.

    It resamples: for a place around the target it says where the same place of the source is. By it ITK and 3D Slicer
    draw a volume of the source around the target.

    Args:
        match: ``match.inverse()`` gives the field around the source.
        axes: the anatomical axes of both shapes; by default those that their files name, or LPS.
        spacing: between the nodes of the grid; by default 64 lie along its longest side.
        margin: around the target, as a share of its longest side.
        progress: called with slices that are done.

    Returns:
        The field; and how far, on average and at most, it leads from the counterparts of the target's points when it is
        read between nodes: the finer the grid, the nearer. At its nodes it is exact.

    Raises:
        ArgumentError: if a number is out of range, fewer than four points have a counterpart, or both shapes have axes
            of their own.
    """
    systems = {system_of(shape.space, axes) for shape in (match.source, match.target)}
    if len(systems) > 1:
        raise ArgumentError("the shapes' files name different anatomical axes, RAS and LPS; give axes, or convert one")
    positions = surface_map(match.target, match.source, match.inverse()).positions
    known = np.isfinite(positions).all(axis=1)
    signs = _LPS_TO_RAS if systems == {"RAS"} else np.ones(3)
    points, displacements = signs * match.target.points[known], signs * (positions - match.target.points)[known]
    field = displacement_field(points, displacements, spacing=spacing, margin=margin, progress=progress)
    errors = np.linalg.norm(field.at(points) - displacements, axis=1)
    return field, (float(errors.mean()), float(errors.max()))
