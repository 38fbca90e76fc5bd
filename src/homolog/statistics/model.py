"""Point distribution models: the mean of shapes, and their principal modes of variation (PCA)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from homolog.core.errors import ArgumentError

# Singular values below this share of the largest one are rounding errors.
_RANK = 1e-9


@dataclass(frozen=True, eq=False)
class ShapeModel:
    """A mean shape and its principal modes (Cootes et al., "Active shape models", CVIU 61, 1995).

    Args:
        mean: of the shapes (n, 3).
        modes: orthonormal as vectors of 3n numbers; the entry of largest absolute value is positive (k, n, 3).
        variances: of the shapes along the modes, in the shapes' unit squared, descending; normalised by s - 1 (k,).
        kept: which points the modes are orthonormal on; the others follow these (n,). None where all are.
    """

    mean: Float[np.ndarray, "n 3"]
    modes: Float[np.ndarray, "k n 3"]
    variances: Float[np.ndarray, " k"]
    kept: Bool[np.ndarray, " n"] | None = None

    @property
    def deviations(self) -> Float[np.ndarray, " k"]:
        """Standard deviations along the modes."""
        return np.asarray(np.sqrt(self.variances))

    def coefficients(self, points: Float[np.ndarray, "s n 3"]) -> Float[np.ndarray, "s k"]:
        """Coefficients of aligned shapes along each mode, in standard deviations."""
        own = slice(None) if self.kept is None else self.kept
        flat = (points - self.mean)[:, own].reshape(len(points), -1)
        return np.asarray(flat @ self.modes[:, own].reshape(-1, flat.shape[1]).T / self.deviations)

    def shapes(self, coefficients: Float[np.ndarray, "s k"]) -> Float[np.ndarray, "s n 3"]:
        """Shapes from coefficients in standard deviations, of the first modes or of all."""
        count = coefficients.shape[1]
        offsets = np.tensordot(coefficients * self.deviations[:count], self.modes[:count], axes=1)
        return np.asarray(self.mean + offsets)

    def of_kept(self) -> ShapeModel:
        """The model of the points that it was made of alone."""
        if self.kept is None:
            return self
        return ShapeModel(self.mean[self.kept], self.modes[:, self.kept], self.variances)


def principal_modes(points: Float[np.ndarray, "s n 3"], kept: Bool[np.ndarray, " n"] | None = None) -> ShapeModel:
    """Principal component analysis of aligned shapes, by a singular value decomposition.

    Args:
        points: aligned shapes, at least two (s, n, 3).
        kept: which points they are analysed by (n,); by default all. The others follow by linear regression on the
            coefficients, which all modes together make exact.

    Raises:
        ArgumentError: if there are fewer than two shapes.

    Examples:
        >>> triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
        >>> model = principal_modes(np.stack([triangle, 2 * triangle, 3 * triangle]))
        >>> model.variances.round(6).tolist(), model.coefficients(3 * triangle[None]).round(6).tolist()
        ([2.0], [[1.0]])
    """
    if points.ndim != 3 or len(points) < 2:
        raise ArgumentError(f"points has shape {points.shape}, but must hold two shapes or more, (shapes, points, 3)")
    mean = points.mean(axis=0)
    own = np.ones(len(mean), dtype=bool) if kept is None else kept
    centred = points - mean
    scores, sizes, rows = np.linalg.svd(centred[:, own].reshape(len(points), -1), full_matrices=False)
    rank = int((sizes > _RANK * max(sizes[0], np.abs(mean).max())).sum())
    scores, rows, sizes = scores[:, :rank], rows[:rank], sizes[:rank]
    largest = np.take_along_axis(rows, np.abs(rows).argmax(axis=1, keepdims=True), axis=1)
    modes = np.empty((rank, *mean.shape))
    modes[:, own] = (rows * np.sign(largest)).reshape(rank, own.sum(), 3)
    modes[:, ~own] = np.einsum("sk,snx->knx", scores / sizes * np.sign(largest)[:, 0], centred[:, ~own])
    return ShapeModel(mean, modes, sizes**2 / (len(points) - 1), kept)
