"""The files of a folder that are meshes or point clouds, by their suffixes."""

from __future__ import annotations

from pathlib import Path

from homolog.core.errors import DataError
from homolog.shapes import READABLE

# Suffixes of files without faces, and of files that may hold anything, such as the lists of a dataset.
_CLOUDS = (".xyz", ".csv", ".npy", ".npz", ".pcd")
_ANYTHING = (".txt",)
_SHAPES = tuple(suffix for suffix in READABLE if suffix not in _ANYTHING)
_MESHES = tuple(suffix for suffix in _SHAPES if suffix not in _CLOUDS)


def mesh_files(folder: Path, *, clouds: bool = False) -> dict[str, Path]:
    """The mesh files of a folder by shape name, sorted, and on request the point clouds; hidden files are skipped.

    Raises:
        DataError: if there is none, or two have one name.
    """
    suffixes = _SHAPES if clouds else _MESHES
    found = sorted(path for path in folder.glob("[!.]*") if path.suffix.lower() in suffixes)
    files = {path.stem: path for path in found}
    if not files:
        what = "shapes" if clouds else "meshes"
        raise DataError(f"{folder}: no {what}; put files there whose suffix is one of {', '.join(suffixes)}")
    if len(files) < len(found):
        twice = next(path for path in found if files[path.stem] != path)
        raise DataError(f"{folder}: {twice.name} and {files[twice.stem].name} have one name; keep one of them")
    return files
