"""Untangling: fewer flipped triangles in a smooth map between surfaces, by local Laplacian smoothing."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
from jaxtyping import Bool, Int

from homolog.transfer.smooth_map import SurfaceMap

_ROUNDS = 12
# The smoothed patches around flipped triangles grow by one ring after this many rounds.
_ROUNDS_PER_RING = 4


def untangled(smooth: SurfaceMap) -> SurfaceMap:
    """Remove flipped triangles from a smooth map by Laplacian smoothing around them, on the target's surface.

    A template that is projected onto a surface folds in creases and where parts touch. Smoothing removes half to two
    thirds of these folds. Others remain where the map itself is wrong, or either mesh is folded. Points away from flips
    do not move. New here.

    Returns:
        The map with the fewest flipped triangles among all rounds; ``smooth`` itself if no triangle is flipped, or if
        flips are unknown because a shape is a cloud.

    Examples:
        >>> smooth = untangled(surface_map(source, target, match))  # doctest: +SKIP
    """
    best = now = smooth
    if smooth.flipped_triangles is None or smooth.source.surface is None:
        return smooth
    neighbours = _neighbours(smooth.source.surface.faces, smooth.source.shape.n_points)
    for number in range(_ROUNDS):
        if not _count(now):
            break
        now = _smoothed(now, neighbours, rings=1 + number // _ROUNDS_PER_RING)
        best = min(best, now, key=_count)
    return best


def _count(smooth: SurfaceMap) -> int:
    assert smooth.flipped_triangles is not None
    return int(smooth.flipped_triangles.sum())


def _neighbours(faces: Int[np.ndarray, "m 3"], count: int) -> sparse.csr_array:
    """The row-normalised adjacency matrix (n, n) of the edges."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.unique(np.concatenate([ends, ends[:, ::-1]]), axis=0)
    weights = 1.0 / np.bincount(ends[:, 0], minlength=count)[ends[:, 0]]
    return sparse.csr_array((weights, ends.T), shape=(count, count))


def _smoothed(smooth: SurfaceMap, neighbours: sparse.csr_array, *, rings: int) -> SurfaceMap:
    repaired = smooth.source.repaired
    positions = smooth.positions[repaired.kept]
    smoothed = (positions + neighbours @ positions) / 2
    chosen = _around_flips(smooth, neighbours, rings)[:, None]
    # A mean that includes a point without a counterpart is NaN, and is left out.
    moved = np.where(chosen & np.isfinite(smoothed), smoothed, positions)
    deformed = repaired.to_original(moved, fill=np.nan)
    return SurfaceMap(smooth.source, smooth.target, deformed, orientation=smooth.orientation, extended=smooth.extended)


def _around_flips(smooth: SurfaceMap, neighbours: sparse.csr_array, rings: int) -> Bool[np.ndarray, " n"]:
    assert smooth.source.surface is not None and smooth.flipped_triangles is not None
    chosen = np.zeros(smooth.source.shape.n_points, dtype=bool)
    chosen[smooth.source.surface.faces[smooth.flipped_triangles]] = True
    for _ in range(rings):
        chosen |= neighbours @ chosen.astype(float) > 0
    return chosen
