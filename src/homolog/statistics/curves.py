"""How good a shape model is, against the number of its modes.

Davies, "Learning shape: optimal models for analysing natural variability", thesis, Manchester, 2002; Styner et al.,
"Evaluation of 3D correspondence methods for model building", IPMI 2003. The distance of two shapes is here the root
mean square distance of their points, so that all of it can be found in the space of the shapes' inner products.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from homolog.core.arguments import check_count
from homolog.core.errors import ArgumentError
from homolog.statistics.model import ShapeModel

# Of the sum of all shapes' squared distances from their mean. Inner products are rounded by shares of it, even where
# the shape left out is most of it: a direction in which the others' squares add up to less may be rounding alone.
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
        """The curve of repeated measurements, a row each."""
        spread = distances.std(axis=0, ddof=1) if len(distances) > 1 else np.zeros(distances.shape[1])
        return cls(distances.mean(axis=0), spread / np.sqrt(len(distances)))


def compactness(model: ShapeModel) -> Float[np.ndarray, " k"]:
    """The share of all variance that the first modes hold: 1 mode, 2, and so on."""
    return np.asarray(np.cumsum(model.variances) / model.variances.sum())


def generalisation(points: Float[np.ndarray, "s n 3"]) -> Curve:
    """How far from a shape a model of all other shapes stays: each left out in turn.

    All shapes were aligned together, once: they are not aligned anew without the one that is left out, which had its
    part in where the others lie.

    Args:
        points: aligned shapes, at least three.

    Returns:
        For models of 1 to s - 2 modes. Where the others vary in fewer directions, further modes change nothing.

    Raises:
        ArgumentError: if there are fewer than three shapes.
    """
    count, n_points = len(points), points.shape[1]
    if count < 3:
        raise ArgumentError(f"points holds {count} shapes, but generalisation needs three or more")
    flat = (points - points.mean(axis=0)).reshape(count, -1)
    products = flat @ flat.T
    left = np.stack([_left(products, one) for one in range(count)])
    return Curve.of(np.sqrt(left.clip(0) / n_points))


def _left(products: Float[np.ndarray, "s s"], one: int) -> Float[np.ndarray, " k"]:
    """The squared length that models of the other shapes leave of one, given all inner products of the shapes."""
    others = np.delete(np.arange(len(products)), one)
    among, across = products[np.ix_(others, others)], products[others, one]
    of_mean = among.mean(axis=1)  # the inner product of each of the others with their mean
    centred = among - of_mean[:, None] - of_mean + among.mean()
    # Of each of the others with the one less their mean, up to a constant, which centred directions do not see.
    shape = across - of_mean
    squares, directions = np.linalg.eigh(centred)
    # Centred shapes have one dimension fewer than there are of them.
    squares, directions = squares[::-1][:-1], directions[:, ::-1][:, :-1]
    held = squares > _RANK * max(float(np.trace(products)), np.finfo(float).tiny)
    along = np.where(held, directions.T @ shape / np.sqrt(np.where(held, squares, 1.0)), 0.0)
    whole = products[one, one] - 2 * across.mean() + among.mean()
    return np.asarray(whole - np.cumsum(along**2))


def specificity(
    model: ShapeModel, points: Float[np.ndarray, "s n 3"], *, samples: int = _SAMPLES, seed: int = 0
) -> Curve:
    """How far random shapes of a model are from the nearest of the shapes that it was made of.

    Args:
        model: the mean and modes of the shapes.
        points: the aligned shapes.
        samples: how many shapes to draw, normal along the modes; the same draws for any number of modes.
        seed: another seed, other samples.

    Returns:
        For models of 1 to all modes.

    Raises:
        ArgumentError: if the number of samples is none.
    """
    check_count("samples", samples)
    own = model.coefficients(points) * model.deviations
    drawn = np.random.default_rng(seed).standard_normal((samples, len(model.variances))) * model.deviations
    away = np.tile((own**2).sum(axis=1), (samples, 1))
    nearest = np.empty_like(drawn)
    for mode, (mine, theirs) in enumerate(zip(own.T, drawn.T, strict=True)):
        away += theirs[:, None] ** 2 - 2 * theirs[:, None] * mine
        nearest[:, mode] = away.min(axis=1)
    return Curve.of(np.sqrt(nearest.clip(0) / points.shape[1]))
