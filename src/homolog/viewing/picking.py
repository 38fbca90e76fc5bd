"""What a ray meets: a corner of a surface, or a point of a cloud."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

# A point counts for as wide as so many spacings, so that rays find clouds between their points, too.
_WIDTH = 1.0
# Barycentric weights may be so far below zero: a ray through an edge meets a triangle.
_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Ray:
    """A half-line, and how fast it widens.

    Args:
        origin: where it begins (3,).
        direction: where it leads (3,), of length one.
        slope: how far from it a point may lie, per unit of distance from its origin: what a few pixels are there.
    """

    origin: Float[np.ndarray, " 3"]
    direction: Float[np.ndarray, " 3"]
    slope: float = 0.0


@dataclass(frozen=True)
class Hit:
    """A point that was met, and how far along the ray."""

    point: int
    depth: float


def hit_surface(points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], ray: Ray) -> Hit | None:
    """The corner nearest, by weight, to where a ray first meets a surface, from either side.

    All triangles are tried at once: T. Moeller and B. Trumbore, "Fast, Minimum Storage Ray/Triangle Intersection"
    (1997).
    """
    first, second, third = points[faces].transpose(1, 0, 2)
    along, across = second - first, third - first
    normal = np.cross(ray.direction, across)
    determinant = np.einsum("ij,ij->i", along, normal)
    start = ray.origin - first
    lever = np.cross(start, along)
    with np.errstate(divide="ignore", invalid="ignore"):  # of triangles that the ray is parallel to
        u = np.einsum("ij,ij->i", start, normal) / determinant
        v = lever @ ray.direction / determinant
        depth = np.einsum("ij,ij->i", across, lever) / determinant
        weights = np.stack([1 - u - v, u, v], axis=1)
    met = np.flatnonzero((weights >= -_TOLERANCE).all(axis=1) & (depth > 0))
    if not len(met):
        return None
    nearest = met[depth[met].argmin()]
    return Hit(int(faces[nearest, weights[nearest].argmax()]), float(depth[nearest]))


def hit_points(
    points: Float[np.ndarray, "n 3"], shown: Bool[np.ndarray, " n"], ray: Ray, spacing: float, *, before: float = np.inf
) -> Hit | None:
    """The shown point nearest to a ray, among the first ones that it passes.

    Args:
        points: of a cloud, or of a mesh that is drawn as points.
        shown: which of them count.
        ray: passes a point where that is nearer than the spacing, or than the ray has widened to.
        spacing: typical distance between points; what lies so much deeper than the first still counts.
        before: how far along the ray something hides all points.
    """
    relative = points - ray.origin
    depth = relative @ ray.direction
    gap = np.linalg.norm(relative - depth[:, None] * ray.direction, axis=1)
    reach = np.maximum(_WIDTH * spacing, ray.slope * depth)
    passed = np.flatnonzero(shown & (depth > 0) & (gap <= reach) & (depth <= before + reach))
    if not len(passed):
        return None
    first = passed[depth[passed].argmin()]
    front = passed[depth[passed] <= depth[first] + 2 * reach[first]]
    nearest = front[gap[front].argmin()]
    return Hit(int(nearest), float(depth[nearest]))
