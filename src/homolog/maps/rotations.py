"""Rotations: those to try, how far two are apart, and the one that brings the points of two shapes together."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from homolog.core.arrays import takes_arrays


@cache
def cube_rotations() -> Float[Tensor, "24 3 3"]:
    """The 24 rotations that take a cube to itself: no rotation is farther than 63 degrees from one of them.

    Examples:
        >>> from homolog.maps import cube_rotations
        >>> cube_rotations().shape
        torch.Size([24, 3, 3])
    """
    return torch.from_numpy(Rotation.create_group("O").as_matrix()).float()


@takes_arrays
def rotation_angle(rotation: Float[Tensor, "3 3"]) -> Float[Tensor, ""]:
    """Angle of a rotation in degrees, 0 to 180.

    Examples:
        >>> import torch
        >>> from homolog.maps import rotation_angle
        >>> float(rotation_angle(torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])))
        90.0
    """
    return torch.rad2deg(torch.acos(((rotation.trace() - 1) / 2).clamp(-1, 1)))


def distinct_rotations(rotations: Iterable[Float[Tensor, "3 3"]], *, degrees: float = 30.0) -> list[int]:
    """Which of several rotations are farther than so many degrees from all before them that are kept.

    Examples:
        >>> import torch
        >>> from homolog.maps import distinct_rotations
        >>> distinct_rotations([torch.eye(3), torch.eye(3)])
        [0]
    """
    kept: list[tuple[int, Tensor]] = []
    for number, rotation in enumerate(rotations):
        if all(rotation_angle(rotation @ other.T) > degrees for _, other in kept):
            kept.append((number, rotation))
    return [number for number, _ in kept]


@takes_arrays
def best_rotation(
    points: Float[Tensor, "n 3"], targets: Float[Tensor, "n 3"], weights: Float[Tensor, " n"] | None = None
) -> Float[Tensor, "3 3"]:
    """The rotation R about both centres that takes ``points @ R.T`` nearest to ``targets``, in least squares.

    Kabsch, "A solution for the best rotation to relate two sets of vectors", Acta Crystallographica 1976.

    Args:
        points: positions (n, 3).
        targets: where each of them belongs (n, 3).
        weights: of each pair (n,); by default all count alike.

    Examples:
        >>> import torch
        >>> from homolog.maps import best_rotation, cube_rotations
        >>> points = torch.rand(50, 3, generator=torch.Generator().manual_seed(0))
        >>> turn = cube_rotations()[5]
        >>> torch.allclose(best_rotation(points, points @ turn.T), turn, atol=1e-5)
        True

    See Also:
        ``rigid_motion``, which shifts as well, and bears outliers.
    """
    shares = (torch.ones_like(points[:, 0]) if weights is None else weights.to(points))[:, None]
    shares = shares / shares.sum()
    start, end = points - (shares * points).sum(dim=0), targets - (shares * targets).sum(dim=0)
    left, _, right = torch.linalg.svd((shares * start).T @ end)
    proper = torch.ones(3).to(points)
    proper[2] = torch.linalg.det(left @ right).sign()  # a reflection gives way along the weakest direction
    rotation: Tensor = (left * proper @ right).T
    return rotation


def closest_point_rotations(
    points_x: Float[Tensor, "n 3"],
    points_y: Float[Tensor, "m 3"],
    *,
    steps: int = 8,
    last_steps: int = 30,
    starts: Float[Tensor, "s 3 3"] | None = None,
) -> list[tuple[Float[Tensor, "3 3"], float]]:
    """Rotations about the centres that bring x near y as rigid bodies, the best first, each with its misfit.

    Iterated closest points (Besl and McKay, "A method for registration of 3-D shapes", 1992), both ways at once, from
    many starts, as Boyer et al. align bones and teeth ("A new fully automated approach for aligning and comparing
    shapes", The Anatomical Record 2015).

    Args:
        points_x: positions, centred, of unit area (n, 3).
        points_y: likewise (m, 3).
        steps: from each start, after which those that came to the same are told apart.
        last_steps: of each rotation that is left.
        starts: rotations to begin with; by default ``cube_rotations()``.

    Returns:
        Rotations R, at which ``points_x @ R.T`` lies near y, and the mean squared distances of closest points.

    Examples:
        >>> import torch
        >>> from homolog.maps import closest_point_rotations, cube_rotations
        >>> points = torch.rand(50, 3, generator=torch.Generator().manual_seed(0))
        >>> points = points - points.mean(dim=0)
        >>> rotation, misfit = closest_point_rotations(points, points @ cube_rotations()[7].T)[0]
        >>> torch.allclose(rotation, cube_rotations()[7], atol=1e-4)
        True
    """
    starts = cube_rotations().to(points_x) if starts is None else starts
    found = _ranked(_iterated(points_x, points_y, start, steps) for start in starts)
    return _ranked(_iterated(points_x, points_y, rotation, last_steps) for rotation, _ in found)


def _ranked(found: Iterable[tuple[Float[Tensor, "3 3"], float]]) -> list[tuple[Float[Tensor, "3 3"], float]]:
    """The best of those that are nearly alike, by misfit."""
    ranked = sorted(found, key=lambda item: item[1])
    return [ranked[number] for number in distinct_rotations(rotation for rotation, _ in ranked)]


def _iterated(
    x: Float[Tensor, "n 3"], y: Float[Tensor, "m 3"], rotation: Float[Tensor, "3 3"], steps: int
) -> tuple[Float[Tensor, "3 3"], float]:
    for _ in range(steps):
        turned = x @ rotation.T
        distances = torch.cdist(turned, y)
        forth, back = distances.argmin(dim=1), distances.argmin(dim=0)
        rotation = best_rotation(torch.cat([turned, turned[back]]), torch.cat([y[forth], y])) @ rotation
    distances = torch.cdist(x @ rotation.T, y)
    misfit = distances.amin(dim=1).square().mean() + distances.amin(dim=0).square().mean()
    return rotation, float(misfit)
