"""Generalised Procrustes analysis: many shapes with the same points, laid upon each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from homolog.core.errors import ArgumentError

# It ends once a round lowers the distances from the mean by less than this share of all shapes' size.
_SETTLED = 1e-12
_MOST_ROUNDS = 200


@dataclass(frozen=True, eq=False)
class Aligned:
    """Shapes laid upon each other, and how each came there.

    Shape i is where ``scales[i] * given[i] @ rotations[i].T + shifts[i]`` takes it.

    Args:
        points: around the origin (s, n, 3).
        mean: of these shapes (n, 3).
        rotations: proper ones (s, 3, 3).
        scales: positive, 1 unless scales were asked for (s,).
        shifts: (s, 3).
    """

    points: Float[np.ndarray, "s n 3"]
    mean: Float[np.ndarray, "n 3"]
    rotations: Float[np.ndarray, "s 3 3"]
    scales: Float[np.ndarray, " s"]
    shifts: Float[np.ndarray, "s 3"]

    @property
    def distances(self) -> Float[np.ndarray, " s"]:
        """How far each shape is from the mean: the root mean square over its points, in the shapes' unit."""
        return np.asarray(np.sqrt(((self.points - self.mean) ** 2).sum(axis=2).mean(axis=1)))


def generalised_procrustes(
    points: Float[np.ndarray, "s n 3"], *, scale: bool = False, start: Float[np.ndarray, "n 3"] | None = None
) -> Aligned:
    """Turn and shift shapes with the same points so that they lie as near as they can to their mean.

    Gower, "Generalized Procrustes analysis", Psychometrika 40, 1975; with scales as in Dryden and Mardia, "Statistical
    Shape Analysis", 1998, but so that the sum of the squared sizes stays what it was: units keep their meaning.
    Reflections are excluded.

    Args:
        points: the shapes (s, n, 3), with at least one shape and three points.
        scale: bring them to one size as well.
        start: what the shapes are turned to first, which the mean then resembles; by default the first shape.

    Raises:
        ArgumentError: if the array has another shape, or holds numbers that are not finite, or a shape is one point.
    """
    _check(points, start)
    middles = points.mean(axis=1, keepdims=True)
    centred = points - middles
    mean = centred[0] if start is None else start - start.mean(axis=0)
    rotations, scales = np.tile(np.eye(3), (len(points), 1, 1)), np.ones(len(points))
    total, before = (centred**2).sum(), np.inf
    for _ in range(_MOST_ROUNDS):
        rotations, strengths = _rotations(centred, mean)
        if scale:
            scales = _scales(centred, strengths)
        laid = scales[:, None, None] * centred @ rotations.transpose(0, 2, 1)
        mean = laid.mean(axis=0)
        left = ((laid - mean) ** 2).sum()
        if before - left <= _SETTLED * total:
            break
        before = left
    shifts = -scales[:, None] * np.einsum("skl,sl->sk", rotations, middles[:, 0])
    return Aligned(laid, mean, rotations, scales, shifts)


def _check(points: Float[np.ndarray, "s n 3"], start: Float[np.ndarray, "n 3"] | None) -> None:
    if points.ndim != 3 or points.shape[2] != 3 or len(points) < 1 or points.shape[1] < 3:
        raise ArgumentError(f"points has shape {points.shape}, but must have shape (shapes, points, 3)")
    if start is not None and start.shape != points.shape[1:]:
        raise ArgumentError(f"start has shape {start.shape}, but must have shape {points.shape[1:]}, as points has it")
    if not (np.isfinite(points).all() and (start is None or np.isfinite(start).all())):
        raise ArgumentError("points holds NaN or infinite numbers, but must be finite")
    if (np.ptp(points, axis=1) == 0).all(axis=1).any():
        raise ArgumentError("points holds a shape whose points are all the same, which cannot be aligned")


def _rotations(
    centred: Float[np.ndarray, "s n 3"], mean: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "s 3 3"], Float[np.ndarray, " s"]]:
    """The rotation of each shape to the mean (Kabsch, 1976), and the inner product of the two then."""
    left, sizes, right = np.linalg.svd(np.einsum("nk,snl->skl", mean, centred))
    signs = np.ones_like(sizes)
    # The best orthogonal matrix may be a reflection; the best rotation then gives way along the weakest direction.
    signs[:, 2] = np.sign(np.linalg.det(left @ right))
    return left @ (signs[:, :, None] * right), (signs * sizes).sum(axis=1)


def _scales(centred: Float[np.ndarray, "s n 3"], strengths: Float[np.ndarray, " s"]) -> Float[np.ndarray, " s"]:
    squares = (centred**2).sum(axis=(1, 2))
    best = strengths / squares
    return np.asarray(best * np.sqrt(squares.sum() / (best**2 * squares).sum()))
