"""Rotations: those to try, how far two are apart, and the one that brings the points of two shapes together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache

import numpy as np
import torch
from jaxtyping import Float
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree
from scipy.spatial.transform import Rotation
from torch import Tensor

from homolog.core.arrays import takes_arrays
from homolog.core.errors import ArgumentError
from homolog.core.progress import Progress, ignore
from homolog.geometry import some_points

# Up to so many shapes each is compared with each, which takes some minutes; of more, each with so many landmarks.
_ALL_PAIRS, _LANDMARKS = 60, 20
# Points that tell where a start leads, and how many of the rotations that they lead to are followed to the end.
_FEW, _FOLLOWED = 200, 8


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
def rotation_angle(rotation: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch"]:
    """Angle of a rotation, or of each of several, in degrees, 0 to 180.

    Examples:
        >>> import torch
        >>> from homolog.maps import rotation_angle
        >>> float(rotation_angle(torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])))
        90.0
    """
    trace = rotation.diagonal(dim1=-2, dim2=-1).sum(dim=-1)
    return torch.rad2deg(torch.acos(((trace - 1) / 2).clamp(-1, 1)))


def distinct_rotations(rotations: Iterable[Float[Tensor, "3 3"]], *, degrees: float = 30.0) -> list[int]:
    """Which of several rotations are farther than so many degrees from all before them that are kept.

    Examples:
        >>> import torch
        >>> from homolog.maps import distinct_rotations
        >>> distinct_rotations([torch.eye(3), torch.eye(3)])
        [0]
    """
    if not (given := list(rotations)):
        return []
    stacked, kept = torch.stack(given), list[int]()
    apart = rotation_angle(stacked[:, None] @ stacked.mT) > degrees
    for number, are_apart in enumerate(apart.tolist()):
        if all(are_apart[other] for other in kept):
            kept.append(number)
    return kept


@takes_arrays
def best_rotation(
    points: Float[Tensor, "*batch n 3"],
    targets: Float[Tensor, "*batch n 3"],
    weights: Float[Tensor, "*batch n"] | None = None,
) -> Float[Tensor, "*batch 3 3"]:
    """The rotation R about both centres that takes ``points @ R.T`` nearest to ``targets``, in least squares.

    Kabsch, "A solution for the best rotation to relate two sets of vectors", Acta Crystallographica 1976.

    Args:
        points: positions (n, 3), or those of several problems at once (batch, n, 3).
        targets: where each of them belongs, likewise.
        weights: of each pair (n,) or (batch, n); by default all count alike.

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
    shares = (torch.ones_like(points[..., 0]) if weights is None else weights.to(points))[..., None]
    shares = shares / shares.sum(dim=-2, keepdim=True)
    start, end = (each - (shares * each).sum(dim=-2, keepdim=True) for each in (points, targets))
    left, _, right = torch.linalg.svd((shares * start).mT @ end)
    proper = torch.ones_like(left[..., 0])
    proper[..., 2] = torch.linalg.det(left @ right).sign()  # a reflection gives way along the weakest direction
    rotation: Tensor = (left * proper[..., None, :] @ right).mT
    return rotation


@takes_arrays
def principal_rotations(points_x: Float[Tensor, "n 3"], points_y: Float[Tensor, "m 3"]) -> Float[Tensor, "4 3 3"]:
    """The four rotations that take the principal axes of x to those of y.

    One of them is exact between two copies of one shape. Iterated closest points, which slide along a smooth shape,
    may stop beside it.

    Args:
        points_x: positions (n, 3).
        points_y: likewise (m, 3).

    Examples:
        >>> import torch
        >>> from homolog.maps import cube_rotations, principal_rotations
        >>> points = torch.rand(50, 3, generator=torch.Generator().manual_seed(0))
        >>> turn = cube_rotations()[5]
        >>> any(torch.allclose(found, turn, atol=1e-4) for found in principal_rotations(points, points @ turn.T))
        True
    """
    axes_x, axes_y = (_principal_axes(points) for points in (points_x, points_y))
    half_turns = torch.tensor([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]).to(axes_x)
    rotations: Tensor = axes_y @ torch.diag_embed(half_turns) @ axes_x.T
    return rotations


def _principal_axes(points: Float[Tensor, "n 3"]) -> Float[Tensor, "3 3"]:
    """As the columns of a rotation, that along which the points spread least first."""
    start = points - points.mean(dim=0)
    axes = torch.linalg.eigh(start.T @ start)[1]
    proper: Tensor = axes * torch.linalg.det(axes)
    return proper


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
        points_x: positions in random order, centred, of unit area (n, 3).
        points_y: likewise (m, 3).
        steps: from each start, after which those that came to the same are told apart.
        last_steps: of each rotation that is left.
        starts: rotations to begin with; by default ``cube_rotations()``. See ``principal_rotations`` for others.

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
    few_x, few_y = points_x[:_FEW], points_y[:_FEW]  # enough to tell where a start leads
    found = _ranked(_iterated(few_x, few_y, starts, steps))[:_FOLLOWED]
    return _ranked(_iterated(points_x, points_y, torch.stack([rotation for rotation, _ in found]), last_steps))


def _ranked(found: Iterable[tuple[Float[Tensor, "3 3"], float]]) -> list[tuple[Float[Tensor, "3 3"], float]]:
    """The best of those that are nearly alike, by misfit."""
    ranked = sorted(found, key=lambda item: item[1])
    return [ranked[number] for number in distinct_rotations(rotation for rotation, _ in ranked)]


def joint_rotations(
    points: Sequence[Float[Tensor, "n 3"]], *, progress: Progress = ignore
) -> list[tuple[Float[Tensor, "3 3"], float]]:
    """Rotations that bring several shapes to stand as their medoid does, with the misfit of each to its neighbour.

    Pairs of shapes are aligned as rigid bodies (``closest_point_rotations``), and the rotations are followed along the
    minimum spanning tree of the misfits, so that each shape is brought near one like it (Boyer et al., "A new fully
    automated approach for aligning and comparing shapes", The Anatomical Record 2015). Up to 60 shapes, each is
    compared with each, and the medoid is the shape of the least total misfit. Of more, each is compared with 20
    landmarks drawn from them, always the same ones, one of which is the medoid. A pair takes a tenth of a second.

    Args:
        points: of each shape, centred, of unit area (n, 3); 400 are enough.
        progress: called with the number of pairs that are done.

    Returns:
        For each shape the rotation R, at which ``points @ R.T`` stand as the medoid does, and the misfit to the shape
        that it was brought near: the root of the mean squared distances of closest points, of each shape's to the
        other's. The medoid has the identity and 0.

    Raises:
        ArgumentError: without shapes.

    Examples:
        >>> import torch
        >>> from homolog.maps import cube_rotations, joint_rotations, rotation_angle
        >>> points = torch.rand(50, 3, generator=torch.Generator().manual_seed(0))
        >>> points = points - points.mean(dim=0)
        >>> turns = cube_rotations()[[0, 7, 11]]
        >>> found = joint_rotations([points @ turn.T for turn in turns])
        >>> first = found[0][0] @ turns[0]  # which stands as all do now
        >>> [bool(rotation_angle(R @ turn @ first.T) < 1) for (R, _), turn in zip(found, turns)]
        [True, True, True]
    """
    if not points:
        raise ArgumentError("joint_rotations needs the points of a shape, but got none; give those of at least one")
    central = _landmarks(len(points))
    pairs = sorted({(max(i, j), min(i, j)) for i in range(len(points)) for j in central if i != j})
    misfits = np.full((len(points),) * 2, np.inf)
    np.fill_diagonal(misfits, 0.0)
    turns: dict[tuple[int, int], Tensor] = {}
    for done, (i, j) in enumerate(pairs, 1):
        turns[i, j], squared = closest_point_rotations(points[i], points[j])[0]
        turns[j, i] = turns[i, j].T
        misfits[i, j] = misfits[j, i] = squared**0.5
        progress(done, len(pairs), "aligning shapes")
    medoid = central[misfits[:, central].sum(axis=0).argmin()]
    found = {medoid: (torch.eye(3).to(points[0]), 0.0)}
    for child, parent in _spanning_tree(misfits, pairs, medoid):
        found[child] = found[parent][0] @ turns[child, parent], float(misfits[child, parent])
    return [found[number] for number in range(len(points))]


def _landmarks(count: int) -> list[int]:
    """The shapes with which all are compared."""
    if count <= _ALL_PAIRS:
        return list(range(count))
    drawn: list[int] = some_points(count, _LANDMARKS).tolist()
    return drawn


def _spanning_tree(
    misfits: Float[np.ndarray, "n n"], pairs: Sequence[tuple[int, int]], root: int
) -> Iterable[tuple[int, int]]:
    """Edges (child, parent) of the minimum spanning tree over the pairs that were compared, from the root on."""
    rows, columns = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    # To SciPy an edge of length zero is none; one more for every edge leaves the tree as it is.
    graph = csr_matrix((1 + misfits[rows, columns], (rows, columns)), shape=misfits.shape)
    order, parents = breadth_first_order(minimum_spanning_tree(graph), root, directed=False)
    return ((int(child), int(parents[child])) for child in order[1:])


def _iterated(
    x: Float[Tensor, "n 3"], y: Float[Tensor, "m 3"], rotations: Float[Tensor, "s 3 3"], steps: int
) -> list[tuple[Float[Tensor, "3 3"], float]]:
    """Iterated closest points from several starts at once, each until its pairs stay the same, with the misfits."""
    n, rotations = len(x), rotations.clone()
    moving = torch.arange(len(rotations), device=x.device)
    pairs = torch.full((len(rotations), n + len(y)), -1, device=x.device)
    for _ in range(steps):
        turned = x @ rotations[moving].mT
        distances = torch.cdist(turned, y).cpu().numpy()  # NumPy's argmin takes a tenth of PyTorch's time
        found = torch.cat([torch.from_numpy(distances.argmin(axis)).to(y.device) for axis in (2, 1)], dim=1)
        changed = (found != pairs[moving]).any(dim=1)
        moving, turned, found = moving[changed], turned[changed], found[changed]
        if not len(moving):
            break
        pairs[moving] = found
        points = torch.cat([turned, turned.take_along_dim(found[:, n:, None], dim=1)], dim=1)
        targets = torch.cat([y[found[:, :n]], y.expand(len(moving), -1, 3)], dim=1)
        rotations[moving] = best_rotation(points, targets) @ rotations[moving]
    last = torch.cdist(x @ rotations.mT, y)
    misfits = last.amin(dim=2).square().mean(dim=1) + last.amin(dim=1).square().mean(dim=1)
    return list(zip(rotations, misfits.tolist(), strict=True))
