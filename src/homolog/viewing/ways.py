"""Several maps between two shapes, as ``homolog match --alternatives`` makes them, in one scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from homolog.geometry import some_points
from homolog.maps import handedness, rotation_angle
from homolog.matching import FIRST_ALTERNATIVE, Match, alternative_folder
from homolog.pairs import SIDES
from homolog.viewing.guiding import guide_of
from homolog.viewing.layers import Layer
from homolog.viewing.scene import Scene, scene_of

_SAMPLES = 500
# Root mean square distances of a shape's points from their mean, in the unit of ``handedness``: its neighbourhoods then
# are as large as on a body of unit area.
_SPREAD = 0.4
# Maps that keep left and right have about 0.4 to 1, those that exchange them about -1.
_EXCHANGED = -0.5


def scene_of_all(matches: Sequence[Match], layers: Sequence[Sequence[Layer]] = ()) -> Scene:
    """The scene of the first of several matches of two shapes, with the others to choose from.

    Args:
        matches: the likeliest first, at least one.
        layers: further ones of each match.
    """
    scenes = [scene_of(match, layers[number] if layers else ()) for number, match in enumerate(matches)]
    if len(matches) == 1:
        return scenes[0]
    named = [replace(scene, name=_name(matches, i), note=_note(matches, i)) for i, scene in enumerate(scenes)]
    return replace(named[0], guide=guide_of(matches[0], alternatives=len(matches)), alternatives=tuple(named[1:]))


def exchanges_sides(match: Match) -> bool:
    """Whether a map exchanges left and right: it turns the neighbourhoods of points inside out.

    Where the options say that one of the shapes is a mirror image, that is what the right map does.

    Examples:
        >>> import numpy as np
        >>> from homolog import Match, Shape
        >>> from homolog.viewing import exchanges_sides
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


def _name(matches: Sequence[Match], place: int) -> str:
    """In a few words for a menu: the number, what the map exchanges, and by how much the source is turned more."""
    words = [] if place else ["the likeliest"]
    if exchanges_sides(matches[place]):
        words.append("left and right exchanged")
    turn, first = _turn(matches[place]), _turn(matches[0])
    if place and turn is not None and first is not None:
        degrees = float(rotation_angle(torch.from_numpy(turn @ first.T)))
        words.append(f"turned by {degrees:.0f}\N{DEGREE SIGN}")
    return f"{place + 1}: {', '.join(words) or 'another way round'}"


def _note(matches: Sequence[Match], place: int) -> str:
    """A sentence or two on the scores of a map, and where it lies."""
    match = matches[place]
    trust = (match.source_confidence.mean() + match.target_confidence.mean()) / 2
    told, misfit = f"mean confidence {trust:.2f}", _orientation(match).get("misfit")
    if misfit is not None:
        told = f"misfit {misfit:.3f}, {told}"
    if match.quality is not None:
        told += f", cycle error {match.quality.mean.cycle_error:.3f}"
    told = told[0].upper() + told[1:]
    if not place:
        return f"{told}."
    folder = alternative_folder("", place + FIRST_ALTERNATIVE - 1).name
    return f"{told}. Its files are in the result\N{RIGHT SINGLE QUOTATION MARK}s folder {folder}."


def _orientation(match: Match) -> dict[str, Any]:
    return dict(match.report.get("orientation") or {})


def _turn(match: Match) -> Float[np.ndarray, "3 3"] | None:
    """By what the source is turned against the target, where that was looked for."""
    found = _orientation(match)
    if not all(side in found for side in SIDES):
        return None
    source, target = (np.asarray(found[side]["rotation"]) for side in SIDES)
    return np.asarray(target.T @ source, dtype=np.float64)
