"""Posterior shape models: what a shape model says of a whole shape once some of its points were seen.

T. Albrecht, M. Lüthi, T. Gerig, T. Vetter, "Posterior shape models", Medical Image Analysis 17, 2013: a shape is the
mean plus modes times independent normal coefficients, and each point that was seen adds a normal error. All of it being
normal, the shapes that agree with what was seen are normally distributed again.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from homolog.core.errors import ArgumentError
from homolog.geometry.projection import SurfacePoints
from homolog.statistics.model import ShapeModel

_FEWEST = 3
_ROUNDS = 30
# A placement is found once nothing moves by more than this share of the model's size in a round.
_CONVERGED = 1e-9
# Of a placement before anything is seen: in radians, in natural logarithms of the scale, in sizes of the model.
_WEAK = 100.0


@dataclass(frozen=True, eq=False)
class Observations:
    """Where points of a model's surface were seen.

    Args:
        places: which points, by corners among the model's points and barycentric coordinates (p).
        positions: where each was seen (p, 3).
        precisions: inverse covariance matrices of these positions, in the unit to the power of -2 (p, 3, 3); zero along
            what is not known, such as where along the surface a point lies.

    Raises:
        ArgumentError: if there are not as many of each.
    """

    places: SurfacePoints
    positions: Float[np.ndarray, "p 3"]
    precisions: Float[np.ndarray, "p 3 3"]

    def __post_init__(self) -> None:
        count = len(self.places.corners)
        if self.positions.shape != (count, 3) or self.precisions.shape != (count, 3, 3):
            raise ArgumentError(
                f"positions and precisions have shapes {self.positions.shape} and {self.precisions.shape}, but must be "
                f"of the {count} points that were seen, ({count}, 3) and ({count}, 3, 3)"
            )

    @classmethod
    def of_points(cls, indices: np.ndarray, positions: Float[np.ndarray, "p 3"], deviation: float) -> Observations:
        """Points of the model that were seen with one error in all directions.

        Args:
            indices: of the model's points (p,).
            positions: where each was seen (p, 3).
            deviation: standard deviation of each coordinate, above 0.
        """
        places = SurfacePoints(np.reshape(indices, (-1, 1)), np.ones((len(indices), 1)))
        return cls(places, positions, np.tile(np.eye(3) / deviation**2, (len(indices), 1, 1)))


@dataclass(frozen=True, eq=False)
class Placement:
    """A similarity transform: positions p go to ``scale * p @ rotation.T + shift``.

    Args:
        rotation: a proper one (3, 3).
        shift: (3,).
        scale: positive.
    """

    rotation: Float[np.ndarray, "3 3"]
    shift: Float[np.ndarray, " 3"]
    scale: float = 1.0

    def __call__(self, points: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
        """Where positions go."""
        return np.asarray(self.scale * points @ self.rotation.T + self.shift)

    def moved(self, turn: Float[np.ndarray, " 3"], shift: Float[np.ndarray, " 3"], growth: float) -> Placement:
        """The placement followed by a turn (a rotation vector) about its shift, a growth (a logarithm) and a shift."""
        rotation = Rotation.from_rotvec(turn).as_matrix() @ self.rotation
        return Placement(rotation, self.shift + shift, self.scale * float(np.exp(growth)))


@dataclass(frozen=True, eq=False)
class PlacedPosterior:
    """The likeliest shape and placement of a model, and what is still open.

    Args:
        model: before.
        placement: from the model's coordinates to those of what was seen.
        coefficients: of the shape, in standard deviations (k,).
        covariance: of shift, turn, growth if the size is open, and coefficients (q, q).
    """

    model: ShapeModel
    placement: Placement
    coefficients: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "q q"]

    @cached_property
    def points(self) -> Float[np.ndarray, "n 3"]:
        """The likeliest shape, placed (n, 3)."""
        return self.placement(self.model.shapes(self.coefficients[None])[0])

    @cached_property
    def variances(self) -> Float[np.ndarray, " n"]:
        """Of each point's distance from its likeliest position: the trace of its covariance matrix (n,).

        What is open of the placement counts.
        """
        everywhere = SurfacePoints(np.arange(len(self.points))[:, None], np.ones((len(self.points), 1)))
        return self.variances_at(everywhere)

    def variances_at(self, places: SurfacePoints) -> Float[np.ndarray, " p"]:
        """The same at any places of the model's surface (p,)."""
        scale = len(self.covariance) > 6 + len(self.coefficients)
        modes = _mode_columns(self.model, places)
        columns = _placed_columns(self.placement, places.interpolate(self.points), modes, scale=scale)
        return np.asarray(((columns @ self.covariance) * columns).sum(axis=(1, 2)))


def posterior_model(model: ShapeModel, seen: Observations) -> ShapeModel:
    """The shape model of those shapes that agree with points that were seen, in the model's own coordinates.

    Albrecht et al. 2013, equations 12 to 17.

    Args:
        model: before.
        seen: in the model's coordinates.

    Returns:
        A model with as many modes at most: the mean is the likeliest shape.

    Examples:
        >>> triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
        >>> from homolog.statistics import principal_modes
        >>> model = principal_modes(np.stack([triangle, 2 * triangle, 3 * triangle]))
        >>> seen = Observations.of_points(np.array([1]), np.array([[2.5, 0, 0]]), 1e-6)
        >>> posterior_model(model, seen).mean.round(3).tolist()
        [[0.0, 0.0, 0.0], [2.5, 0.0, 0.0], [0.0, 2.5, 0.0]]
    """
    design = _mode_columns(model, seen.places)
    mean = seen.places.interpolate(model.mean)
    coefficients, covariance = _conditioned(design, seen.positions - mean, seen.precisions, np.ones(design.shape[2]))
    # Modes times deviations times a root of the covariance: its singular vectors are the new modes.
    sizes, turned = np.linalg.eigh(model.deviations[:, None] * covariance * model.deviations)
    order = np.argsort(sizes)[::-1]
    kept = order[sizes[order] > 1e-12 * max(float(model.variances.max(initial=0.0)), np.finfo(float).tiny)]
    modes = np.tensordot(turned[:, kept].T, model.modes, axes=1)
    return ShapeModel(model.shapes(coefficients[None])[0], modes, sizes[kept])


def placed_posterior(
    model: ShapeModel,
    seen: Observations,
    start: Placement,
    *,
    coefficients: Float[np.ndarray, " k"] | None = None,
    scale: bool = False,
    rounds: int = _ROUNDS,
) -> PlacedPosterior:
    """The likeliest shape and placement together, by Gauss and Newton's iteration, and the variance around them.

    As ``posterior_model``, but where the model lies is not known before. The placement's six parameters, or seven with
    a scale, stand beside the modes, with so weak a prior that what was seen decides alone. New here.

    Args:
        model: before.
        seen: in the coordinates that the model is to be placed in.
        start: a placement that is nearly right.
        coefficients: of the shape, to start from (k,); by default the mean.
        scale: whether the size is open as well.
        rounds: at most so many.

    Raises:
        ArgumentError: if fewer than three points were seen.
    """
    if len(seen.positions) < _FEWEST:
        raise ArgumentError(
            f"{len(seen.positions)} points were seen, but a placement needs {_FEWEST} or more; give more of them"
        )
    count, size = len(model.variances), float(np.sqrt(((model.mean - model.mean.mean(axis=0)) ** 2).sum(axis=1).mean()))
    placement, shape = start, np.zeros(count) if coefficients is None else coefficients
    modes, mean = _mode_columns(model, seen.places), seen.places.interpolate(model.mean)
    prior = np.concatenate([np.full(3, 1 / (_WEAK * size) ** 2), np.full(3 + scale, 1 / _WEAK**2), np.ones(count)])
    held = np.arange(len(prior)) < 6 + scale
    for _ in range(rounds):
        now = placement(mean + modes @ shape)
        design = _placed_columns(placement, now, modes, scale=scale)
        away = seen.positions - now
        open_ = np.concatenate([np.zeros(int(held.sum())), shape])
        step, covariance = _conditioned(design, away, seen.precisions, prior, open_)
        growth = float(step[6]) if scale else 0.0
        placement, shape = placement.moved(step[3:6], step[:3], growth), shape + step[6 + scale :]
        if float(np.abs(design @ step).max()) <= _CONVERGED * size:
            break
    return PlacedPosterior(model, placement, shape, covariance)


def _mode_columns(model: ShapeModel, places: SurfacePoints) -> Float[np.ndarray, "p 3 k"]:
    """How far each place moves by one standard deviation of each mode."""
    moved = (model.modes * model.deviations[:, None, None]).transpose(1, 2, 0)
    return places.interpolate(moved)


def _placed_columns(
    placement: Placement, now: Float[np.ndarray, "p 3"], modes: Float[np.ndarray, "p 3 k"], *, scale: bool
) -> Float[np.ndarray, "p 3 q"]:
    """How far each place moves by one unit of each parameter: shift, turn, growth if it is open, and modes."""
    arm = now - placement.shift
    shifts = np.tile(np.eye(3), (len(now), 1, 1))
    turns = np.stack([np.cross(axis, arm) for axis in np.eye(3)], axis=2)
    grown = [arm[:, :, None]] if scale else []
    return np.concatenate([shifts, turns, *grown, placement.scale * placement.rotation @ modes], axis=2)


def _conditioned(
    design: Float[np.ndarray, "p 3 q"],
    away: Float[np.ndarray, "p 3"],
    precisions: Float[np.ndarray, "p 3 3"],
    prior: Float[np.ndarray, " q"],
    now: Float[np.ndarray, " q"] | None = None,
) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q q"]]:
    """Mean and covariance of parameters given linear observations; the prior is centred at minus ``now``."""
    weighted = (precisions @ design).reshape(-1, design.shape[2])
    information = weighted.T @ design.reshape(-1, design.shape[2]) + np.diag(prior)
    right = weighted.T @ away.ravel() - (0.0 if now is None else prior * now)
    covariance = np.linalg.inv(information)
    return covariance @ right, (covariance + covariance.T) / 2
