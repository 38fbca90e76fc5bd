"""Landmarks in a match: they become features before maps are made, and the maps meet them in the end. New here."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor

from homolog.geometry.deformation import DeformedTemplate
from homolog.matching.deformable import DeformableShape, Deformation, HeldLandmarks
from homolog.matching.result import Match
from homolog.pairs import SIDES, GuidanceSettings, Pair, PointMaps


def guided(pair: Pair) -> Pair:
    """The pair with its landmarks as features of both shapes, beside those that there are; as it is without any."""
    if pair.guidance is None:
        return pair
    of_x, of_y = pair.guidance.channels(
        pair.x.operators, pair.y.operators, pair.settings.guidance.channels, partial=pair.is_partial
    )
    x, y = replace(pair.x, channels=of_x), replace(pair.y, channels=of_y)
    source, target = (x, y) if pair.x is pair.source else (y, x)
    return replace(pair, source=source, target=target)


@torch.no_grad()
def meet_landmarks(pair: Pair, maps: PointMaps) -> PointMaps:
    """Point maps that meet the landmarks, each to its uncertainty, without a tear; as they are without any.

    Each shape is deformed onto the other, as rigidly as may be, along both point maps and the landmarks. What a
    landmark then misses is pulled there with its surroundings, and every point goes to the nearest one: the nearest in
    place and normal together, as bodies of other proportions come to lie across each other. Of a method whose maps
    are smooth, such as ``registration``, there is the pull alone, unless they miss the landmarks by far.

    Args:
        pair: with landmarks or without.
        maps: between its repaired shapes.
    """
    held = HeldLandmarks.of(pair)
    if held is None:
        return maps
    meeting = _Meeting(pair, held, *DeformableShape.of(pair))
    if not pair.method.supports.refinement and meeting.missed(maps) < pair.settings.guidance.trusted:
        return meeting.moved(maps)
    return meeting.deformed(maps)


def landmark_misfit(pair: Pair, match: Match) -> float:
    """How far the maps of a match miss the landmarks, on average over both ways, in units of sqrt(area); 0 without any.

    What has no counterpart does not count.
    """
    if pair.guidance is None:
        return 0.0
    at = {"source": pair.guidance.x, "target": pair.guidance.y}
    if pair.x is pair.target:
        at = {"source": at["target"], "target": at["source"]}
    ends = {side: getattr(pair, side).repaired.kept[at[side].cpu().numpy()] for side in SIDES}
    both = (
        (match.target, match.source_to_target[ends["source"]], ends["target"], pair.target.operators.scale),
        (match.source, match.target_to_source[ends["target"]], ends["source"], pair.source.operators.scale),
    )
    misses = [
        np.linalg.norm(shape.points[reached[reached >= 0]] - shape.points[wanted[reached >= 0]], axis=1) / scale
        for shape, reached, wanted, scale in both
    ]
    return float(np.concatenate(misses).mean()) if sum(map(len, misses)) else 0.0


def guidance_report(pair: Pair) -> dict[str, Any] | None:
    """The landmarks that were used, and those that were left out, for JSON."""
    if pair.guidance is None:
        return None
    return {"used": list(pair.guidance.names), "left_out": list(pair.guidance.left_out)}


def guidance_warnings(pair: Pair) -> tuple[str, ...]:
    """Say which landmarks are left out."""
    if pair.guidance is None or not pair.guidance.left_out:
        return ()
    names = ", ".join(repr(name) for name in pair.guidance.left_out)
    return (
        f"the landmarks {names} are left out, as one of the shapes lacks them, or has them at points that are not "
        f"matched; {len(pair.guidance)} pairs guide the match",
    )


@dataclass(frozen=True, eq=False)
class _Meeting:
    """Two shapes on their way to maps that meet the landmarks."""

    pair: Pair
    held: HeldLandmarks
    x: DeformableShape
    y: DeformableShape

    @property
    def settings(self) -> GuidanceSettings:
        return self.held.settings

    def missed(self, maps: PointMaps) -> float:
        """How far point maps miss the landmarks on average, in units of sqrt(area)."""
        (x, at_x), (y, at_y) = ((each.shape.operators.points, each.at) for each in (self.x, self.y))
        there, back = x[maps.y_to_x[at_y]] - x[at_x], y[maps.x_to_y[at_x]] - y[at_y]
        return float(torch.cat([there, back]).norm(dim=1).mean())

    def moved(self, maps: PointMaps) -> PointMaps:
        """The maps with what they miss made up for around the landmarks, and as they are elsewhere."""
        return PointMaps(self._moved(self.x, self.y, maps.x_to_y), self._moved(self.y, self.x, maps.y_to_x))

    def deformed(self, maps: PointMaps) -> PointMaps:
        """The maps once the shapes are deformed onto each other along them; a part alone is deformed onto its whole."""
        y_to_x, x_to_y = self._led(self.y, self.x, maps.y_to_x, maps.x_to_y)
        if not self.pair.is_partial:
            x_to_y, _ = self._led(self.x, self.y, maps.x_to_y, maps.y_to_x)
        return PointMaps(x_to_y, y_to_x)

    def _moved(self, one: DeformableShape, other: DeformableShape, there: Int[Tensor, " n"]) -> Int[Tensor, " n"]:
        points = other.projector.shape.points
        positions = self.held.pulled(points[there.cpu().numpy()], one, other)
        return torch.from_numpy(self.held.met(other.nearest(positions, points), one, other)).to(there.device)

    def _led(
        self, one: DeformableShape, other: DeformableShape, there: Int[Tensor, " n"], back: Int[Tensor, " m"]
    ) -> tuple[Int[Tensor, " n"], Int[Tensor, " m"]]:
        settings, template = self.settings, DeformedTemplate(one.projector, other.projector)
        deformation = Deformation(one, other, both=not self.pair.is_partial, held=self.held, template=template)
        normals = self.held.normals(settings.normals)
        weight, stiffness = settings.points, settings.stiffness
        return deformation.led(there, back, weight=weight, stiffness=stiffness, normals=normals)[:2]
