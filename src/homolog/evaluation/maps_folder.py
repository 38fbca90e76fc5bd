"""Point maps that another program computed, as a method for ``evaluate``."""

from __future__ import annotations

from pathlib import Path, PurePath

import numpy as np
from jaxtyping import Int

from homolog.core.errors import DataError
from homolog.core.files import expanded, resolved
from homolog.matching import MAP_SUFFIXES, read_point_map
from homolog.shapes import Shape

_SELF_PAIR = ": without it each shape is matched with itself, too, as the published protocol has it"
_JOINTS = ("_", "-", "__")


class MapsFolder:
    """A folder with a file per pair: for each target point its source point.

    Files are called ``SOURCE_TARGET.txt``, ``SOURCE-TARGET.vts`` and the like, without the suffixes of the shapes;
    their formats are those of ``read_point_map``.

    Args:
        folder: where the files are.
        base: the first index, 0 or 1; by default 0 for ``.txt`` and ``.npz``, 1 for the others.

    Raises:
        DataError: if there is no such folder.

    Examples:
        >>> from homolog.evaluation import MapsFolder
        >>> MapsFolder(".").file("tr_reg_080", "tr_reg_091") is None
        True
    """

    def __init__(self, folder: str | Path, *, base: int | None = None) -> None:
        self.folder, self.base = expanded(folder), base
        if not self.folder.is_dir():
            raise DataError(f"{folder} is not a folder; give one with a file per pair, such as SOURCE_TARGET.txt")
        self.__name__ = resolved(self.folder).name  # what reports call the method

    def file(self, source: str, target: str) -> Path | None:
        """The file of a pair, by the names of its shapes; None if there is none.

        Raises:
            DataError: if there are several.
        """
        names = (f"{source}{joint}{target}{suffix}" for joint in _JOINTS for suffix in MAP_SUFFIXES)
        found = [name for name in names if (self.folder / name).is_file()]
        if len(found) > 1:
            raise DataError(f"{self.folder} has several maps of {source} and {target}, {' and '.join(found)}; keep one")
        return self.folder / found[0] if found else None

    def __call__(self, source: Shape, target: Shape) -> Int[np.ndarray, " n_target"]:
        """The map of a pair.

        Raises:
            DataError: if there is no file of it, it cannot be read, or its indices seem to count from another one.
        """
        names = PurePath(source.name).stem, PurePath(target.name).stem
        file = self.file(*names)
        if file is None:
            raise DataError(
                f"{self.folder} has no map of {names[0]} and {names[1]}; it must be called {names[0]}_{names[1]} with "
                f"one of the suffixes {', '.join(MAP_SUFFIXES)}; to score other pairs alone, list "
                f"them as lines SOURCE,TARGET in a file, --pairs FILE{_SELF_PAIR if names[0] == names[1] else ''}"
            )
        return read_point_map(file, base=self.base, n_others=source.n_points)
