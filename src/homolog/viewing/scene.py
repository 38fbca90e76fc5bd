"""Both shapes of a match side by side: where they stand, what is shown of them, what a click marks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.spatial import KDTree

from homolog.matching import Match, matched_name
from homolog.pairs import Side
from homolog.shapes import Shape, stand_upright
from homolog.viewing.colours import HIDDEN
from homolog.viewing.layers import Layer, confidence_layer, matched_layer
from homolog.viewing.picking import Hit, Ray, hit_points, hit_surface

SIDES: tuple[Side, Side] = ("source", "target")

# Shapes whose sizes differ by more are likely to be in different units, and are drawn equally large.
_COMPARABLE = 3.0
# Between the shapes' bounding boxes, in units of the scene.
_GAP = 0.25
# So many points are looked at to find out how densely they lie.
_SAMPLE = 2000


@dataclass(frozen=True, eq=False)
class Body:
    """One shape as it is drawn.

    Args:
        title: how the user calls it.
        points: upright (+y), around the middle of their bounding box, in the scene's unit (n, 3).
        faces: triangles, or None for a cloud.
        counterpart: for each point that of the other shape, -1 = none (n,).
        confidence: in each counterpart (n,).
        rank: place of each point in the order in which points appear as more of them are shown (n,).
        spacing: typical distance from a point to the nearest other one.
        offset: what is added to the points where both shapes stand in one space (3,).
    """

    title: str
    points: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"] | None
    counterpart: Int[np.ndarray, " n"]
    confidence: Float[np.ndarray, " n"]
    rank: Int[np.ndarray, " n"]
    spacing: float
    offset: Float[np.ndarray, " 3"]

    def is_surface(self, shown: Shown) -> bool:
        """Whether it is drawn as a surface."""
        return shown.surface and self.faces is not None

    def mask(self, shown: Shown) -> Bool[np.ndarray, " n"]:
        """Which points are shown; the share does not count on a surface, which cannot do without some."""
        counted = np.inf if self.is_surface(shown) else np.ceil(shown.share * len(self.points))
        return (self.confidence >= shown.least_confidence) & (self.rank < counted)

    def hit(self, ray: Ray, shown: Shown) -> Hit | None:
        """What a ray in the body's own coordinates meets."""
        surface = None if self.faces is None else hit_surface(self.points, self.faces, ray)
        if self.is_surface(shown):
            return surface
        before = np.inf if surface is None else surface.depth
        return hit_points(self.points, self.mask(shown), ray, self.spacing, before=before)


@dataclass(frozen=True)
class Shown:
    """Which points are shown, and how.

    Args:
        least_confidence: points below it are left out, or pale on a surface.
        share: how many of the points are drawn, from 0 to 1.
        surface: draw meshes as surfaces, else as points on a pale one.
    """

    least_confidence: float = 0.0
    share: float = 1.0
    surface: bool = True


@dataclass(frozen=True)
class Mark:
    """A point that was clicked.

    Args:
        side: of which shape.
        point: which.
        counterpart: the point of the other shape that it was matched to; None if it has none.
        confidence: in that match.
        back: the point of its own shape that the counterpart was matched to, if any.
        values: what the layers with numbers say of it, by their names.
    """

    side: Side
    point: int
    counterpart: int | None
    confidence: float
    back: int | None
    values: dict[str, float]


@dataclass(frozen=True, eq=False)
class Scene:
    """All that a view of a match shows.

    The unit is the radius of the larger shape's bounding sphere around its box's middle.

    Args:
        bodies: both shapes.
        layers: colours to choose from, the first to begin with.
        route: how they were matched.
    """

    bodies: dict[Side, Body]
    layers: tuple[Layer, ...]
    route: str

    @property
    def title(self) -> str:
        """What both shapes are called."""
        return " \N{RIGHTWARDS ARROW} ".join(self.bodies[side].title for side in SIDES)

    def layer(self, name: str) -> Layer:
        """The layer of a name."""
        return next(layer for layer in self.layers if layer.name == name)

    def colours(self, layer: Layer, side: Side, shown: Shown) -> UInt8[np.ndarray, "n 3"]:
        """Colours of a shape's points; pale where they are not shown."""
        mask = self.bodies[side].mask(shown)
        return np.where(mask[:, None], layer.colours[side], np.array(HIDDEN, dtype=np.uint8))

    def pick(self, ray: Ray, shown: Shown) -> Mark | None:
        """What a ray meets first, in the space in which both shapes stand side by side."""
        met: list[tuple[float, Side, int]] = []
        for side, body in self.bodies.items():
            hit = body.hit(replace(ray, origin=ray.origin - body.offset), shown)
            if hit is not None:
                met.append((hit.depth, side, hit.point))
        return self.mark(*min(met)[1:]) if met else None

    def mark(self, side: Side, point: int) -> Mark:
        """A point with its counterpart."""
        body, other = self.bodies[side], self.bodies[_other(side)]
        counterpart = _index(body.counterpart[point])
        back = None if counterpart is None else _index(other.counterpart[counterpart])
        values = {layer.name: float(layer.values[side][point]) for layer in self.layers if layer.values is not None}
        return Mark(side, point, counterpart, float(body.confidence[point]), back, values)

    def places(self, mark: Mark) -> dict[Side, Float[np.ndarray, " 3"]]:
        """Where the marked point and its counterpart are, in the space in which both shapes stand side by side."""
        points = {mark.side: mark.point, _other(mark.side): mark.counterpart}
        return {
            side: self.bodies[side].points[point] + self.bodies[side].offset
            for side, point in points.items()
            if point is not None
        }

    def told(self, mark: Mark) -> list[tuple[str, str]]:
        """What is known of a mark, as names and texts for a table."""
        points = {mark.side: mark.point, _other(mark.side): mark.counterpart}
        rows: list[tuple[str, str]] = [(side, _point_text(points[side])) for side in SIDES]
        if mark.counterpart is None:
            return rows
        rows.append(("and back", "the same point" if mark.back == mark.point else _point_text(mark.back)))
        for name, value in mark.values.items():
            unit = (ramp := self.layer(name).ramp) and ramp.unit
            rows.append((name.lower(), f"{value:.2f} {unit}".strip() if np.isfinite(value) else "not known"))
        return rows


def _other(side: Side) -> Side:
    return SIDES[1 - SIDES.index(side)]


def _point_text(point: int | None) -> str:
    return "no counterpart" if point is None else f"point {point}"


def _index(entry: np.integer[Any]) -> int | None:
    return int(entry) if entry >= 0 else None


def scene_of(result: Match, layers: Sequence[Layer] = ()) -> Scene:
    """Lay out a result: shapes upright and side by side, coloured by the match and by its confidence.

    A part keeps its size beside its whole. Other shapes do, too, unless one is more than three times as large.

    Args:
        result: what ``read_result`` gave.
        layers: further ones to choose from.
    """
    options = result.report.get("options", {})
    upright = {side: _upright(getattr(result, side), options, side) for side in SIDES}
    centred = {side: points - _middle(points) for side, points in upright.items()}
    radii = {side: float(np.linalg.norm(points, axis=1).max()) or 1.0 for side, points in centred.items()}
    scales = _scales(radii, options)
    placed = {side: centred[side] * scales[side] for side in SIDES}
    bodies = {side: _body(result, side, placed) for side in SIDES}
    return Scene(bodies, (matched_layer(result), confidence_layer(result), *layers), result.method)


def _upright(shape: Shape, options: dict[str, Any], side: Side) -> Float[np.ndarray, "n 3"]:
    return stand_upright(shape, options.get(f"{side}_up", "y")).points


def _middle(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " 3"]:
    middle: np.ndarray = (points.min(axis=0) + points.max(axis=0)) / 2
    return middle


def _scales(radii: dict[Side, float], options: dict[str, Any]) -> dict[Side, float]:
    """What each shape's lengths are multiplied by."""
    scales: dict[Side, float] = dict.fromkeys(SIDES, 1.0)
    part = options.get("partial")
    if part is not None:
        scales[part] = options.get("partial_scale", 1.0)
    elif max(radii.values()) > _COMPARABLE * min(radii.values()):
        scales = {side: 1 / radius for side, radius in radii.items()}
    largest = max(radii[side] * scales[side] for side in SIDES)
    return {side: scale / largest for side, scale in scales.items()}


def _body(result: Match, side: Side, placed: dict[Side, Float[np.ndarray, "n 3"]]) -> Body:
    shape, found, points = getattr(result, side), result, placed[side]
    apart = (sum(np.ptp(points[:, 0]) for points in placed.values()) / 2 + _GAP) / 2
    return Body(
        title=matched_name(result.report, side, otherwise=shape.name),
        points=points,
        faces=shape.faces,
        counterpart=found.source_to_target if side == "source" else found.target_to_source,
        confidence=found.source_confidence if side == "source" else found.target_confidence,
        rank=np.random.default_rng(0).permutation(len(points)),
        spacing=_spacing(points),
        offset=np.array([-apart if side == "source" else apart, 0.0, 0.0]),
    )


def _spacing(points: Float[np.ndarray, "n 3"]) -> float:
    sample = points[:: max(1, len(points) // _SAMPLE)]
    distances = KDTree(points).query(sample, k=2)[0][:, 1]
    return float(np.median(distances))
