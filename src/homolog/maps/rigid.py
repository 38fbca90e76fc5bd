"""Rigid and similarity alignment: the rotation, size and shift that best take points to their targets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from homolog.core.arrays import takes_arrays
from homolog.maps.rotations import best_rotation

# Residuals of a perfect fit are zero, which could not be divided by.
_LEAST_RESIDUAL = 1e-6


@dataclass(frozen=True, eq=False)
class Similarity:
    """A similarity transform: positions p go to ``scale * p @ rotation.T + shift``.

    Args:
        rotation: (3, 3).
        scale: what lengths are multiplied by.
        shift: (3,).

    Examples:
        >>> import torch
        >>> from homolog.maps import Similarity
        >>> twice = Similarity(torch.eye(3), 2.0, torch.ones(3))
        >>> twice(torch.tensor([[1.0, 2, 3]]))
        tensor([[3., 5., 7.]])
        >>> twice.inverse()(twice(torch.tensor([[1.0, 2, 3]])))
        tensor([[1., 2., 3.]])
    """

    rotation: Float[Tensor, "3 3"]
    scale: float
    shift: Float[Tensor, " 3"]

    def __call__(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """Where positions go."""
        return self.scale * points @ self.rotation.T + self.shift

    def inverse(self) -> Similarity:
        """The way back."""
        return Similarity(self.rotation.T, 1 / self.scale, -self.shift @ self.rotation / self.scale)

    def to(self, like: Tensor) -> Similarity:
        """The same in the precision and on the device of a tensor."""
        return Similarity(self.rotation.to(like), self.scale, self.shift.to(like))


def best_similarity(
    points: Float[Tensor, "n 3"], targets: Float[Tensor, "n 3"], weights: Float[Tensor, " n"] | None = None
) -> Similarity:
    """The similarity transform that takes points nearest to their targets, in least squares.

    Umeyama, "Least-squares estimation of transformation parameters between two point patterns", 1991.

    Args:
        points: positions (n, 3).
        targets: where each of them belongs (n, 3).
        weights: of each pair (n,); by default all count alike.

    Examples:
        >>> import torch
        >>> from homolog.maps import best_similarity
        >>> points = torch.rand(50, 3, generator=torch.Generator().manual_seed(0))
        >>> round(best_similarity(points, 3 * points + 1).scale, 4)
        3.0
    """
    weights = torch.ones_like(points[:, 0]) if weights is None else weights.to(points)
    rotation, middle, target = _least_squares(points, targets, weights)
    turned, wanted = (points - middle) @ rotation.T, targets - target
    scale = (weights @ (turned * wanted)).sum() / (weights @ turned.square()).sum()
    return Similarity(rotation, float(scale), target - scale * rotation @ middle)


def composed(second: Similarity, first: Similarity) -> Similarity:
    """First one similarity transform, then the other.

    Examples:
        >>> import torch
        >>> from homolog.maps import Similarity, composed
        >>> twice, moved = Similarity(torch.eye(3), 2.0, torch.zeros(3)), Similarity(torch.eye(3), 1.0, torch.ones(3))
        >>> composed(twice, moved)(torch.zeros(1, 3))
        tensor([[2., 2., 2.]])
    """
    rotation, scale = second.rotation @ first.rotation, second.scale * first.scale
    return Similarity(rotation, scale, second(first.shift[None])[0])


@takes_arrays
def closest_point_similarity(
    points_x: Float[Tensor, "n 3"],
    points_y: Float[Tensor, "m 3"],
    *,
    normals_x: Float[Tensor, "n 3"] | None = None,
    normals_y: Float[Tensor, "m 3"] | None = None,
    start: Similarity | None = None,
    kept: float = 0.9,
    steps: int = 50,
) -> Similarity:
    """The similarity transform that brings most of x nearest to y, from a start that is nearly right.

    Trimmed iterated closest points (Chetverikov, Stepanov and Krsek, "Robust Euclidean alignment of 3D point sets: the
    trimmed iterative closest point algorithm", Image and Vision Computing 2005), both ways at once: the farthest pairs
    are left out, so that what one shape has and the other has not neither shifts nor scales it.

    Args:
        points_x: positions, which count alike: draw them by area from shapes of unlike sampling (n, 3).
        points_y: likewise (m, 3).
        normals_x: at each point of x, as long as weighs against distances: of counterparts, their differences count as
            those of positions do, in the units of y (n, 3). By default none.
        normals_y: likewise (m, 3); both or none.
        start: where x begins; by default where it is.
        kept: share of the pairs that count, above 0 and up to 1.
        steps: at most so many; it ends where closest points stay the same.

    Examples:
        >>> import torch
        >>> from homolog.maps import Similarity, closest_point_similarity
        >>> points = torch.rand(200, 3, generator=torch.Generator().manual_seed(0))
        >>> whole = 1.02 * points + 0.01
        >>> found = closest_point_similarity(points[:190], whole)
        >>> round(found.scale, 3), torch.allclose(found(points), whole, atol=1e-4)
        (1.02, True)

    See Also:
        ``closest_point_rotations`` for shapes that may stand any way round.
    """
    x, y = points_x.double(), points_y.double()
    across_x = torch.zeros_like(x) if normals_x is None else normals_x.to(x)
    across_y = torch.zeros_like(y) if normals_y is None else normals_y.to(y)
    found = (start or Similarity(torch.eye(3), 1.0, torch.zeros(3))).to(x)
    in_y, before = torch.cat([y, across_y], dim=1).cpu().numpy(), np.empty((2, 0))
    for _ in range(steps):
        moved = torch.cat([found(x), across_x @ found.rotation.T], dim=1)
        pairs, distances = _closest_pairs(moved.cpu().numpy(), in_y)
        if np.array_equal(pairs, before):
            break
        chosen = pairs[:, distances <= np.quantile(distances, kept)]
        found, before = best_similarity(x[chosen[0]], y[chosen[1]]), pairs
    return found.to(points_x)


def _closest_pairs(
    x: Float[np.ndarray, "n d"], y: Float[np.ndarray, "m d"]
) -> tuple[Int[np.ndarray, "2 p"], Float[np.ndarray, " p"]]:
    """For each point of either the nearest of the other: indices into x and y, and the distances."""
    (there, on_y), (back, on_x) = KDTree(y).query(x, workers=-1), KDTree(x).query(y, workers=-1)
    pairs = np.stack([np.append(np.arange(len(x)), on_x), np.append(on_y, np.arange(len(y)))])
    return pairs, np.append(there, back)


@takes_arrays
def rigid_motion(
    points: Float[Tensor, "*batch n 3"],
    targets: Float[Tensor, "*batch n 3"],
    *,
    weights: Float[Tensor, "*batch n"] | None = None,
    rounds: int = 15,
) -> tuple[Float[Tensor, "*batch 3 3"], Float[Tensor, "*batch 3"]]:
    """Robust Kabsch alignment: the rotation R and shift t with ``points @ R.T + t`` near the targets, despite outliers.

    Least squares (Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976), repeated with each
    pair weighted by Cauchy's function of its residual, in units of the median residual (iteratively reweighted least
    squares). A reflection is never returned.

    Args:
        points: positions (n, 3), or those of several problems at once (batch, n, 3).
        targets: where each of them belongs, likewise.
        weights: of each pair (n,) or (batch, n), by which its weight from the residual is multiplied; by default 1.
        rounds: how often weights are computed anew, at least 0, which is plain least squares; 5 to 30 are sensible.

    Returns:
        R (3, 3) and t (3,), or those of each problem.

    Examples:
        >>> import torch
        >>> from homolog.maps import rigid_motion
        >>> points = torch.rand(50, 3, generator=torch.Generator().manual_seed(0))
        >>> turn = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
        >>> targets = points @ turn.T + 2
        >>> targets[:10] = 0  # outliers
        >>> rotation, shift = rigid_motion(points, targets)
        >>> torch.allclose(rotation, turn, atol=1e-4), torch.allclose(shift, torch.tensor(2.0), atol=1e-4)
        (True, True)
    """
    start, end = points.double(), targets.double()
    given = torch.ones_like(start[..., 0]) if weights is None else weights.to(start)
    trust = given
    for _ in range(rounds):
        rotation, middle, target = _least_squares(start, end, trust)
        residuals = ((start - middle[..., None, :]) @ rotation.mT + target[..., None, :] - end).norm(dim=-1)
        scale = residuals.median(dim=-1, keepdim=True).values.clamp(min=_LEAST_RESIDUAL)
        trust = given / (1 + (residuals / scale) ** 2)
    rotation, middle, target = _least_squares(start, end, trust)
    return rotation.to(points), (target - (rotation @ middle[..., None])[..., 0]).to(points)


def _least_squares(
    points: Float[Tensor, "*batch n 3"], targets: Float[Tensor, "*batch n 3"], weights: Float[Tensor, "*batch n"]
) -> tuple[Float[Tensor, "*batch 3 3"], Float[Tensor, "*batch 3"], Float[Tensor, "*batch 3"]]:
    """The best rotation about the centres of both, and these centres."""
    shares = (weights / weights.sum(dim=-1, keepdim=True))[..., None, :]
    return best_rotation(points, targets, weights), (shares @ points)[..., 0, :], (shares @ targets)[..., 0, :]
