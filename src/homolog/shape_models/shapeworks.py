"""Export to ShapeWorks: particle files, and a project in JSON, as ShapeWorks 6 reads them.

A particle file has a point a line. Local particles are in the shape's own coordinates, world particles are aligned; the
project lists the files, and holds the alignment as a matrix, row by row.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from homolog.core.files import atomic_path, made_folder, write_json
from homolog.statistics import Aligned, FileRows

_PROJECT, _PARTICLES = "collection.swproj", "particles"
_IDENTITY = " ".join(f"{entry:g}" for entry in np.eye(4).ravel())


def write_shapeworks(
    folder: Path,
    names: Sequence[str],
    points: Float[np.ndarray, "s n 3"] | FileRows,
    aligned: Aligned,
    meshes: Sequence[Path] | None,
    *,
    kept: Bool[np.ndarray, " n"] | None = None,
) -> list[Path]:
    """Write a project and the particles of all shapes.

    Args:
        folder: created if needed.
        names: of the shapes.
        points: on each shape, in its own coordinates.
        aligned: the same, aligned.
        meshes: a mesh of each shape, which the project refers to; None for clouds.
        kept: which points to write (n,); by default all.

    Returns:
        The files.

    Raises:
        ArgumentError: if a file cannot be written.
    """
    particles, written = made_folder(folder / _PARTICLES), []
    taken = slice(None) if kept is None else kept
    entries: list[dict[str, str]] = []
    for number, name in enumerate(names):
        local, world = (particles / f"{name}_{kind}.particles" for kind in ("local", "world"))
        _write_particles(local, points[number][taken])
        _write_particles(world, aligned[number][taken])
        written += [local, world]
        path = None if meshes is None else Path(os.path.relpath(meshes[number], folder)).as_posix()
        mesh = {} if path is None else {"shape_1": path, "groomed_1": path}
        entries.append(
            {
                "name": name,
                **mesh,
                "local_particles_1": f"{_PARTICLES}/{local.name}",
                "world_particles_1": f"{_PARTICLES}/{world.name}",
                "alignment_1": _IDENTITY,
                "procrustes_1": _matrix(aligned, number),
            }
        )
    project: dict[str, Any] = {"data": entries, "project": {"version": "2"}, "landmarks": []}
    write_json(folder / _PROJECT, project)
    return [*written, folder / _PROJECT]


def _matrix(aligned: Aligned, number: int) -> str:
    matrix = np.eye(4)
    matrix[:3, :3] = aligned.scales[number] * aligned.rotations[number]
    matrix[:3, 3] = aligned.shifts[number]
    return " ".join(repr(float(entry)) for entry in matrix.ravel())


def _write_particles(path: Path, points: Float[np.ndarray, "n 3"]) -> None:
    # A reader that stops at the end of the file would lose the last point without a line's end.
    with atomic_path(path) as temporary:
        np.savetxt(temporary, points, fmt="%.17g", newline="\n")
