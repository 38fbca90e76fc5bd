"""Compactness, generalisation and specificity of shape models, by the number of modes.

Davies, "Learning shape: optimal models for analysing natural variability", thesis, Manchester, 2002; Styner et al.,
"Evaluation of 3D correspondence methods for model building", IPMI 2003. The distance of two shapes is here the root
mean square distance of their points, so that everything can be computed from the shapes' inner products.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from homolog.core.arguments import check_count
from homolog.core.errors import ArgumentError
from homolog.statistics.model import ShapeModel

# Directions whose variance is below this share of the total variance are rounding errors of the inner products.
_RANK = 1e-12
_SAMPLES = 1000


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
    return np.asarray(np.cumsum(model.variances) / model.variances.sum())


def generalisation(points: Float[np.ndarray, "s n 3"]) -> Curve:
    """Generalisation: the leave-one-out distance of a shape from the model of all other shapes.

    The alignment is not repeated without the shape that is left out, which has influenced it.

    Args:
        points: aligned shapes, at least three.

    Returns:
        For models of 1 to s - 2 modes. Beyond the rank of the other shapes the curve is constant.

    Raises:
        ArgumentError: if there are fewer than three shapes.
    """
    count, n_points = len(points), points.shape[1]
    if count < 3:
        raise ArgumentError(f"points holds {count} shapes, but generalisation needs three or more")
    flat = (points - points.mean(axis=0)).reshape(count, -1)
    products = flat @ flat.T
    residuals = np.stack([_residuals(products, one) for one in range(count)])
    return Curve.of(np.sqrt(residuals.clip(0) / n_points))


def _residuals(products: Float[np.ndarray, "s s"], one: int) -> Float[np.ndarray, " k"]:
    """The squared residuals of one shape in models of the others, from all inner products of the shapes."""
    others = np.delete(np.arange(len(products)), one)
    among, across = products[np.ix_(others, others)], products[others, one]
    of_mean = among.mean(axis=1)  # the inner product of each of the others with their mean
    centred = among - of_mean[:, None] - of_mean + among.mean()
    # Inner products of the others with the one less their mean, up to a constant, which centred directions ignore.
    shape = across - of_mean
    squares, directions = np.linalg.eigh(centred)
    # Centred shapes have one dimension fewer than there are of them.
    squares, directions = squares[::-1][:-1], directions[:, ::-1][:, :-1]
    held = squares > _RANK * max(float(np.trace(products)), np.finfo(float).tiny)
    along = np.where(held, directions.T @ shape / np.sqrt(np.where(held, squares, 1.0)), 0.0)
    total = products[one, one] - 2 * across.mean() + among.mean()
    return np.asarray(total - np.cumsum(along**2))


def specificity(
    model: ShapeModel, points: Float[np.ndarray, "s n 3"], *, samples: int = _SAMPLES, seed: int = 0
) -> Curve:
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
    distances = np.tile((given**2).sum(axis=1), (samples, 1))
    nearest = np.empty_like(random)
    for mode, (of_given, of_random) in enumerate(zip(given.T, random.T, strict=True)):
        distances += of_random[:, None] ** 2 - 2 * of_random[:, None] * of_given
        nearest[:, mode] = distances.min(axis=1)
    return Curve.of(np.sqrt(nearest.clip(0) / points.shape[1]))
