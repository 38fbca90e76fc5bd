"""Fitting a shape model to a part of a shape: where the part lies on the model, and which shape of the model it is of.

Closest points of the model's surface take the place of what is not known of the correspondence, as in the fitting of
Gaussian process morphable models (Lüthi, Gerig, Jud, Vetter, PAMI 40, 2018); in each round the posterior of shape and
placement is exact (``homolog.statistics.placed_posterior``). The schedule and the starts are new here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from homolog.core.settings import Count, Positive, Settings
from homolog.geometry import Surface, unit
from homolog.geometry.projection import SurfacePoints
from homolog.geometry.surface import closest_weights
from homolog.maps import cube_rotations, rigid_motion, rotation_angle
from homolog.shapes import farthest_points
from homolog.statistics import Observations, PlacedPosterior, Placement, ShapeModel, placed_posterior

# Of the rigid search: points that tell where a start leads, places that the part's middle is put at, steps of closest
# points, and how many of the best are looked at by a short fit of the first modes: rounds, modes.
_FEW, _MIDDLES, _STEPS, _LOOKED_AT = 120, 12, 10, 24
_SHORT_ROUNDS, _FIRST_MODES = 14, 8
# Rounds of a fit before its shape may change.
_RIGID_ROUNDS = 6
# So many of these are fitted to the end.
_FOLLOWED = 3
_ON_MODEL = 1500
# The closest point is looked for on so many triangles, those with the nearest middles.
_TRIANGLES = 12
# Placements that differ by less, in degrees and in sizes of the model, lead to the same fit.
_SAME_DEGREES, _SAME_PLACE = 20.0, 0.2


@dataclass(frozen=True)
class ModelFitSettings(Settings):
    """How a shape model is fitted to a part.

    Args:
        scale: whether the part may have another size than the shapes of the model.
        samples: how many of the part's points are compared, spread evenly.
        independent: as how many independent points they count: what a model cannot show of a shape is alike at
            neighbouring points.
        slide: by how much less a point is known along the surface than across it, as a ratio of standard deviations.
        far: points farther than so many standard deviations count a quarter.
        rounds: of closest points, at most.
    """

    scale: bool = False
    samples: Count = 600
    independent: Count = 150
    slide: Positive = 10.0
    far: Positive = 3.0
    rounds: Count = 40


@dataclass(frozen=True, eq=False)
class ModelFit:
    """A model fitted to a part.

    Args:
        posterior: the likeliest shape and its placement on the part, and the variance around them.
        seen: the model's point below each sample of the part, with what is known of it, and the landmarks.
        distances: of the samples from the fitted surface (p,).
        misfit: what speaks against it, in squared standard deviations for each independent point.
    """

    posterior: PlacedPosterior
    seen: Observations
    distances: Float[np.ndarray, " p"]
    misfit: float


@dataclass(frozen=True, eq=False)
class PartSamples:
    """What is known of a shape.

    Args:
        points: samples of its surface (p, 3).
        normals: at the samples, on the side that the model's faces are counter-clockwise from; None where they are not
            known (p, 3).
        known: points of the model whose position on the part is given, such as landmarks.
    """

    points: Float[np.ndarray, "p 3"]
    normals: Float[np.ndarray, "p 3"] | None = None
    known: Observations | None = None

    def sampled(self, count: int) -> PartSamples:
        """Fewer samples, spread evenly."""
        some = farthest_points(self.points, min(count, len(self.points)), seed=0)
        return replace(self, points=self.points[some], normals=None if self.normals is None else self.normals[some])


class ModelFitter:
    """Fits one shape model to parts.

    Args:
        model: mean and modes.
        faces: of its surface (m, 3); None for a cloud.
        deviation: standard deviation of each coordinate of a shape around what the model can show of it.
        settings: of the fit.
    """

    def __init__(
        self,
        model: ShapeModel,
        faces: Int[np.ndarray, "m 3"] | None,
        deviation: float,
        settings: ModelFitSettings | None = None,
    ) -> None:
        self.model, self.faces, self.deviation = model, faces, deviation
        self.settings = settings or ModelFitSettings()
        self._own = np.arange(len(model.mean)) if model.kept is None else np.flatnonzero(model.kept)
        if faces is not None and model.kept is not None:  # no sample is compared with what the model was not made of
            self.faces = faces[model.kept[faces].all(axis=1)]
        self._size = float(np.sqrt(3 * model.mean.var(axis=0).mean()))

    def fits(self, part: PartSamples, starts: Sequence[Placement] = (), *, search: bool = True) -> list[ModelFit]:
        """Fits from each start that lead to different places, the best first.

        Args:
            part: what is known.
            starts: placements of the model that may be nearly right.
            search: whether to look for others, by closest points from all rotations.
        """
        likely = [*starts, *(self.likely_starts(part) if search else ())]
        kept: list[ModelFit] = []
        for fit in sorted((self.fit(part, start) for start in likely), key=lambda each: each.misfit):
            if not any(self._alike(fit.posterior.placement, other.posterior.placement) for other in kept):
                kept.append(fit)
        return kept

    def likely_starts(self, part: PartSamples) -> list[Placement]:
        """The rigid starts from which a short fit of the first modes comes nearest to the part."""
        first = self._first_modes(_FIRST_MODES)
        short = replace(self.settings, rounds=_SHORT_ROUNDS)
        some = part.sampled(_FEW)
        fitter = ModelFitter(first, self.faces, self.deviation, short)
        tried = [(fitter.fit(some, start).misfit, start) for start in self.rigid_starts(part)]
        return [start for _, start in sorted(tried, key=lambda each: each[0])[:_FOLLOWED]]

    def _first_modes(self, count: int) -> ShapeModel:
        return ShapeModel(self.model.mean, self.model.modes[:count], self.model.variances[:count], kept=self.model.kept)

    def _alike(self, one: Placement, other: Placement) -> bool:
        """Whether two placements lead to the same fit."""
        middle = self.model.mean.mean(axis=0)
        apart = float(np.linalg.norm(one(middle) - other(middle))) / self._size
        return float(rotation_angle(one.rotation @ other.rotation.T)) < _SAME_DEGREES and apart < _SAME_PLACE

    def fit(self, part: PartSamples, start: Placement) -> ModelFit:
        """The fit that rounds of closest points lead to from a placement."""
        settings, coefficients, placement = self.settings, np.zeros(0), start
        before, spread = np.full(self.model.mean.shape, np.inf), np.inf
        for number in range(settings.rounds):
            # The placement comes first, then ever more modes: all at once would bend the shape to a wrong place.
            model = self._first_modes(0 if number < _RIGID_ROUNDS else 2 ** ((number - _RIGID_ROUNDS) // 2))
            coefficients = np.pad(coefficients, (0, len(model.variances) - len(coefficients)))
            points = placement(model.shapes(coefficients[None])[0])
            places, normals, away = self._below(points, part)
            # What is far off at first may come near; what stays far off does not belong to the shape.
            spread = max(self.deviation, min(spread * 0.8, float(np.sqrt((away**2).mean()))))
            seen = self._seen(part, places, normals, away, spread)
            found = placed_posterior(model, seen, placement, coefficients=coefficients, scale=settings.scale, rounds=3)
            placement, coefficients = found.placement, found.coefficients
            moved = float(np.linalg.norm(found.points - before, axis=1).max())
            before = found.points
            is_whole = len(model.variances) == len(self.model.variances)
            if is_whole and spread == self.deviation and moved < 0.05 * self.deviation:
                break
        away = self._below(found.points, replace(part, normals=None))[2]
        far = settings.far * self.deviation
        robust = (away**2 / (1 + (away / far) ** 2)).mean() / self.deviation**2
        misfit = float(robust + (coefficients**2).sum() / settings.independent)
        return ModelFit(found, seen, away, misfit)

    def _seen(
        self,
        part: PartSamples,
        places: SurfacePoints,
        normals: Float[np.ndarray, "p 3"] | None,
        away: Float[np.ndarray, " p"],
        spread: float,
    ) -> Observations:
        """Each sample was seen at the closest point: well known across the surface, hardly along it."""
        settings, count = self.settings, len(part.points)
        trust = min(1.0, settings.independent / count) / (1 + (away / (settings.far * spread)) ** 2) ** 2
        across = np.tile(np.eye(3), (count, 1, 1))
        if normals is not None:
            along = 1 / settings.slide**2
            across = along * across + (1 - along) * normals[:, :, None] * normals[:, None, :]
        precisions = (trust / spread**2)[:, None, None] * across
        if part.known is None:
            return Observations(places, part.points, precisions)
        known, width = part.known, places.corners.shape[1]
        missing = ((0, 0), (0, width - known.places.corners.shape[1]))
        corners, weights = (np.pad(each, missing) for each in (known.places.corners, known.places.weights))
        both = SurfacePoints(np.concatenate([places.corners, corners]), np.concatenate([places.weights, weights]))
        positions = np.concatenate([part.points, known.positions])
        return Observations(both, positions, np.concatenate([precisions, known.precisions]))

    def _below(
        self, points: Float[np.ndarray, "n 3"], part: PartSamples
    ) -> tuple[SurfacePoints, Float[np.ndarray, "p 3"] | None, Float[np.ndarray, " p"]]:
        """The closest point of the placed model that faces as each sample does, its normal on a mesh, the distance."""
        samples = part.points
        if self.faces is None:
            away, nearest = KDTree(points[self._own]).query(samples)
            nearest = self._own[nearest]
            corners = np.pad(nearest[:, None], ((0, 0), (0, 2)))
            return SurfacePoints(corners, np.tile([1.0, 0.0, 0.0], (len(samples), 1))), None, away
        corners = points[self.faces]
        near = KDTree(corners.mean(axis=1)).query(samples, k=min(_TRIANGLES, len(corners)))[1].reshape(len(samples), -1)
        weights = closest_weights(corners[near.ravel()], np.repeat(samples, near.shape[1], axis=0))
        weights = weights.reshape(*near.shape, 3)
        offsets = np.linalg.norm(np.einsum("ptck,ptc->ptk", corners[near], weights) - samples[:, None], axis=2)
        sides = np.diff(corners, axis=1)
        normals = unit(np.cross(sides[:, 0], sides[:, 1]))
        if part.normals is None:
            best = offsets.argmin(axis=1)
        else:  # where none of them faces as the sample does, the nearest one
            turned = np.einsum("ptk,pk->pt", normals[near], part.normals) < 0
            best = (offsets + turned * (1 + offsets.max())).argmin(axis=1)
        rows = np.arange(len(samples))
        nearest = near[rows, best]
        return SurfacePoints(self.faces[nearest], weights[rows, best]), normals[nearest], offsets[rows, best]

    def rigid_starts(self, part: PartSamples) -> Iterator[Placement]:
        """Where closest points put the part on the mean as a rigid body, from all rotations and many places."""
        part = part.sampled(_FEW)
        own = self.model.mean[self._own]
        chosen = self._own[farthest_points(own, min(_ON_MODEL, len(own)), seed=0)]
        mean, some, across = self.model.mean[chosen], part.points, None
        tree = KDTree(mean)
        if self.faces is not None and part.normals is not None:
            # Counterparts must lie near and face alike: a right angle weighs as a length of the model's size.
            normals = Surface(self.model.mean, self.faces).vertex_normals[chosen]
            tree, across = KDTree(np.concatenate([mean, self._size * normals], axis=1)), self._size * part.normals
        centres = mean[farthest_points(mean, min(_MIDDLES, len(mean)), seed=0)]
        centres = np.concatenate([mean.mean(axis=0, keepdims=True), centres])
        turns = np.repeat(cube_rotations().double().numpy(), len(centres), axis=0)
        shifts = np.tile(centres, (24, 1)) - turns @ some.mean(axis=0)
        for _ in range(_STEPS):
            turns, shifts, distances = _closer(some, across, turns, shifts, tree, mean)
        kept: list[Placement] = []
        for number in np.argsort(distances):
            start = Placement(turns[number].T, -shifts[number] @ turns[number])  # from the mean to the part
            if not any(self._alike(start, other) for other in kept):
                kept.append(start)
                yield start
            if len(kept) == _LOOKED_AT:
                return


def _closer(
    some: Float[np.ndarray, "p 3"],
    across: Float[np.ndarray, "p 3"] | None,
    turns: Float[np.ndarray, "s 3 3"],
    shifts: Float[np.ndarray, "s 3"],
    tree: KDTree,
    targets: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "s 3 3"], Float[np.ndarray, "s 3"], Float[np.ndarray, " s"]]:
    """A step of trimmed closest points for many starts at once, and their trimmed mean squared distances before."""
    moved = some @ turns.transpose(0, 2, 1) + shifts[:, None]
    asked = moved if across is None else np.concatenate([moved, across @ turns.transpose(0, 2, 1)], axis=2)
    distances, nearest = tree.query(asked)
    kept = distances <= np.quantile(distances, 0.9, axis=1, keepdims=True)
    starts = np.tile(some, (len(turns), 1, 1))
    turn, shift = rigid_motion(starts, targets[nearest], weights=kept.astype(float), rounds=0)
    return turn, shift, (kept * distances**2).sum(axis=1) / kept.sum(axis=1)
