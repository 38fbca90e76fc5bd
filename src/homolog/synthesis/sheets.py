"""Closed meshes that touch themselves: their sheets taken apart, so that every edge has two triangles."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

from homolog.core.errors import ShapeError
from homolog.geometry.surface import Surface, unit
from homolog.shapes.topology import components, half_edges


def separated_sheets(surface: Surface, name: str = "the mesh") -> tuple[Surface, Int[np.ndarray, " n"]]:
    """Take a closed mesh apart where it touches itself: points and edges that several sheets share become several.

    Of the triangles around a crowded edge those are joined that have the inside of the shape between them: a hand that
    lies on a thigh stays a hand. New here.

    Args:
        surface: every edge must have as many triangles that run along it one way as the other.
        name: for messages.

    Returns:
        The closed manifold mesh with the same triangles in the same order, and for each of its vertices the one that it
        is a copy of.

    Raises:
        ShapeError: if the mesh has a boundary, or its triangles are not turned alike.

    Examples:
        >>> import numpy as np
        >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [-1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
        >>> one = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
        >>> other = np.array([[0, 4, 5], [0, 6, 4], [0, 5, 6], [4, 6, 5]])
        >>> apart, copies = separated_sheets(Surface(corners, np.concatenate([one, other])))
        >>> len(corners), len(apart.vertices)  # they touched in a point
        (7, 8)
    """
    faces = surface.faces
    start, end = half_edges(faces).T
    forward = start < end
    key = np.where(forward, start * len(surface.vertices) + end, end * len(surface.vertices) + start)
    edges, edge, n_triangles = np.unique(key, return_inverse=True, return_counts=True)
    if (np.bincount(edge, forward, len(edges)) * 2 != n_triangles).any():
        raise ShapeError(
            f"{name} has a boundary, or triangles that are not turned alike, but must be closed; "
            "close it, as homolog reconstruct does"
        )
    order = np.lexsort((forward, edge))
    (plain,) = np.nonzero(n_triangles[edge[order]] == 2)
    crowded = np.flatnonzero(n_triangles > 2)
    partners = [
        order[plain].reshape(-1, 2),
        *(_joined_inside(surface, np.flatnonzero(edge == each), forward) for each in crowded),
    ]
    one, other = np.concatenate(partners).T
    corner = np.arange(faces.size).reshape(faces.shape)
    following = corner[:, [1, 2, 0]].ravel()  # side i runs from corner i to the following one
    fan = components(np.concatenate([one, following[one]]), np.concatenate([following[other], other]), faces.size)
    _, first, new = np.unique(start * faces.size + fan, return_index=True, return_inverse=True)
    copies = start[first]
    return Surface(surface.vertices[copies], new.reshape(-1, 3)), copies


def _joined_inside(
    surface: Surface, sides: Int[np.ndarray, " k"], forward: Int[np.ndarray, " s"]
) -> Int[np.ndarray, "h 2"]:
    """Pairs of the triangles' sides along one edge that have the inside between them.

    Around the edge, the inside begins behind a triangle that runs along it backward, and ends at one that runs forward.
    """
    corners = surface.faces.ravel()
    along = next(side for side in sides if forward[side])
    triangle, place = divmod(along, 3)
    a, b = corners[along], surface.faces[triangle, (place + 1) % 3]
    axis = unit((surface.vertices[b] - surface.vertices[a])[None])[0]
    opposite = surface.vertices[surface.faces[sides // 3, (sides % 3 + 2) % 3]] - surface.vertices[a]
    right = unit(np.cross(axis, opposite[0])[None])[0]
    angles = np.arctan2(opposite @ right, opposite @ np.cross(right, axis))
    around = sides[np.argsort(angles, kind="stable")]
    begins = next(i for i in range(len(around)) if not forward[around[i]])
    pairs, open_ones, left = [], list[int](), list[int]()
    for side in np.roll(around, -begins):
        if not forward[side]:
            open_ones.append(side)
        elif open_ones:
            pairs.append((open_ones.pop(), side))
        else:  # sheets that pass through each other
            left.append(side)
    return np.array([*pairs, *zip(open_ones, left, strict=True)])
