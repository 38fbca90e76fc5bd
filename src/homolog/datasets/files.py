"""Which files of a folder are meshes, or clouds."""

from __future__ import annotations

from pathlib import Path

from homolog.core.errors import DataError
from homolog.shapes import folder_suffixes


def mesh_files(folder: Path, *, clouds: bool = False) -> dict[str, Path]:
    """The file of each mesh in a folder by its name, in order, and of each cloud if asked for. No hidden ones.

    Raises:
        DataError: if there is none, or two have one name.
    """
    wanted = folder_suffixes(clouds=clouds)
    found = sorted(path for path in folder.glob("[!.]*") if path.suffix.lower() in wanted)
    files = {path.stem: path for path in found}
    if not files:
        what = "shapes" if clouds else "meshes"
        raise DataError(f"{folder}: no {what}; put files there whose suffix is one of {', '.join(wanted)}")
    if len(files) < len(found):
        twice = next(path for path in found if files[path.stem] != path)
        raise DataError(f"{folder}: {twice.name} and {files[twice.stem].name} have one name; keep one of them")
    return files
