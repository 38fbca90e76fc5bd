"""Landmarks in a match: they become features before maps are made, and the maps meet them in the end. New here."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from homolog.geometry import distances_from
from homolog.geometry.deformation import DeformedTemplate, WeightedPairs
from homolog.matching.result import Match
from homolog.matching.smoothing import DeformableShape
from homolog.pairs import SIDES, GuidanceSettings, Pair, PointMaps

# Landmarks that are nearer to each other than they reach would have to undo each other's pull exactly.
_RIDGE = 1e-3


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
    if pair.guidance is None:
        return maps
    x, y = (
        _Surface(shape, pair.settings.confidence, at)
        for shape, at in ((pair.x, pair.guidance.x), (pair.y, pair.guidance.y))
    )
    meeting = _Meeting(pair, x, y)
    if not pair.method.supports.refinement and meeting.missed(maps) < pair.settings.guidance.trusted:
        return meeting.moved(maps)
    for _ in range(pair.settings.guidance.rounds - 1):
        maps = meeting.deformed(maps)
    # By how much a landmark is missed is a matter of places alone.
    return replace(meeting, by_place=bool(meeting.uncertainties.any())).deformed(maps)


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
class _Surface(DeformableShape):
    """A shape with landmarks."""

    landmarks: Int[Tensor, " p"]

    @cached_property
    def at(self) -> Int[np.ndarray, " p"]:
        return self.landmarks.cpu().numpy()

    @cached_property
    def tree(self) -> KDTree:
        return KDTree(self.projector.shape.points[self.main])

    @cached_property
    def distances(self) -> Float[np.ndarray, "n p"]:
        """Of all points from the landmarks, along the surface."""
        return distances_from(self.shape.operators, self.landmarks).cpu().double().numpy()


@dataclass(frozen=True, eq=False)
class _Meeting:
    """Two shapes on their way to maps that meet the landmarks."""

    pair: Pair
    x: _Surface
    y: _Surface
    by_place: bool = False

    @property
    def settings(self) -> GuidanceSettings:
        return self.pair.settings.guidance

    @cached_property
    def weights(self) -> Float[np.ndarray, " p"]:
        assert self.pair.guidance is not None
        return self.pair.guidance.weights.cpu().double().numpy()

    @cached_property
    def uncertainties(self) -> Float[np.ndarray, " p"]:
        assert self.pair.guidance is not None
        return self.pair.guidance.uncertainties.cpu().double().numpy()

    def missed(self, maps: PointMaps) -> float:
        """How far point maps miss the landmarks on average, in units of sqrt(area)."""
        x, y = self.x, self.y
        there = x.shape.operators.points[maps.y_to_x[y.landmarks]] - x.shape.operators.points[x.landmarks]
        back = y.shape.operators.points[maps.x_to_y[x.landmarks]] - y.shape.operators.points[y.landmarks]
        return float(torch.cat([there, back]).norm(dim=1).mean())

    def moved(self, maps: PointMaps) -> PointMaps:
        """The maps with what they miss made up for around the landmarks, and as they are elsewhere."""
        to_y, to_x = maps.x_to_y.cpu().numpy(), maps.y_to_x.cpu().numpy()
        x_on_y = self._pulled(self.y.projector.shape.points[to_y], self.x, self.y)
        y_on_x = self._pulled(self.x.projector.shape.points[to_x], self.y, self.x)
        return self._maps(self._nearest(x_on_y, self.x, self.y), self._nearest(y_on_x, self.y, self.x))

    def deformed(self, maps: PointMaps) -> PointMaps:
        """The maps once the shapes are deformed onto each other along them; a part alone is deformed onto its whole."""
        x, y = self.x, self.y
        on_x, of_x = self._onto(y, x, maps.y_to_x, None if self.pair.is_partial else maps.x_to_y)
        y_to_x = self._met(x.nearest(on_x, of_x), y, x)
        if self.pair.is_partial:
            return self._maps(self._met(y.nearest(of_x, on_x), x, y), y_to_x)
        on_y, of_y = self._onto(x, y, maps.x_to_y, maps.y_to_x)
        return self._maps(self._met(y.nearest(on_y, of_y), x, y), y_to_x)

    def _maps(self, x_to_y: Int[np.ndarray, " n_x"], y_to_x: Int[np.ndarray, " n_y"]) -> PointMaps:
        device = self.pair.x.operators.points.device
        return PointMaps(torch.from_numpy(x_to_y).to(device), torch.from_numpy(y_to_x).to(device))

    def _onto(
        self, one: _Surface, other: _Surface, there: Int[Tensor, " n"], back: Int[Tensor, " m"] | None
    ) -> tuple[Float[np.ndarray, "n e"], Float[np.ndarray, "m e"]]:
        """The points of one shape where they lie on the other, and those of the other, by all that is compared."""
        pairs = self._pairs(one, other, there, back)
        certain = WeightedPairs(
            np.concatenate([pairs.points, one.at]),
            np.concatenate([pairs.positions, other.projector.shape.points[other.at]]),
            np.concatenate([pairs.weights, self.settings.pull * self.weights]),
            n_certain=len(one.at),
        )
        template = DeformedTemplate(one.projector, other.projector)
        side, solved = template.solve(certain, stiffness=self.settings.stiffness)
        # Places alone are compared where these are to be met.
        normals = 0.0 if self.by_place else self.settings.normals
        return one.beside(other, self._pulled(solved, one, other), side=side, normals=normals)

    def _pairs(
        self, one: _Surface, other: _Surface, there: Int[Tensor, " n"], back: Int[Tensor, " m"] | None
    ) -> WeightedPairs:
        """The pairs of point maps; of a part's map alone all count alike."""
        weight = self.settings.points
        if back is not None:
            return one.pairs_with(other, there, back, weight=weight)
        to, target = there.cpu().numpy(), other.projector.shape.points
        return WeightedPairs(np.arange(len(to)), target[to], np.full(len(to), weight / len(to)))

    def _pulled(self, positions: Float[np.ndarray, "n 3"], one: _Surface, other: _Surface) -> Float[np.ndarray, "n 3"]:
        """The positions with what landmarks still miss made up for, and with their surroundings."""
        missed = other.projector.shape.points[other.at] - positions[one.at]
        lengths = np.linalg.norm(missed, axis=1)
        allowed = self.uncertainties * other.shape.operators.scale
        share = np.where(lengths > allowed, 1 - allowed / np.maximum(lengths, np.finfo(float).tiny), 0.0)
        reaching = np.exp(-0.5 * (one.distances / self.settings.reach) ** 2)
        among = reaching[one.at] + _RIDGE * np.eye(len(one.at))
        pulled: np.ndarray = positions + reaching @ np.linalg.solve(among, share[:, None] * missed)
        return pulled

    def _nearest(self, positions: Float[np.ndarray, "n 3"], one: _Surface, other: _Surface) -> Int[np.ndarray, " n"]:
        return self._met(other.main[other.tree.query(positions)[1]], one, other)

    def _met(self, found: Int[np.ndarray, " n"], one: _Surface, other: _Surface) -> Int[np.ndarray, " n"]:
        """The map with landmarks that are certain at exactly their points."""
        certain = self.uncertainties == 0
        found[one.at[certain]] = other.at[certain]
        return found
