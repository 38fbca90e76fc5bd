"""The maps of other ways round: in folders within the folder of a result, and what tells one from another."""

from __future__ import annotations

from itertools import count
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from homolog.core.errors import DataError
from homolog.core.files import expanded
from homolog.geometry import some_points
from homolog.maps import handedness, rotation_angle
from homolog.matching.result import Match
from homolog.pairs import SIDES

_NAME = "alternative-"
FIRST_ALTERNATIVE = 2
"""The number of the first of them: the result itself is number 1."""

_SAMPLES = 500
# Root mean square distances of a shape's points from their mean, in the unit of ``handedness``: its neighbourhoods then
# are as large as on a body of unit area.
_SPREAD = 0.4
# Maps that keep left and right have about 0.4 to 1, those that exchange them about -1.
_EXCHANGED = -0.5


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
        if any(getattr(other, side).n_points != getattr(match, side).n_points for side in SIDES):
            raise DataError(f"{folder} holds a match of other shapes than {result}; match again, or remove {folder}")
        found.append(other)
    return found


def exchanges_sides(match: Match) -> bool:
    """Whether a map exchanges left and right: it turns the neighbourhoods of points inside out.

    Where the options say that one of the shapes is a mirror image, that is what the right map does.

    Examples:
        >>> import numpy as np
        >>> from homolog import Match, Shape
        >>> from homolog.matching import exchanges_sides
        >>> left = np.random.default_rng(0).normal(size=(200, 3)) + [3, 0, 0]
        >>> shape = Shape(np.concatenate([left, left * [-1, 1, 1]]))
        >>> same, partner = np.arange(400), np.arange(400).reshape(2, 200)[::-1].ravel()
        >>> [exchanges_sides(Match(shape, shape, there, there)) for there in (same, partner)]
        [False, True]
    """
    there = np.flatnonzero(match.source_to_target >= 0)
    if not len(there):
        return False
    points = there[some_points(len(there), _SAMPLES).numpy()]
    own, images = match.source.points[points], match.target.points[match.source_to_target[points]]
    kept = float(handedness(torch.from_numpy(_of_one_size(own)), torch.from_numpy(_of_one_size(images))))
    return (-kept if match.report.get("options", {}).get("mirror") else kept) < _EXCHANGED


def _of_one_size(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    centred = points - points.mean(axis=0)
    spread = float(np.sqrt((centred**2).sum(axis=1).mean())) or 1.0
    return np.asarray(_SPREAD / spread * centred, dtype=np.float64)


def degrees_between(match: Match, other: Match) -> float | None:
    """By how many degrees two matches turned the source differently; None where no way round was looked for."""
    turns = [_turn(match), _turn(other)]
    if turns[0] is None or turns[1] is None:
        return None
    return float(rotation_angle(torch.from_numpy(turns[1] @ turns[0].T)))


def _turn(match: Match) -> Float[np.ndarray, "3 3"] | None:
    """By what the source was turned against the target."""
    found = match.report.get("orientation") or {}
    if not all(side in found for side in SIDES):
        return None
    source, target = (np.asarray(found[side]["rotation"]) for side in SIDES)
    return np.asarray(target.T @ source, dtype=np.float64)
