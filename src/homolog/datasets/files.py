"""Which files of a folder are meshes, or clouds."""

from __future__ import annotations

from pathlib import Path

from homolog.core.errors import DataError
from homolog.shapes import READABLE

# Suffixes of files that hold points alone, and of those that may hold anything, such as the lists of a set.
_CLOUDS = (".xyz", ".csv", ".npy", ".npz", ".pcd")
_ANYTHING = (".txt",)
_SHAPES = tuple(suffix for suffix in READABLE if suffix not in _ANYTHING)
_MESHES = tuple(suffix for suffix in _SHAPES if suffix not in _CLOUDS)


def mesh_files(folder: Path, *, clouds: bool = False) -> dict[str, Path]:
    """The file of each mesh in a folder by its name, in order, and of each cloud if asked for. No hidden ones.

    Raises:
        DataError: if there is none, or two have one name.
    """
    wanted = _SHAPES if clouds else _MESHES
    found = sorted(path for path in folder.glob("[!.]*") if path.suffix.lower() in wanted)
    files = {path.stem: path for path in found}
    if not files:
        what = "shapes" if clouds else "meshes"
        raise DataError(f"{folder}: no {what}; put files there whose suffix is one of {', '.join(wanted)}")
    if len(files) < len(found):
        twice = next(path for path in found if files[path.stem] != path)
        raise DataError(f"{folder}: {twice.name} and {files[twice.stem].name} have one name; keep one of them")
    return files
