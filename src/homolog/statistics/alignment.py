"""Generalised Procrustes analysis: the alignment of many shapes in correspondence."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from homolog.core.errors import ArgumentError
from homolog.statistics.rows import PointRows, Rows, blocks

# Iterations end once the sum of squared distances from the mean falls by less than this share of the sum of squares.
_CONVERGED = 1e-12
_MOST_ROUNDS = 200


@dataclass(frozen=True, eq=False)
class Aligned:
    """Aligned shapes and their similarity transforms; the shapes themselves are computed when they are asked for.

    Shape i is ``scales[i] * given[i] @ rotations[i].T + shifts[i]``, ``aligned[i]`` or, of all, ``aligned.points[i]``.

    Args:
        given: the shapes (s, n, 3).
        mean: of the aligned shapes (n, 3).
        rotations: proper ones (s, 3, 3).
        scales: positive; 1 unless the size is normalised (s,).
        shifts: (s, 3).
        weights: how much each point counted (n,); None where all counted alike.
    """

    given: Rows
    mean: Float[np.ndarray, "n 3"]
    rotations: Float[np.ndarray, "s 3 3"]
    scales: Float[np.ndarray, " s"]
    shifts: Float[np.ndarray, "s 3"]
    weights: Float[np.ndarray, " n"] | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Numbers of shapes and points, and 3."""
        return self.given.shape

    def __len__(self) -> int:
        return len(self.given)

    def __getitem__(self, key: slice | int) -> Float[np.ndarray, "... n 3"]:
        """Some of the aligned shapes, or one, centred at the origin."""
        if not isinstance(key, slice):
            return np.asarray(self[key : key + 1][0])
        centred = _centred(self.given[key], self.weights)
        return np.asarray(self.scales[key][:, None, None] * centred @ self.rotations[key].transpose(0, 2, 1))

    @cached_property
    def points(self) -> Float[np.ndarray, "s n 3"]:
        """All aligned shapes."""
        return self[:]

    @property
    def distances(self) -> Float[np.ndarray, " s"]:
        """The root mean square distance of each shape from the mean, with the weights, in the shapes' unit."""
        squares = (((self[some] - self.mean) ** 2).sum(axis=2) for some in blocks(self))
        means = [np.average(each, axis=1, weights=self.weights) for each in squares]
        return np.asarray(np.sqrt(np.concatenate(means)))


def generalised_procrustes(
    points: Rows,
    *,
    scale: bool = False,
    start: Float[np.ndarray, "n 3"] | None = None,
    weights: Float[np.ndarray, " n"] | None = None,
) -> Aligned:
    """Generalised Procrustes alignment: rotate and shift shapes to minimise the squared distances from their mean.

    Gower, "Generalized Procrustes analysis", Psychometrika 40, 1975; with scales as in Dryden and Mardia, "Statistical
    Shape Analysis", 1998, but with the sum of squared sizes kept, so that units keep their meaning. Reflections are
    excluded.

    Args:
        points: the shapes (s, n, 3), with at least one shape and three points: an array, or what gives some rows of one
            at a time. Some of them are in memory at once.
        scale: normalise the size as well.
        start: the first reference, which determines the mean's orientation; by default the first shape.
        weights: how much each point counts; those with 0 are moved with the others (n,). By default all count alike.

    Raises:
        ArgumentError: if an array has another shape, holds NaN or infinite numbers, or a shape whose points coincide;
            or fewer than three points count.

    Examples:
        >>> triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
        >>> aligned = generalised_procrustes(np.stack([triangle, triangle @ np.diag([-1, -1, 1]) + 5]))
        >>> bool(np.allclose(aligned.points[0], aligned.points[1]))
        True
    """
    _check(points, start, weights)
    share = np.ones((points.shape[1], 1)) if weights is None else (weights / weights.mean())[:, None]
    middles = np.concatenate([_middles(points[some], weights) for some in blocks(points)])
    centred = (_centred(points[some], weights) for some in blocks(points))
    squares = np.concatenate([(share * each**2).sum(axis=(1, 2)) for each in centred])
    mean = _centred(points[:1] if start is None else start[None], weights)[0]
    rotations, scales, before = np.tile(np.eye(3), (len(points), 1, 1)), np.ones(len(points)), np.inf
    for _ in range(_MOST_ROUNDS):
        found = [_rotations(_centred(points[some], weights), share * mean) for some in blocks(points)]
        rotations = np.concatenate([each for each, _ in found])
        if scale:
            best = np.concatenate([strengths for _, strengths in found]) / squares
            scales = np.asarray(best * np.sqrt(squares.sum() / (best**2 * squares).sum()))
        now = Aligned(points, mean, rotations, scales, np.zeros((len(points), 3)), weights)
        mean = sum(now[some].sum(axis=0) for some in blocks(points)) / len(points)
        residual = (scales**2 * squares).sum() - len(points) * (share * mean**2).sum()
        if before - residual <= _CONVERGED * squares.sum():
            break
        before = residual
    shifts = -scales[:, None] * np.einsum("skl,sl->sk", rotations, middles)
    return Aligned(points, mean, rotations, scales, shifts, weights)


def _middles(points: Float[np.ndarray, "s n 3"], weights: Float[np.ndarray, " n"] | None) -> Float[np.ndarray, "s 3"]:
    return np.asarray(np.average(points, axis=1, weights=weights))


def _centred(points: Float[np.ndarray, "s n 3"], weights: Float[np.ndarray, " n"] | None) -> Float[np.ndarray, "s n 3"]:
    return np.asarray(points - _middles(points, weights)[:, None])


def _check(points: Rows, start: Float[np.ndarray, "n 3"] | None, weights: Float[np.ndarray, " n"] | None) -> None:
    if len(points.shape) != 3 or points.shape[2] != 3 or len(points) < 1 or points.shape[1] < 3:
        raise ArgumentError(f"points has shape {points.shape}, but must have shape (shapes, points, 3)")
    if start is not None and start.shape != points.shape[1:]:
        raise ArgumentError(f"start has shape {start.shape}, but must have shape {points.shape[1:]}, as points has it")
    all_finite = all(np.isfinite(points[some]).all() for some in blocks(points))
    if not (all_finite and (start is None or np.isfinite(start).all())):
        raise ArgumentError("points holds NaN or infinite numbers, but must be finite")
    if weights is not None:
        if weights.shape != points.shape[1:2] or not (np.isfinite(weights).all() and (weights >= 0).all()):
            raise ArgumentError(f"weights must be numbers from 0, one for each of the {points.shape[1]} points")
        if (weights > 0).sum() < 3:
            raise ArgumentError(f"weights leave {(weights > 0).sum()} points, but aligning needs three")
        points = PointRows(points, weights > 0)
    if any((np.ptp(points[some], axis=1) == 0).all(axis=1).any() for some in blocks(points)):
        raise ArgumentError("points holds a shape whose points are all the same, which cannot be aligned")


def _rotations(
    centred: Float[np.ndarray, "s n 3"], mean: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "s 3 3"], Float[np.ndarray, " s"]]:
    """The best rotation of each shape to the weighted mean (Kabsch, 1976), and the inner product of both after it."""
    left, sizes, right = np.linalg.svd(np.einsum("nk,snl->skl", mean, centred))
    signs = np.ones_like(sizes)
    # The best orthogonal matrix may be a reflection; the best rotation then flips the direction of least variance.
    signs[:, 2] = np.sign(np.linalg.det(left @ right))
    return left @ (signs[:, :, None] * right), (signs * sizes).sum(axis=1)
