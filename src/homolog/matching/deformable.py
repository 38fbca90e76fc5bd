"""The shapes of a pair, as one is deformed onto the other along point maps, and held by landmarks. New here."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from homolog.geometry import distances_from
from homolog.geometry.deformation import DeformedTemplate, WeightedPairs
from homolog.geometry.projection import SurfaceProjector
from homolog.maps import ConfidenceSettings, confidence, neighbourhoods
from homolog.pairs import Guidance, GuidanceSettings, Pair, PreprocessedShape

# A pair of points that is not trusted at all still counts this much.
_LEAST_CONFIDENCE = 0.01
# Landmarks that are nearer to each other than they reach would have to undo each other's pull exactly.
_RIDGE = 1e-3


@dataclass(frozen=True, eq=False)
class DeformableShape:
    """A shape that is deformed, or onto which another one is.

    Args:
        shape: preprocessed.
        settings: of the confidence in its maps.
        landmarks: its points that are known to correspond (p,).
    """

    shape: PreprocessedShape
    settings: ConfidenceSettings
    landmarks: Int[Tensor, " p"] | None = None

    @classmethod
    def of(cls, pair: Pair) -> tuple[DeformableShape, DeformableShape]:
        """The two of a pair, x and y."""
        at = (None, None) if pair.guidance is None else (pair.guidance.x, pair.guidance.y)
        x, y = (cls(shape, pair.settings.confidence, each) for shape, each in zip((pair.x, pair.y), at, strict=True))
        return x, y

    @cached_property
    def projector(self) -> SurfaceProjector:
        """Its repaired points and surface."""
        return SurfaceProjector(self.shape.repaired.shape)

    @cached_property
    def main(self) -> Int[np.ndarray, " m"]:
        """The points that others are mapped to."""
        return np.flatnonzero(self.shape.operators.in_main_component.cpu().numpy())

    @cached_property
    def normals(self) -> Float[np.ndarray, "n 3"] | None:
        """Of the points of a mesh."""
        surface = self.projector.surface
        return None if surface is None else surface.vertex_normals

    @cached_property
    def at(self) -> Int[np.ndarray, " p"]:
        """Its landmarks."""
        assert self.landmarks is not None
        return np.asarray(self.landmarks.cpu().numpy())

    @cached_property
    def distances(self) -> Float[np.ndarray, "n p"]:
        """Of all points from the landmarks, along the surface."""
        assert self.landmarks is not None
        return np.asarray(distances_from(self.shape.operators, self.landmarks).cpu().double().numpy())

    def trust(
        self, other: DeformableShape, there: Int[Tensor, " n"], back: Int[Tensor, " m"]
    ) -> Float[np.ndarray, " n"]:
        """The confidence in each entry of its map to another shape."""
        points = self.shape.operators.points, other.shape.operators.points
        found = confidence(*points, there, back, settings=self.settings, near=self._near)
        return np.asarray(found.cpu().numpy())

    @cached_property
    def _near(self) -> Int[Tensor, "n j"]:
        return neighbourhoods(self.shape.operators.points, self.settings.n_neighbours)

    def pairs_with(
        self,
        other: DeformableShape,
        there: Int[Tensor, " n"],
        back: Int[Tensor, " m"],
        *,
        weight: float,
        both: bool = True,
    ) -> WeightedPairs:
        """The pairs of two point maps by their confidence; each map has a total weight of at most ``weight``.

        Args:
            other: the shape that this one is deformed onto.
            there: for each of its points one of the other's (n,).
            back: the way back (m,).
            weight: of all pairs of a map, where the surface that pulls beside them has one.
            both: those of the way back, too, which a part of the other has for some of its points alone.
        """
        target, to = other.projector.shape.points, there.cpu().numpy()
        found = [(np.arange(len(to)), target[to], self.trust(other, there, back))]
        if both:
            found.append((back.cpu().numpy(), target, other.trust(self, back, there)))
        points, positions, trusts = zip(*found, strict=True)
        weights = [weight * trust.clip(_LEAST_CONFIDENCE) / len(trust) for trust in trusts]
        return WeightedPairs(np.concatenate(points), np.concatenate(positions), np.concatenate(weights))

    def beside(
        self, other: DeformableShape, positions: Float[np.ndarray, "n 3"], *, side: int, normals: float
    ) -> tuple[Float[np.ndarray, "n e"], Float[np.ndarray, "m e"]]:
        """Its points where they lie on the other, and those of the other, as embeddings by place and normal.

        Args:
            other: the shape that it was deformed onto.
            positions: where its points then lie, in the other's coordinates (n, 3).
            side: the relative orientation of both meshes; 0 where it is unknown, so that places alone are compared.
            normals: distance, in units of sqrt(area), that weighs as much as a difference of one in unit normals.
        """
        target, unit = other.projector.shape.points, other.shape.operators.scale
        middle = target.mean(axis=0)
        own, others = [(positions - middle) / unit], [(target - middle) / unit]
        if side and normals and self.projector.surface is not None and other.normals is not None:
            own.append(normals * side * replace(self.projector.surface, vertices=positions).vertex_normals)
            others.append(normals * other.normals)
        return np.concatenate(own, axis=1), np.concatenate(others, axis=1)

    def nearest(self, points: Float[np.ndarray, "m e"], own: Float[np.ndarray, "n e"]) -> Int[np.ndarray, " m"]:
        """For each point of another shape the nearest of its own, by embeddings of both."""
        found: np.ndarray = self.main[KDTree(own[self.main]).query(points)[1]]
        return found


@dataclass(frozen=True, eq=False)
class HeldLandmarks:
    """What landmarks make of a deformation of one shape onto the other.

    Args:
        guidance: the landmarks of both.
        settings: how they are met.
    """

    guidance: Guidance
    settings: GuidanceSettings

    @classmethod
    def of(cls, pair: Pair) -> HeldLandmarks | None:
        """Those of a pair that has any."""
        return None if pair.guidance is None else cls(pair.guidance, pair.settings.guidance)

    @cached_property
    def uncertainties(self) -> Float[np.ndarray, " p"]:
        """In units of sqrt(area)."""
        return np.asarray(self.guidance.uncertainties.cpu().double().numpy())

    def normals(self, usual: float) -> float:
        """What normals weigh in the end: nothing where a landmark is uncertain, which is missed by place alone."""
        return 0.0 if self.uncertainties.any() else usual

    def among(self, pairs: WeightedPairs, one: DeformableShape, other: DeformableShape) -> WeightedPairs:
        """The pairs of point maps, and behind them the landmarks, which are certain."""
        weights = self.settings.pull * self.guidance.weights.cpu().double().numpy()
        return WeightedPairs(
            np.concatenate([pairs.points, one.at]),
            np.concatenate([pairs.positions, other.projector.shape.points[other.at]]),
            np.concatenate([pairs.weights, weights]),
            n_certain=len(one.at),
        )

    def pulled(
        self, positions: Float[np.ndarray, "n 3"], one: DeformableShape, other: DeformableShape
    ) -> Float[np.ndarray, "n 3"]:
        """Positions of one shape on the other, with what landmarks still miss made up for, and their surroundings."""
        missed = other.projector.shape.points[other.at] - positions[one.at]
        lengths = np.linalg.norm(missed, axis=1)
        allowed = self.uncertainties * other.shape.operators.scale
        share = np.where(lengths > allowed, 1 - allowed / np.maximum(lengths, np.finfo(float).tiny), 0.0)
        reaching = np.exp(-0.5 * (one.distances / self.settings.reach) ** 2)
        among = reaching[one.at] + _RIDGE * np.eye(len(one.at))
        found: np.ndarray = positions + reaching @ np.linalg.solve(among, share[:, None] * missed)
        return found

    def met(self, found: Int[np.ndarray, " n"], one: DeformableShape, other: DeformableShape) -> Int[np.ndarray, " n"]:
        """The map with landmarks that are certain at exactly their points."""
        certain = self.uncertainties == 0
        found[one.at[certain]] = other.at[certain]
        return found


@dataclass(frozen=True, eq=False)
class Deformation:
    """One shape of a pair that is deformed onto the other along point maps, as often as is asked.

    Args:
        one: the shape that is deformed; of a part and its whole the part.
        other: the shape that it is deformed onto.
        both: whether the map back pulls as well, which a part of the other has for some of its points alone.
        held: landmarks that it is held by, if there are any.
        template: the first shape on its way onto the other.
    """

    one: DeformableShape
    other: DeformableShape
    both: bool
    held: HeldLandmarks | None
    template: DeformedTemplate

    def led(
        self,
        there: Int[Tensor, " n"],
        back: Int[Tensor, " m"],
        *,
        weight: float,
        stiffness: float,
        normals: float,
        side: int = 0,
    ) -> tuple[Int[Tensor, " n"], Int[Tensor, " m"], int]:
        """Both maps once the shape is deformed along them, and the relative orientation of both meshes.

        Args:
            there: for each of its points one of the other's (n,).
            back: the way back (m,).
            weight: of all pairs of a map.
            stiffness: in spacings of its points.
            normals: see ``DeformableShape.beside``.
            side: the relative orientation, found where it is 0.
        """
        one, other, held = self.one, self.other, self.held
        pairs = one.pairs_with(other, there, back, weight=weight, both=self.both)
        pairs = pairs if held is None else held.among(pairs, one, other)
        side, positions = self.template.solve(pairs, stiffness=stiffness, orientation=side)
        positions = positions if held is None else held.pulled(positions, one, other)
        on_other, of_other = one.beside(other, positions, side=side, normals=normals)
        led, led_back = other.nearest(on_other, of_other), one.nearest(of_other, on_other)
        if held is not None:
            led, led_back = held.met(led, one, other), held.met(led_back, other, one)
        return torch.from_numpy(led).to(there.device), torch.from_numpy(led_back).to(there.device), side
