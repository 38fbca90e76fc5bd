"""Point distribution models: the mean of shapes, and their principal modes of variation (PCA)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from homolog.core.arguments import check_count
from homolog.core.errors import ArgumentError
from homolog.statistics.rows import PointRows, Rows, blocks

# Directions beyond those asked for, and rounds, of the search for the principal ones, which ends earlier once their
# variance grows by less than this share.
_MORE, _ROUNDS, _STEADY = 20, 30, 1e-7
# Singular values below this share of the largest one are rounding errors.
_RANK = 1e-9


@dataclass(frozen=True, eq=False)
class ShapeModel:
    """A mean shape and its principal modes (Cootes et al., "Active shape models", CVIU 61, 1995).

    Args:
        mean: of the shapes (n, 3).
        modes: orthonormal as vectors of 3n numbers; the entry of largest absolute value is positive (k, n, 3).
        variances: of the shapes along the modes, in the shapes' unit squared, descending; normalised by s - 1 (k,).
        rest: the variance of the shapes in all directions beyond the modes.
        kept: which points the modes are orthonormal on; the others follow these (n,). None where all are.
    """

    mean: Float[np.ndarray, "n 3"]
    modes: Float[np.ndarray, "k n 3"]
    variances: Float[np.ndarray, " k"]
    rest: float = 0.0
    kept: Bool[np.ndarray, " n"] | None = None

    @property
    def total(self) -> float:
        """The variance of the shapes in all directions."""
        return float(self.variances.sum()) + self.rest

    @property
    def deviations(self) -> Float[np.ndarray, " k"]:
        """Standard deviations along the modes."""
        return np.asarray(np.sqrt(self.variances))

    def coefficients(self, points: Rows) -> Float[np.ndarray, "s k"]:
        """Coefficients of aligned shapes along each mode, in standard deviations."""
        own, mean = (points, self.mean) if self.kept is None else (PointRows(points, self.kept), self.mean[self.kept])
        modes = self.of_kept().modes.reshape(-1, mean.size).T
        found = [_flat(own[some], mean) @ modes for some in blocks(own)]
        return np.asarray(np.concatenate(found) / self.deviations)

    def shapes(self, coefficients: Float[np.ndarray, "s k"]) -> Float[np.ndarray, "s n 3"]:
        """Shapes from coefficients in standard deviations, of the first modes or of all."""
        count = coefficients.shape[1]
        offsets = np.tensordot(coefficients * self.deviations[:count], self.modes[:count], axes=1)
        return np.asarray(self.mean + offsets)

    def of_kept(self) -> ShapeModel:
        """The model of the points that it was made of alone."""
        if self.kept is None:
            return self
        return ShapeModel(self.mean[self.kept], self.modes[:, self.kept], self.variances, self.rest)


def principal_modes(points: Rows, *, kept: Bool[np.ndarray, " n"] | None = None, most: int | None = None) -> ShapeModel:
    """Principal component analysis of aligned shapes: all modes by a singular value decomposition, or the first ones.

    The first ones are found by a randomised subspace iteration, which holds few shapes in memory at a time: Halko,
    Martinsson and Tropp, "Finding structure with randomness", SIAM Review 53, 2011, algorithm 4.4.

    Args:
        points: aligned shapes, at least two (s, n, 3): an array, or what gives some rows of one at a time.
        kept: which points they are analysed by (n,); by default all. The others follow by linear regression on the
            coefficients, which all modes together make exact.
        most: how many modes to find; all by default, and where there are no more.

    Raises:
        ArgumentError: if there are fewer than two shapes, or ``most`` is not positive.

    Examples:
        >>> triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
        >>> model = principal_modes(np.stack([triangle, 2 * triangle, 3 * triangle]))
        >>> model.variances.round(6).tolist(), model.coefficients(3 * triangle[None]).round(6).tolist()
        ([2.0], [[1.0]])
    """
    if len(points.shape) != 3 or len(points) < 2:
        raise ArgumentError(f"points has shape {points.shape}, but must hold two shapes or more, (shapes, points, 3)")
    if most is not None:
        check_count("most", most)
    mean = np.asarray(sum(points[some].sum(axis=0) for some in blocks(points)) / len(points))
    all_of_them = np.ones(len(mean), dtype=bool) if kept is None else kept
    own, middle = PointRows(points, all_of_them), mean[all_of_them]
    if most is None or most + _MORE >= min(len(points), middle.size):
        _, sizes, rows = np.linalg.svd(_flat(own[:], middle), full_matrices=False)
        squares = None
    else:
        sizes, rows, squares = _first_directions(own, middle, most)
    rank = min(len(sizes) if most is None else most, int((sizes > _RANK * max(sizes[0], np.abs(mean).max())).sum()))
    rest = float((sizes[rank:] ** 2).sum() if squares is None else max(0.0, squares - (sizes[:rank] ** 2).sum()))
    rows, sizes = rows[:rank], sizes[:rank]
    rows = rows * np.sign(np.take_along_axis(rows, np.abs(rows).argmax(axis=1, keepdims=True), axis=1))
    modes = np.zeros((rank, *mean.shape))
    modes[:, all_of_them] = rows.reshape(rank, *middle.shape)
    if not all_of_them.all():
        modes[:, ~all_of_them] = _following(points, mean, all_of_them, (rows / sizes[:, None] ** 2).T)
    return ShapeModel(mean, modes, sizes**2 / (len(points) - 1), rest / (len(points) - 1), kept)


def _following(
    points: Rows, mean: Float[np.ndarray, "n 3"], kept: Bool[np.ndarray, " n"], slopes: Float[np.ndarray, "m k"]
) -> Float[np.ndarray, "k r 3"]:
    """The other points of modes that were found by those kept: their regression on the coefficients.

    Args:
        points: the shapes.
        mean: of them.
        kept: which points the modes were found by.
        slopes: what takes these points of a shape to its coefficients, over the squares of all coefficients.
    """
    found = np.zeros((slopes.shape[1], int((~kept).sum()), 3))
    for some in blocks(points):
        offsets = points[some] - mean
        found += np.tensordot((offsets[:, kept].reshape(len(offsets), -1) @ slopes).T, offsets[:, ~kept], axes=1)
    return found


def _flat(points: Float[np.ndarray, "s n 3"], mean: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "s m"]:
    return np.asarray((points - mean).reshape(len(points), -1))


def _first_directions(
    points: Rows, mean: Float[np.ndarray, "n 3"], most: int
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k m"], float]:
    """The largest singular values of centred shapes, some more than asked for, their directions, and all squares."""
    found = np.random.default_rng(0).standard_normal((mean.size, most + _MORE))
    sizes, squares, before = np.zeros(found.shape[1]), 0.0, 0.0
    for _ in range(_ROUNDS):
        basis = np.linalg.qr(found)[0]
        found, products, squares = np.zeros_like(basis), np.zeros((basis.shape[1],) * 2), 0.0
        for some in blocks(points):
            shapes = _flat(points[some], mean)
            along = shapes @ basis
            found += shapes.T @ along
            products += along.T @ along
            squares += float((shapes**2).sum())
        values, turns = (each[..., ::-1] for each in np.linalg.eigh(products))
        sizes = np.sqrt(values.clip(0))
        held = float(values[:most].sum())
        if held - before <= _STEADY * squares:
            break
        before = held
    return sizes, np.ascontiguousarray((basis @ turns).T), squares
