"""Turning over again what a smooth map between surfaces has turned over."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
from jaxtyping import Bool, Int

from homolog.transfer.smooth_map import SurfaceMap

_ROUNDS = 12
# After so many rounds each, patches around flipped triangles reach a ring farther.
_ROUNDS_PER_RING = 4


def untangled(smooth: SurfaceMap) -> SurfaceMap:
    """A map whose flipped triangles are fewer: around them points move towards the mean of their neighbours.

    Where a skin is put onto a surface it folds in creases and where parts touch. Most folds open once their points are
    evened out along the surface; what is left lies where the map itself is wrong, or either mesh is folded. All other
    points keep their places.

    Returns:
        The map with the fewest flipped triangles on the way; the very map that was given where none are, or are known.
    """
    best = now = smooth
    if smooth.flipped_triangles is None or smooth.start.surface is None:
        return smooth
    neighbours = _neighbours(smooth.start.surface.faces, smooth.start.shape.n_points)
    for turn in range(_ROUNDS):
        if not _count(now):
            break
        now = _evened(now, neighbours, rings=1 + turn // _ROUNDS_PER_RING)
        best = min(best, now, key=_count)
    return best


def _count(smooth: SurfaceMap) -> int:
    assert smooth.flipped_triangles is not None
    return int(smooth.flipped_triangles.sum())


def _neighbours(faces: Int[np.ndarray, "m 3"], count: int) -> sparse.csr_array:
    """(n, n): each point's neighbours, with equal weights that add up to one."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.unique(np.concatenate([ends, ends[:, ::-1]]), axis=0)
    weights = 1.0 / np.bincount(ends[:, 0], minlength=count)[ends[:, 0]]
    return sparse.csr_array((weights, ends.T), shape=(count, count))


def _evened(smooth: SurfaceMap, neighbours: sparse.csr_array, *, rings: int) -> SurfaceMap:
    repaired = smooth.start.repaired
    positions = smooth.positions[repaired.kept]
    evened = (positions + neighbours @ positions) / 2
    chosen = _around_flips(smooth, neighbours, rings)[:, None]
    # A point without a place has none to give, either.
    laid = np.where(chosen & np.isfinite(evened), evened, positions)
    return SurfaceMap(smooth.start, smooth.goal, repaired.to_original(laid, fill=np.nan), turned=smooth.turned)


def _around_flips(smooth: SurfaceMap, neighbours: sparse.csr_array, rings: int) -> Bool[np.ndarray, " n"]:
    assert smooth.start.surface is not None and smooth.flipped_triangles is not None
    chosen = np.zeros(smooth.start.shape.n_points, dtype=bool)
    chosen[smooth.start.surface.faces[smooth.flipped_triangles]] = True
    for _ in range(rings):
        chosen |= neighbours @ chosen.astype(float) > 0
    return chosen
