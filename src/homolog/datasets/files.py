"""The files of a folder that are meshes or point clouds, by their suffixes."""

from __future__ import annotations

from pathlib import Path

from homolog.core.errors import DataError
from homolog.shapes import folder_suffixes


def mesh_files(folder: Path, *, clouds: bool = False) -> dict[str, Path]:
    """The mesh files of a folder by shape name, sorted, and on request the point clouds; hidden files are skipped.

    Raises:
        DataError: if there is none, or two have one name.
    """
    suffixes = folder_suffixes(clouds=clouds)
    found = sorted(path for path in folder.glob("[!.]*") if path.suffix.lower() in suffixes)
    files = {path.stem: path for path in found}
    if not files:
        what = "shapes" if clouds else "meshes"
        raise DataError(f"{folder}: no {what}; put files there whose suffix is one of {', '.join(suffixes)}")
    if len(files) < len(found):
        twice = next(path for path in found if files[path.stem] != path)
        raise DataError(f"{folder}: {twice.name} and {files[twice.stem].name} have one name; keep one of them")
    return files
