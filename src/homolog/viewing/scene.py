"""Both shapes of a match as they are drawn: upright, centred, in one unit, with their counterparts and colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from homolog.matching import Match, matched_name
from homolog.pairs import SIDES, Side
from homolog.shapes import stand_upright, upright_rotation
from homolog.viewing.guiding import Guide, guide_of
from homolog.viewing.layers import Layer, confidence_layer, matched_layer

# Shapes whose sizes differ by more are likely to be in different units, and are drawn equally large.
_COMPARABLE = 3.0
# So many points are looked at to find out how densely they lie.
_SAMPLE = 2000


@dataclass(frozen=True, eq=False)
class Body:
    """One shape as it is drawn.

    Args:
        title: the name of its file.
        points: upright (+y), around the middle of their bounding box, in the scene's unit (n, 3).
        faces: triangles, or None for a cloud.
        counterpart: for each point that of the other shape, -1 = none (n,).
        confidence: in each counterpart (n,).
        spacing: typical distance from a point to the nearest other one.
        to_file: takes a place and a one behind it, as a row, to the coordinates of the file (4, 3).
    """

    title: str
    points: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"] | None
    counterpart: Int[np.ndarray, " n"]
    confidence: Float[np.ndarray, " n"]
    spacing: float
    to_file: Float[np.ndarray, "4 3"]


@dataclass(frozen=True, eq=False)
class Scene:
    """A match as it is drawn, by ``page_of`` and ``picture_of``.

    The unit is the radius of the larger shape's bounding sphere around its box's middle.

    Args:
        bodies: both shapes.
        layers: colours to choose from, the first to begin with.
        method: how they were matched.
        guide: for landmarks that are set on the page; None where it is not to offer that.
        name: of the map, among several.
        note: a sentence on it.
        alternatives: the scenes of other maps between the same shapes, with as many layers each.
    """

    bodies: dict[Side, Body]
    layers: tuple[Layer, ...]
    method: str
    guide: Guide | None = None
    name: str = ""
    note: str = ""
    alternatives: tuple[Scene, ...] = ()

    @property
    def title(self) -> str:
        """The names of both files."""
        return " \N{RIGHTWARDS ARROW} ".join(self.bodies[side].title for side in SIDES)


def scene_of(result: Match, layers: Sequence[Layer] = ()) -> Scene:
    """Lay out a match to be drawn, coloured by correspondence and by confidence.

    Shapes keep their sizes, a partial one beside the other too, unless they differ by a factor of more than three.

    Args:
        result: the match.
        layers: further ones to choose from.

    Examples:
        >>> import homolog
        >>> from homolog.viewing import scene_of, write_page
        >>> scene = scene_of(homolog.match(*homolog.demo_shapes(), method="axiomatic"))
        >>> write_page("result.html", scene)
    """
    options = result.report.get("options", {})
    turns = {side: upright_rotation(options.get(f"{side}_up", "y")) for side in SIDES}
    upright = {side: stand_upright(getattr(result, side), options.get(f"{side}_up", "y")).points for side in SIDES}
    middles = {side: (points.min(axis=0) + points.max(axis=0)) / 2 for side, points in upright.items()}
    centred = {side: points - middles[side] for side, points in upright.items()}
    radii = {side: float(np.linalg.norm(points, axis=1).max()) or 1.0 for side, points in centred.items()}
    scales = _scales(radii, options)
    bodies = {
        side: _body(
            result,
            side,
            centred[side] * scales[side],
            to_file=np.vstack([turns[side] / scales[side], middles[side] @ turns[side]]),
        )
        for side in SIDES
    }
    layers = (matched_layer(result), confidence_layer(result), *layers)
    return Scene(bodies, layers, result.method, guide_of(result))


def _scales(radii: dict[Side, float], options: dict[str, Any]) -> dict[Side, float]:
    """What each shape's coordinates are multiplied by."""
    scales: dict[Side, float] = dict.fromkeys(SIDES, 1.0)
    partial = options.get("partial")
    if partial is not None:
        scales["target" if partial == "both" else partial] = options.get("partial_scale", 1.0)
    elif max(radii.values()) > _COMPARABLE * min(radii.values()):
        scales = {side: 1 / radius for side, radius in radii.items()}
    largest = max(radii[side] * scales[side] for side in SIDES)
    return {side: scale / largest for side, scale in scales.items()}


def _body(result: Match, side: Side, points: Float[np.ndarray, "n 3"], *, to_file: Float[np.ndarray, "4 3"]) -> Body:
    shape, found = getattr(result, side), result
    return Body(
        title=matched_name(result.report, side, otherwise=shape.name),
        points=points,
        faces=shape.faces,
        counterpart=found.source_to_target if side == "source" else found.target_to_source,
        confidence=found.source_confidence if side == "source" else found.target_confidence,
        spacing=typical_spacing(points),
        to_file=to_file,
    )


def typical_spacing(points: Float[np.ndarray, "n 3"], *, neighbour: int = 1) -> float:
    """The median distance from a point to its nearest other one, or a farther one, estimated from some 2,000 points."""
    sample = points[:: max(1, len(points) // _SAMPLE)]
    return float(np.median(KDTree(points).query(sample, k=neighbour + 1)[0][:, -1]))
