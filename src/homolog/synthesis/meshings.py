"""Other meshings of the shapes of a dataset, with triangles that are stretched, and with the same ground truth."""

from __future__ import annotations

import zlib
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from typing_extensions import TypedDict

from homolog.core.choices import Split
from homolog.core.cluster import Processes
from homolog.core.errors import DataError, ShapeError
from homolog.core.files import all_or_nothing, atomic_path, expanded, open_text, sha256, write_json
from homolog.core.folders import MANIFEST, prepare_folder, remove_if_unused
from homolog.core.progress import Progress, ignore
from homolog.core.records import read_record, record, stored_record
from homolog.core.tasks import check_processes, run_tasks
from homolog.datasets import DatasetDescription, ShapeFolder
from homolog.datasets.folder import path_of
from homolog.datasets.truth import check_vertices
from homolog.geometry.projection import SurfacePoints, SurfaceProjector
from homolog.geometry.scale import surface_area
from homolog.geometry.surface import ReferenceSurface, Surface
from homolog.shapes import Shape, repair, write_shape
from homolog.synthesis.bodies import BodySettings
from homolog.synthesis.ground_truth import project_mesh
from homolog.synthesis.remeshing import MeshSettings, remesh, shorter_where_bent
from homolog.synthesis.self_intersections import self_intersection_share
from homolog.synthesis.sheets import separated_sheets

# A version, increased whenever the same settings give other meshes.
_MAKING = 1
_FOLDERS = ("off", "corres", "truth")
STRETCHED = MeshSettings(stretch=3.0)
"""Triangles that are three times as long as wide."""
_DIGITS = 6


@record
class _Record(TypedDict):
    """Of a mesh."""

    sha256: dict[str, str]


@dataclass(frozen=True, eq=False)
class Meshing:
    """Another mesh of a shape, and where points of the shape lie on it.

    Args:
        shape: the mesh.
        places: of the points, exactly.
        vertices: the nearest corner of the triangle in which each lies (p,).
        rounding: how far each vertex is from its point, in units of sqrt(area) (p,).
        crossing: share of the triangles that intersect another one.
    """

    shape: Shape
    places: SurfacePoints
    vertices: Int[np.ndarray, " p"]
    rounding: Float[np.ndarray, " p"]
    crossing: float


def other_meshing(
    shape: Shape, points: Int[np.ndarray, " p"], settings: MeshSettings = STRETCHED, *, seed: int = 0
) -> Meshing:
    """Mesh a closed shape anew, and find some of its points on the new mesh.

    A point is looked for where the new surface is nearest and has a normal that agrees, so that none lands on the far
    side of a hand, or on what the hand touches. New here; see ``remesh`` for the meshing.

    Args:
        shape: a closed mesh; it may touch itself.
        points: of the shape.
        settings: number of vertices, and how long triangles are.
        seed: of the direction in which triangles are long, and of all else that is random.

    Raises:
        ShapeError: if the shape cannot be repaired, or is not closed.

    Examples:
        >>> import trimesh
        >>> from homolog import Shape
        >>> from homolog.synthesis import MeshSettings, other_meshing
        >>> ball = trimesh.creation.icosphere(subdivisions=3)
        >>> found = other_meshing(Shape(ball.vertices, ball.faces), np.arange(20), MeshSettings(600, 3.0), seed=1)
        >>> found.vertices.shape, 500 < found.shape.n_points < 700
        ((20,), True)
    """
    repaired = repair(shape)
    if repaired.shape.faces is None:
        raise ShapeError(f"{shape.name} is a point cloud, but only meshes can be meshed anew; give a mesh")
    apart, copies = separated_sheets(Surface(repaired.shape.points, repaired.shape.faces), shape.name)
    reference = ReferenceSurface(apart)
    generator = np.random.default_rng(seed)
    mesh, _ = project_mesh(
        remesh(reference, shorter_where_bent(apart, settings.stretch), settings, generator), reference
    )
    written = Shape(mesh.vertices.round(_DIGITS) + 0.0, mesh.faces, name=shape.name)
    first_copy = np.searchsorted(copies, repaired.clean_index[points])
    wanted = apart.vertices[first_copy]
    places = SurfaceProjector(written).project(wanted, apart.vertex_normals[first_copy])
    away = np.linalg.norm(written.points[places.corners] - wanted[:, None], axis=2)
    vertices = np.take_along_axis(places.corners, away.argmin(axis=1)[:, None], axis=1)[:, 0]
    rounding = away.min(axis=1) / np.sqrt(surface_area(written))
    return Meshing(written, places, vertices, rounding, self_intersection_share(mesh))


def write_meshings(
    source: str | Path,
    output: str | Path,
    *,
    description: DatasetDescription | None = None,
    split: Split = "test",
    settings: MeshSettings = STRETCHED,
    seed: int = 0,
    processes: Processes = 1,
    progress: Progress | None = None,
) -> None:
    """Write a dataset of other meshings of a dataset's shapes; docs/conventions.md lists its files.

    Each shape has a mesh, and a direction in which triangles are long, that depend on the seed and its name alone.
    Existing meshes are kept.

    Args:
        source: a dataset with template correspondence.
        output: a new folder, or one that an earlier call with the same source, seed and settings began.
        description: of the dataset; by default a folder with ``off/`` and ``corres/``.
        split: which shapes.
        settings: number of vertices, and how long triangles are.
        seed: of all random choices; the same source, seed and settings give the same bytes.
        processes: number of worker processes, or a cluster.
        progress: called with the number of finished meshes, their total and the current one's name.

    Raises:
        ArgumentError: if ``output`` holds anything else, or a setting is out of range.
        DataError: if the source has no shapes, or no template correspondence.
        ShapeError: if a shape is not closed.

    Examples:
        >>> write_meshings("FAUST_r", "FAUST_stretched", seed=1)  # doctest: +SKIP
    """
    BodySettings(seed, settings)
    check_processes(processes)
    folder, root = ShapeFolder.open(source, description), expanded(output)
    if folder.description.truth != "template-correspondence" or folder.description.full:
        raise DataError(
            f"{folder.root} has no template correspondence of full shapes, which other meshings would keep; take a "
            "dataset that has"
        )
    names = folder.split(split)
    shapes = {name: sha256(folder.file(name)) for name in names}
    making = {"way": _MAKING, "seed": seed, **asdict(settings), "shapes": shapes}
    manifest = {"what": "other meshings, made by homolog synth meshings", "making": making, "meshes": []}
    with remove_if_unused(root, _FOLDERS):
        prepare_folder(root, manifest, _FOLDERS)
        tasks = [(name, partial(_write, folder, name, root, settings, seed)) for name in names]
        run_tasks([tasks], processes=processes, progress=progress or ignore, reads=[folder.root], writes=root)
    with atomic_path(root / "test.txt") as temporary, open_text(temporary) as lines:
        lines.writelines(f"{name}\n" for name in names)
    records = [read_record(_record_file(root, name), _Record, instead="remove it") for name in names]
    write_json(root / MANIFEST, {**manifest, "meshes": records})


def _write(folder: ShapeFolder, name: str, root: Path, settings: MeshSettings, seed: int) -> None:
    """Write a mesh, its ground truth and, last, its record."""
    files = {key: root / key for key in (f"off/{name}.off", f"corres/{name}.vts", f"truth/{name}.npz")}
    stored = stored_record(_record_file(root, name), _Record)
    if stored and all(file.is_file() and sha256(file) == stored["sha256"].get(key) for key, file in files.items()):
        return
    shape, template = folder.shape(name), folder.template_correspondence(name)
    check_vertices(path_of(folder.root, folder.description.truth_files, name), template, shape, "get both again")
    known = np.flatnonzero(template >= 0)
    own_seed = zlib.crc32(f"{seed} {name}".encode(errors="surrogateescape"))
    found = other_meshing(shape, template[known], settings, seed=own_seed)
    vertices, triangles, weights = np.full(len(template), -1), np.full(len(template), -1), np.zeros((len(template), 3))
    vertices[known], triangles[known], weights[known] = found.vertices + 1, found.places.faces, found.places.weights
    with all_or_nothing():
        off, vts, npz = files.values()
        write_shape(off, found.shape)
        with atomic_path(vts) as temporary:
            np.savetxt(temporary, vertices, fmt="%d", newline="\n")
        with atomic_path(npz) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, triangles=triangles, weights=weights)
    told = {
        "name": name,
        "vertices": found.shape.n_points,
        "faces": found.shape.n_faces,
        "crossing_share": round(found.crossing, 6),
        "mean_rounding": round(float(found.rounding.mean()), 6),
        "sha256": {key: sha256(file) for key, file in files.items()},
    }
    write_json(_record_file(root, name), told)


def _record_file(root: Path, name: str) -> Path:
    return root / "truth" / f"{name}.json"
