"""Compactness, generalisation and specificity of shape models, by the number of modes.

Davies, "Learning shape: optimal models for analysing natural variability", thesis, Manchester, 2002; Styner et al.,
"Evaluation of 3D correspondence methods for model building", IPMI 2003. The distance of two shapes is here the root
mean square distance of their points, so that everything can be computed from the shapes' coefficients along modes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from homolog.core.arguments import check_count
from homolog.core.errors import ArgumentError
from homolog.statistics.model import ShapeModel, principal_modes
from homolog.statistics.rows import Rows, blocks

# Directions whose variance is below this share of the total variance are rounding errors.
_RANK = 1e-12
_SAMPLES = 1000
# Between random shapes and given ones, in memory at a time.
_MOST_DISTANCES = 10**6


@dataclass(frozen=True, eq=False)
class Curve:
    """Distances for models of 1, 2, ... modes, in the shapes' unit.

    Args:
        mean: over the shapes or samples (k,).
        error: the standard error of that (k,).
    """

    mean: Float[np.ndarray, " k"]
    error: Float[np.ndarray, " k"]

    @classmethod
    def of(cls, distances: Float[np.ndarray, "r k"]) -> Curve:
        """Mean and standard error of repeated measurements, a row each."""
        spread = distances.std(axis=0, ddof=1) if len(distances) > 1 else np.zeros(distances.shape[1])
        return cls(distances.mean(axis=0), spread / np.sqrt(len(distances)))


def compactness(model: ShapeModel) -> Float[np.ndarray, " k"]:
    """Compactness: the cumulative share of the variance of the first 1, 2, ... modes.

    Examples:
        >>> compactness(ShapeModel(np.zeros((3, 3)), np.zeros((2, 3, 3)), np.array([3.0, 1.0]))).tolist()
        [0.75, 1.0]
    """
    return np.asarray(np.cumsum(model.variances) / model.total)


def generalisation(points: Rows, model: ShapeModel | None = None) -> Curve:
    """Generalisation: the leave-one-out distance of a shape from the model of all other shapes.

    The alignment is not repeated without the shape that is left out, which has influenced it. Of a model that lacks
    some of the variance, the modes of the others are sought among its own; what lies beyond counts in full.

    Args:
        points: aligned shapes, at least three.
        model: of all shapes; by default with all modes.

    Returns:
        For models of 1 to s - 2 modes, or to as many as the model has. Beyond the rank of the other shapes the curve is
        constant.

    Raises:
        ArgumentError: if there are fewer than three shapes.
    """
    count, n_points = len(points), points.shape[1]
    if count < 3:
        raise ArgumentError(f"points holds {count} shapes, but generalisation needs three or more")
    model = model or principal_modes(points)
    along = model.coefficients(points) * model.deviations
    squares = _squares(points, model)
    n_modes = count - 2 if model.rest <= _RANK * model.total else min(count - 2, along.shape[1])
    products, least = along.T @ along, _RANK * max(float(squares.sum()), np.finfo(float).tiny)
    residuals = np.stack(
        [_residuals(products, *each, count, n_modes, least) for each in zip(along, squares, strict=True)]
    )
    return Curve.of(np.sqrt(residuals.clip(0) / n_points))


def _squares(points: Rows, model: ShapeModel) -> Float[np.ndarray, " s"]:
    """Of the distance of each shape from the mean."""
    return np.concatenate([((points[some] - model.mean) ** 2).sum(axis=(1, 2)) for some in blocks(points)])


def _residuals(
    products: Float[np.ndarray, "m m"],
    along: Float[np.ndarray, " m"],
    square: float,
    count: int,
    n_modes: int,
    least: float,
) -> Float[np.ndarray, " k"]:
    """The squared residuals of a shape in models of the others, from coefficients along the modes of all shapes.

    Without one of s shapes, the mean moves away from it by its own offset over s - 1.

    Args:
        products: of the coefficients of all shapes.
        along: the shape's own coefficients.
        square: of its distance from the mean.
        count: of all shapes.
        n_modes: of the largest model.
        least: squares below are rounding errors.
    """
    longer = count / (count - 1)
    values, directions = np.linalg.eigh(products - longer * np.outer(along, along))
    values, directions = values[::-1][:n_modes], directions[:, ::-1][:, :n_modes]
    found = np.where(values > least, directions.T @ along, 0.0)
    return np.asarray(longer**2 * (square - np.cumsum(np.pad(found**2, (0, n_modes - len(found))))))


def specificity(model: ShapeModel, points: Rows, *, samples: int = _SAMPLES, seed: int = 0) -> Curve:
    """Specificity: the distance of random shapes of a model from the nearest of the shapes that it was made of.

    Args:
        model: the mean and modes of the shapes.
        points: the aligned shapes.
        samples: number of random shapes, normally distributed along the modes; the same for any number of modes.
        seed: of the random shapes.

    Returns:
        For models of 1 to all modes.

    Raises:
        ArgumentError: if the number of samples is not positive.
    """
    check_count("samples", samples)
    given = model.coefficients(points) * model.deviations
    random = np.random.default_rng(seed).standard_normal((samples, len(model.variances))) * model.deviations
    nearest, squares = np.empty_like(random), _squares(points, model)
    size = max(1, _MOST_DISTANCES // len(given))
    for begin in range(0, samples, size):
        some = slice(begin, begin + size)
        distances = np.tile(squares, (len(random[some]), 1))
        for mode, (of_given, of_random) in enumerate(zip(given.T, random[some].T, strict=True)):
            distances += of_random[:, None] ** 2 - 2 * of_random[:, None] * of_given
            nearest[some, mode] = distances.min(axis=1)
    return Curve.of(np.sqrt(nearest.clip(0) / points.shape[1]))
