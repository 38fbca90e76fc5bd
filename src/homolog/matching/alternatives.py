"""The maps of other ways round, in folders within the folder of a result."""

from __future__ import annotations

from itertools import count
from pathlib import Path

from homolog.core.errors import DataError
from homolog.core.files import expanded
from homolog.matching.result import Match

_NAME = "alternative-"
FIRST_ALTERNATIVE = 2
"""The number of the first of them: the result itself is number 1."""


def alternative_folder(result: str | Path, number: int) -> Path:
    """The folder of an alternative within that of its result; 2 is the first one."""
    return Path(result) / f"{_NAME}{number}"


def alternative_folders(result: str | Path) -> list[Path]:
    """The folders of alternatives that lie in that of a result, whatever their numbers."""
    return [folder for folder in expanded(result).glob(f"{_NAME}*") if folder.is_dir()]


def load_alternatives(result: str | Path, match: Match) -> list[Match]:
    """The matches of other ways round that ``homolog match --alternatives`` wrote, the likeliest first.

    Args:
        result: the folder of the result.
        match: of that folder, whose shapes they share.

    Raises:
        DataError: if a file of one is missing or damaged, or it is not of these shapes.
        ShapeError: if a shape cannot be read.

    Examples:
        >>> import homolog
        >>> from homolog.matching import load_alternatives
        >>> match = homolog.match(*homolog.demo_shapes(), method="axiomatic")
        >>> paths = match.save("result"), match.save("result/alternative-2")
        >>> len(load_alternatives("result", match))
        1
    """
    found = list[Match]()
    for number in count(FIRST_ALTERNATIVE):
        folder = alternative_folder(result, number)
        if not expanded(folder).is_dir():
            return found
        other = Match.load(folder)
        if any(getattr(other, side).n_points != getattr(match, side).n_points for side in ("source", "target")):
            raise DataError(f"{folder} holds a match of other shapes than {result}; match again, or remove {folder}")
        found.append(other)
    return found
