"""Which files of a folder are meshes."""

from __future__ import annotations

from pathlib import Path

from homolog.errors import DataError
from homolog.shapes import READABLE

# Suffixes of files that hold points alone, or anything at all.
_NO_MESHES = (".xyz", ".txt", ".csv", ".npy", ".npz", ".pcd")
_MESHES = tuple(suffix for suffix in READABLE if suffix not in _NO_MESHES)


def mesh_files(folder: Path) -> dict[str, Path]:
    """The file of each mesh in a folder by its name, in order. Hidden files do not count.

    Raises:
        DataError: if there is none, or two have one name.
    """
    found = sorted(path for path in folder.glob("[!.]*") if path.suffix.lower() in _MESHES)
    files = {path.stem: path for path in found}
    if not files:
        raise DataError(f"{folder}: no meshes; put files there whose suffix is one of {', '.join(_MESHES)}")
    if len(files) < len(found):
        twice = next(path for path in found if files[path.stem] != path)
        raise DataError(f"{folder}: {twice.name} and {files[twice.stem].name} have one name; keep one of them")
    return files
