"""Parts of meshes as scanners and museums know them: a plane cuts much away, or holes are eaten into the surface."""

from __future__ import annotations

from bisect import bisect_left

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike
from scipy.sparse.csgraph import dijkstra

from homolog.core.arguments import is_count
from homolog.core.errors import bad_value
from homolog.geometry import edge_graph, surface_area
from homolog.shapes import Shape, face_areas
from homolog.synthesis.drawing import Range, check_range, drawn, drawn_count, drawn_direction, given_direction
from homolog.synthesis.part import Part, largest_piece, mesh_faces, part_of_faces

_CUT_ADVICE = "cut less away, or take a finer mesh"
_HOLES_ADVICE = "make fewer or smaller holes, or take a finer mesh"


def cut(shape: Shape, *, removed: Range = (0.3, 0.6), normal: ArrayLike | None = None, seed: int) -> Part:
    """Let a plane cut a large part of a mesh away; the largest connected piece beyond the plane is left.

    The plane lies as far on as it can while that piece still has the asked share of the area. Faces that the plane
    crosses go. Rodola et al., "Partial functional correspondence", 2017, test on such parts.

    Args:
        shape: a clean mesh; not changed.
        removed: share of the surface that is lost, or the range from which it is drawn.
        normal: the direction in which what is left lies, of any length; drawn by default.
        seed: of all that is drawn.

    Raises:
        ArgumentError: if ``removed`` is not from 0 to below 1, or ``normal`` no direction.
        ShapeError: if the shape is a cloud or needs repair, or next to nothing is left.
    """
    check_range("removed", removed, lambda share: 0 <= share < 1, "a number from 0 to below 1")
    random = np.random.default_rng(seed)
    direction = drawn_direction(random) if normal is None else given_direction("normal", normal)
    wanted = 1 - drawn(removed, random)
    faces, areas = mesh_faces(shape), face_areas(shape.points, shape.faces)  # type: ignore[arg-type]
    heights = (shape.points @ direction)[faces].min(axis=1)

    def left_above(height: float) -> Bool[np.ndarray, " m"]:
        return largest_piece(shape, heights >= height)

    descending = np.sort(heights)[::-1]
    place = bisect_left(descending, wanted * areas.sum(), key=lambda height: areas[left_above(height)].sum())
    return part_of_faces(shape, left_above(descending[min(place, len(faces) - 1)]), advice=_CUT_ADVICE)


def cut_holes(shape: Shape, *, holes: int | tuple[int, int] = (5, 20), radius: Range = (0.03, 0.08), seed: int) -> Part:
    """Take many geodesic discs out of a mesh; the largest connected piece of what remains is left.

    Centres are points of the mesh, each as likely; all points nearer to one than its radius go, measured along the
    edges, and all faces at them.

    Args:
        shape: a clean mesh; not changed.
        holes: how many discs, or the range from which the number is drawn; discs may overlap.
        radius: in units of the square root of the surface area, or the range from which each disc's is drawn.
        seed: of all that is drawn.

    Raises:
        ArgumentError: if ``holes`` or ``radius`` is not positive, or there are more holes than points.
        ShapeError: if the shape is a cloud or needs repair, or next to nothing is left.
    """
    faces = mesh_faces(shape)
    _check_holes(holes, shape.n_points)
    check_range("radius", radius, lambda length: length > 0, "a positive number, in units of sqrt(area)")
    random = np.random.default_rng(seed)
    centres = random.choice(shape.n_points, size=drawn_count(holes, random), replace=False)
    radii = np.array([drawn(radius, random) for _ in centres]) * np.sqrt(surface_area(shape))
    kept = ~in_discs(shape, centres, radii)[faces].any(axis=1)
    return part_of_faces(shape, largest_piece(shape, kept), advice=_HOLES_ADVICE)


def in_discs(shape: Shape, centres: Int[np.ndarray, " h"], radii: Float[np.ndarray, " h"]) -> Bool[np.ndarray, " n"]:
    """Which points of a mesh are nearer to any of the centres than its radius, along the edges, in the file's units."""
    graph = edge_graph(shape.points, mesh_faces(shape))
    inside = np.zeros(shape.n_points, dtype=bool)
    for centre, radius in zip(centres, radii, strict=True):
        inside |= dijkstra(graph, indices=centre, limit=radius) < radius
    return inside


def _check_holes(holes: int | tuple[int, int], n_points: int) -> None:
    ends = holes if isinstance(holes, tuple) else (holes, holes)
    if not (len(ends) == 2 and all(map(is_count, ends)) and ends[0] <= ends[1] <= n_points):
        raise bad_value("holes", holes, f"a whole number from 1 to {n_points}, or two of them, the smaller one first")
