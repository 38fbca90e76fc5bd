"""Points whose mirror partners are known: the mirror plane, and symmetric and asymmetric components."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from homolog.core.errors import ArgumentError
from homolog.statistics.alignment import generalised_procrustes

FEWEST_PAIRS = 3
"""No mirror plane is found from fewer points with partners."""
# A pair that misses by so many times the median distance counts a quarter; what is below _NEAR of the coordinates is 0.
_FAR, _NEAR = 2.0, 1e-9
# Rounds end once no weight changes by more.
_ROUNDS, _STEADY = 50, 1e-4


@dataclass(frozen=True, eq=False)
class MirrorPlane:
    """A plane that points are reflected in: all x with ``normal @ x = offset``.

    Args:
        normal: of unit length (3,).
        offset: signed distance of the plane from the origin, along the normal.

    Examples:
        >>> plane = MirrorPlane(np.array([1.0, 0, 0]), 2.0)
        >>> plane.reflected(np.array([[0.0, 5, 6]])).tolist(), plane.distances(np.array([[0.0, 5, 6]])).tolist()
        ([[4.0, 5.0, 6.0]], [-2.0])
    """

    normal: Float[np.ndarray, " 3"]
    offset: float = 0.0

    def distances(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Signed distances of points from the plane, positive on the side of the normal (n,)."""
        return np.asarray(points @ self.normal - self.offset)

    def reflected(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """The mirror images of points (n, 3)."""
        return np.asarray(points - 2 * np.outer(self.distances(points), self.normal))


def best_mirror_plane(
    points: Float[np.ndarray, "n 3"],
    partners: Float[np.ndarray, "n 3"],
    weights: Float[np.ndarray, " n"] | None = None,
) -> MirrorPlane:
    """The plane whose reflection takes points to their partners best, however far a part of them is off.

    Least squares with the robust weights of Geman and McClure, from all points alike: a pair that misses by twice the
    median distance counts a quarter. So a plane stays where most of a shape is symmetric, and a bump on one side does
    not turn it. The largest component of the normal is positive.

    Args:
        points: positions (n, 3), at least three.
        partners: the position of each point's partner (n, 3).
        weights: how much each pair counts, from 0 (n,); by default all alike.

    Raises:
        ArgumentError: if there are too few pairs, or what is given does not fit or is not finite.

    Examples:
        >>> points = np.random.default_rng(0).normal(size=(50, 3))
        >>> plane = best_mirror_plane(points, points * [1, 1, -1] + [0, 0, 6])
        >>> (np.abs(plane.normal).round(6) + 0).tolist(), round(plane.offset, 6)
        ([0.0, 0.0, 1.0], 3.0)
    """
    weights = np.ones(len(points)) if weights is None else weights
    if points.ndim != 2 or points.shape[1:] != (3,) or len(points) < FEWEST_PAIRS or partners.shape != points.shape:
        raise ArgumentError(
            f"points and partners have shapes {points.shape} and {partners.shape}, but must both have shape (n, 3), "
            f"with at least {FEWEST_PAIRS} pairs"
        )
    if weights.shape != (len(points),) or not (weights >= 0).all() or not weights.any():
        raise ArgumentError("weights must be one number for each pair, none negative and not all zero")
    if not (np.isfinite(points).all() and np.isfinite(partners).all() and np.isfinite(weights).all()):
        raise ArgumentError("points, partners and weights hold NaN or infinite numbers, but must be finite")
    plane, trust = _fitted(points, partners, weights), np.ones(len(points))
    for _ in range(_ROUNDS):
        away = np.linalg.norm(plane.reflected(points) - partners, axis=1)
        before, trust = trust, 1 / (1 + (away / max(_FAR * np.median(away), _NEAR * np.abs(points).max())) ** 2) ** 2
        plane = _fitted(points, partners, weights * trust)
        if np.abs(trust - before).max() < _STEADY:
            break
    return plane


def _fitted(
    points: Float[np.ndarray, "n 3"], partners: Float[np.ndarray, "n 3"], weights: Float[np.ndarray, " n"]
) -> MirrorPlane:
    """The plane of least squares, through the mean of all points and partners."""
    centre = np.average(points + partners, axis=0, weights=weights) / 2
    normal = mirror_normal(points - centre, partners - centre, weights)
    normal = normal if normal[np.abs(normal).argmax()] > 0 else -normal
    return MirrorPlane(normal, float(centre @ normal))


def mirror_normal(
    points: Float[np.ndarray, "n 3"],
    images: Float[np.ndarray, "n 3"],
    weights: Float[np.ndarray, " n"] | None = None,
) -> Float[np.ndarray, " 3"]:
    """The unit normal of the plane through the origin whose reflection takes points to their images best (3,).

    It minimises the sum of (p . n)(q . n) over points p and images q: the eigenvector of the least eigenvalue of the
    symmetric part of their covariance.

    Args:
        points: positions (n, 3).
        images: of each (n, 3).
        weights: of each pair (n,).

    Examples:
        >>> np.abs(mirror_normal(np.array([[1.0, 2, 0], [3, -1, 1]]), np.array([[-1.0, 2, 0], [-3, -1, 1]]))).round(6)
        array([1., 0., 0.])
    """
    products = points.T @ (images if weights is None else images * weights[:, None])
    return np.asarray(np.linalg.eigh(products + products.T)[1][:, 0])


@dataclass(frozen=True, eq=False)
class SymmetricComponents:
    """Shapes taken apart: ``symmetric + asymmetric`` are the aligned shapes.

    Args:
        symmetric: the mean of each shape and its mirror image in the same numbering (s, n, 3).
        asymmetric: half the difference of the two (s, n, 3).
    """

    symmetric: Float[np.ndarray, "s n 3"]
    asymmetric: Float[np.ndarray, "s n 3"]

    @property
    def directional(self) -> Float[np.ndarray, "n 3"]:
        """Directional asymmetry: what of it all shapes have in common (n, 3)."""
        return np.asarray(self.asymmetric.mean(axis=0))

    @property
    def amounts(self) -> Float[np.ndarray, " s"]:
        """How asymmetric each shape is: the root mean square of its asymmetric part, in the shapes' unit (s,)."""
        return np.asarray(np.sqrt((self.asymmetric**2).sum(axis=2).mean(axis=1)))

    def variances(self) -> dict[str, float]:
        """Mean squares per shape, summed over points: how shapes differ, and in which way they are asymmetric.

        ``symmetric`` is the variation among the symmetric shapes, ``directional`` the asymmetry that all have in
        common, ``fluctuating`` what is left of it in each shape. The first and the last are divided by s - 1.
        """
        others = max(len(self.symmetric) - 1, 1)
        return {
            "symmetric": float(((self.symmetric - self.symmetric.mean(axis=0)) ** 2).sum() / others),
            "directional": float((self.directional**2).sum()),
            "fluctuating": float(((self.asymmetric - self.directional) ** 2).sum() / others),
        }


def symmetric_components(
    points: Float[np.ndarray, "s n 3"], partners: Float[np.ndarray, "s n 3"], *, scale: bool = False
) -> SymmetricComponents:
    """Symmetric and asymmetric components of shapes in correspondence, of which each is symmetric in itself.

    Klingenberg, Barluenga and Meyer, "Shape analysis of symmetric structures: quantifying variation among individuals
    and asymmetry", Evolution 56, 2002. All shapes and their mirror images, whose points have the numbers of their
    partners, are aligned together by generalised Procrustes.

    Args:
        points: the shapes (s, n, 3).
        partners: on each shape the position of each point's mirror partner (s, n, 3).
        scale: normalise the size as well.

    Raises:
        ArgumentError: if the arrays do not fit, or are none that can be aligned.

    Examples:
        >>> left = np.random.default_rng(0).normal(size=(1, 5, 3))
        >>> right = left * [-1, 1, 1]
        >>> found = symmetric_components(np.concatenate([left, right], axis=1), np.concatenate([right, left], axis=1))
        >>> found.symmetric.shape, bool(found.amounts[0] < 1e-9)
        ((1, 10, 3), True)
    """
    if points.shape != partners.shape:
        raise ArgumentError(f"partners have shape {partners.shape}, but must have that of the points, {points.shape}")
    # Which plane they are reflected in does not matter, as they are aligned anew.
    aligned = generalised_procrustes(np.concatenate([points, partners * np.array([-1.0, 1, 1])]), scale=scale)
    own, reflected = aligned.points[: len(points)], aligned.points[len(points) :]
    return SymmetricComponents((own + reflected) / 2, (own - reflected) / 2)
