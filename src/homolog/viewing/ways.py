"""Several maps between two shapes, as ``homolog match --alternatives`` makes them, in one scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from homolog.matching import FIRST_ALTERNATIVE, Match, alternative_folder, degrees_between, exchanges_sides
from homolog.viewing.guiding import guide_of
from homolog.viewing.layers import Layer
from homolog.viewing.scene import Scene, scene_of


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


def _name(matches: Sequence[Match], place: int) -> str:
    """In a few words for a menu: the number, what the map exchanges, and by how much the source is turned more."""
    words = [] if place else ["the likeliest"]
    if exchanges_sides(matches[place]):
        words.append("left and right exchanged")
    turned = degrees_between(matches[0], matches[place])
    if place and turned is not None:
        words.append(f"turned by {turned:.0f}\N{DEGREE SIGN}")
    return f"{place + 1}: {', '.join(words) or 'another way round'}"


def _note(matches: Sequence[Match], place: int) -> str:
    """A sentence or two on the scores of a map, and where it lies."""
    match = matches[place]
    trust = (match.source_confidence.mean() + match.target_confidence.mean()) / 2
    told, misfit = f"mean confidence {trust:.2f}", (match.report.get("orientation") or {}).get("misfit")
    if misfit is not None:
        told = f"misfit {misfit:.3f}, {told}"
    if match.quality is not None:
        told += f", cycle error {match.quality.mean.cycle_error:.3f}"
    told = told[0].upper() + told[1:]
    if not place:
        return f"{told}."
    folder = alternative_folder("", place + FIRST_ALTERNATIVE - 1).name
    return f"{told}. Its files are in the result\N{RIGHT SINGLE QUOTATION MARK}s folder {folder}."
