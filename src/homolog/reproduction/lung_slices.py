"""Surfaces of lungs and clouds of some of their slices, of one patient and of two, made of clouds that correspond."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from homolog.core.files import all_or_nothing, atomic_path, open_text, sha256
from homolog.core.folders import prepare_folder, remove_if_unused
from homolog.core.progress import Progress
from homolog.datasets import ShapeFolder
from homolog.shapes import Shape, write_shape
from homolog.volumes import Mask, mask_surface, reconstruct_surface, slice_cloud

# A version, increased whenever the same files give other shapes.
_MAKING = 1
_FOLDERS = ("off", "clouds", "truth")
# In millimetres: the side of a voxel, and how far a point of a slice may be from the points that correspond.
_VOXEL, _FARTHEST = 2.0, 5.0
# Every so many slices are known, and so many points of surfaces and of slices are kept.
_EVERY, _POINTS = 5, 3000
# So many lungs are taken, and of their reconstructions so many voxels along the longest side.
_LUNGS, _RESOLUTION = 6, 96
# Slices are horizontal; shapes stand +y up.
_UP = 1
_PAIRS = "pairs.txt"


@dataclass(frozen=True, eq=False)
class _Lung:
    """A mask, its surface, points of its slices, and the points that correspond to those of the other lungs."""

    points: Float[np.ndarray, "p 3"]
    surface: Shape
    slices: Shape


def write_lung_slices(source: ShapeFolder, output: Path, *, progress: Progress) -> None:
    """Write pairs of a surface and a slice cloud: of one mask, and of the masks of two patients, for some test shapes.

    Where there are clouds in correspondence and no masks, a mask is the solid that the cloud's surface bounds. The
    surface and the slices are made of the mask. Ground truth of one mask is the nearest point of the surface; of two
    patients, the same after the displacement of the nearest of the points that correspond. A folder that is complete
    is kept.

    Args:
        source: clouds of which row i is the same point.
        output: a new folder, or one that an earlier call began.
        progress: told of each lung.
    """
    names = source.split("test")[:_LUNGS]
    making = {"way": _MAKING, "clouds": {name: sha256(source.file(name)) for name in names}}
    manifest = {"what": "surfaces and slices of lungs", "making": making}
    with remove_if_unused(output, _FOLDERS):
        prepare_folder(output, manifest, _FOLDERS)
        if (output / _PAIRS).is_file():
            return
        lungs = dict[str, _Lung]()
        for number, name in enumerate(names):
            progress(number, len(names), name)
            lungs[name] = _lung(source, name)
        pairs = list[tuple[str, str]]()
        for name, other in zip(names, (*names[1:], names[0]), strict=True):
            pairs += [(name, f"{name}-own"), (name, f"{other}-other")]
            _write(output, f"{name}-own", lungs[name], lungs[name])
            _write(output, f"{other}-other", lungs[other], lungs[name])
            write_shape(output / "off" / f"{name}.off", lungs[name].surface)
        with atomic_path(output / _PAIRS) as temporary, open_text(temporary) as lines:
            lines.writelines(f"{full},{target}\n" for full, target in pairs)


def _lung(source: ShapeFolder, name: str) -> _Lung:
    shape = source.shape(name)
    rows = source.ground_truth().between(source.names[0], name).target
    solid = mask_of(reconstruct_surface(shape, points=None, resolution=_RESOLUTION))
    surface, slices = mask_surface(solid, points=_POINTS), slice_cloud(solid, axis=_UP, every=_EVERY)
    if slices.n_points > _POINTS:
        slices = slice_cloud(solid, axis=_UP, every=_EVERY, points=_POINTS)
    return _Lung(shape.points[rows], surface, slices)


def mask_of(surface: Shape) -> Mask:
    """The voxels inside a closed surface."""
    voxels = trimesh.Trimesh(surface.points, surface.faces, process=False).voxelized(_VOXEL).fill()
    return Mask(np.asarray(voxels.matrix), voxels.transform[:3, 3], voxels.transform[:3, :3], surface.name)


def _write(output: Path, target: str, lung: _Lung, full: _Lung) -> None:
    """Write a slice cloud with the surface of its own lung, and where its points lie on the surface of the full one."""
    with all_or_nothing():
        write_shape(output / "off" / f"{target}.off", lung.surface)
        write_shape(output / "clouds" / f"{target}.ply", lung.slices)
        with atomic_path(output / "truth" / f"{target}.npz") as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, cloud_to_full=_truth(lung, full))


def _truth(lung: _Lung, full: _Lung) -> Int[np.ndarray, " n"]:
    """For each point of a lung's slices the vertex of the full surface that it corresponds to, or -1."""
    away, row = KDTree(lung.points).query(lung.slices.points)
    moved = lung.slices.points + full.points[row] - lung.points[row]
    nearest = KDTree(full.surface.points).query(moved)[1]
    return np.where(away <= _FARTHEST, nearest, -1)
