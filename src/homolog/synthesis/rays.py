"""Ray casting from one centre: the first triangle that each ray hits, and the visibility of points.

Triangles are projected to the image, where a ray is a point. A grid of cells finds the rays in a triangle's bounding
box; the signs of three volumes tell which of them hit it. There is no tree and no tolerance: a ray through an edge hits
both of its triangles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from homolog.geometry.grouping import runs

# Cells along each side of the image per square root of the number of triangles, and at most.
_CELLS, _MOST_CELLS = 2.0, 1024
# What lies deeper than the first hit by less than this share of its depth is that hit, but for rounding.
_SAME_DEPTH = 1e-6


@dataclass(frozen=True, eq=False)
class Hits:
    """The first hits of rays.

    Args:
        triangles: index of the triangle that each ray hits first (r,), the lowest of several at one depth; -1 for none.
        weights: barycentric coordinates of the hit (r, 3); zero for none.
        depths: along the viewing direction (r,); infinite for none.
    """

    triangles: Int[np.ndarray, " r"]
    weights: Float[np.ndarray, "r 3"]
    depths: Float[np.ndarray, " r"]


def first_hits(corners: Float[np.ndarray, "m 3 3"], image: Float[np.ndarray, "r 2"]) -> Hits:
    """The first triangle that each ray from the origin through (u, v, 1) hits, from either side.

    Triangles seen edge-on, and triangles without area, are not hit.

    Args:
        corners: of each triangle, in camera coordinates, of which the third is the depth; all depths are positive.
        image: u and v of each ray.

    Examples:
        >>> triangle = np.array([[[-1.0, -1, 2], [1, -1, 2], [0, 1, 2]]])
        >>> hits = first_hits(triangle, np.array([[0.0, 0.0], [5.0, 5.0]]))
        >>> hits.triangles.tolist(), hits.depths.tolist()
        ([0, -1], [2.0, inf])
    """
    rays, triangles = _candidates(image, corners[:, :, :2] / corners[:, :, 2:])
    volumes = _volumes(corners, image, rays, triangles)
    met = ((volumes >= 0).all(axis=1) | (volumes <= 0).all(axis=1)) & (volumes != 0).any(axis=1)
    rays, triangles, volumes = rays[met], triangles[met], volumes[met]
    weights = volumes / volumes.sum(axis=1, keepdims=True)
    depths = np.einsum("hk,hk->h", weights, corners[triangles, :, 2])
    # The first hit of each ray; the earliest of those at one depth.
    order = np.lexsort((depths, rays))
    first = order[np.flatnonzero(np.diff(rays[order], prepend=-1))]
    hits = Hits(np.full(len(image), -1), np.zeros((len(image), 3)), np.full(len(image), np.inf))
    of = rays[first]
    hits.triangles[of], hits.weights[of], hits.depths[of] = triangles[first], weights[first], depths[first]
    return hits


def visible(corners: Float[np.ndarray, "m 3 3"], points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Which points are visible from the origin: no triangle lies in front of them. Points may lie on triangles."""
    hits = first_hits(corners, points[:, :2] / points[:, 2:])
    found: np.ndarray = points[:, 2] <= hits.depths * (1 + _SAME_DEPTH)
    return found


def _candidates(
    image: Float[np.ndarray, "r 2"], outlines: Float[np.ndarray, "m 3 2"]
) -> tuple[Int[np.ndarray, " c"], Int[np.ndarray, " c"]]:
    """Pairs of a ray and a triangle whose bounding box is near it, ordered by triangle."""
    low, high = outlines.min(axis=1), outlines.max(axis=1)
    origin, corner = low.min(axis=0), high.max(axis=0)
    n = min(int(_CELLS * np.sqrt(len(outlines))) + 1, _MOST_CELLS)
    scale = n / np.maximum(corner - origin, np.finfo(float).tiny)

    def cell(at: Float[np.ndarray, "k 2"]) -> Int[np.ndarray, "k 2"]:
        cells: np.ndarray = np.clip((at - origin) * scale, 0, n - 1).astype(np.int64)
        return cells

    (inside,) = np.nonzero(((image >= origin) & (image <= corner)).all(axis=1))
    number = cell(image[inside]) @ [1, n]
    by_cell = inside[np.argsort(number, kind="stable")]
    # The rays in cells next to each other in a row lie next to each other in `by_cell`.
    starts = np.searchsorted(np.sort(number), np.arange(n * n + 1))
    first, last = cell(low), cell(high)
    triangle, row = runs(last[:, 1] - first[:, 1] + 1)
    row = n * (row + first[triangle, 1])
    begin, end = starts[row + first[triangle, 0]], starts[row + last[triangle, 0] + 1]
    run, offset = runs(end - begin)
    return by_cell[begin[run] + offset], triangle[run]


def _volumes(
    corners: Float[np.ndarray, "m 3 3"],
    image: Float[np.ndarray, "r 2"],
    rays: Int[np.ndarray, " c"],
    triangles: Int[np.ndarray, " c"],
) -> Float[np.ndarray, "c 3"]:
    """Six times the volume between the ray and each edge: of one sign where the ray meets the triangle.

    Two triangles see an edge from opposite ends, and find exactly opposite numbers: no ray slips through between.
    Corners are sheared to the ray first, alike for all triangles around one, so that no ray slips through there either
    (Woop et al., "Watertight ray/triangle intersection", Journal of Computer Graphics Techniques 2013).
    """
    x, y = (corners[triangles, :, axis] - image[rays, axis, None] * corners[triangles, :, 2] for axis in (0, 1))
    volumes = np.empty((len(rays), 3))
    for corner in range(3):
        begin, end = corner - 2, corner - 1
        volumes[:, corner] = x[:, begin] * y[:, end] - y[:, begin] * x[:, end]
    return volumes
