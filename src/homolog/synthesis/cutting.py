"""Partial meshes: cut by a plane, or with geodesic discs removed, as in SHREC'16 Partial."""

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
from homolog.synthesis.partial_shape import PartialShape, keep_faces, largest_component, mesh_faces
from homolog.synthesis.sampling import Range, check_range, checked_direction, sample, sample_count, sample_direction

_CUT_ADVICE = "cut less away, or take a finer mesh"
_HOLES_ADVICE = "make fewer or smaller holes, or take a finer mesh"


def cut(shape: Shape, *, removed: Range = (0.3, 0.6), normal: ArrayLike | None = None, seed: int) -> PartialShape:
    """Cut a mesh by a plane and keep the largest connected component on one side.

    The plane is placed so that this component keeps the wanted share of the area, as nearly as faces allow; faces that
    the plane crosses are removed. E. Rodolà et al., "Partial functional correspondence" (Computer Graphics Forum 2017),
    test on such shapes.

    Args:
        shape: a clean mesh; not changed.
        removed: share of the area to remove, or the range from which it is sampled.
        normal: the plane's normal, which points to the side that is kept, of any length; random by default.
        seed: of all random choices.

    Raises:
        ArgumentError: if ``removed`` is not from 0 to below 1, or ``normal`` no direction.
        ShapeError: if the shape is a cloud or needs repair, or next to nothing is left.

    Examples:
        >>> half = cut(shape, removed=0.5, normal=(0, 1, 0), seed=0)  # doctest: +SKIP
        >>> (shape.points[half.full_index] == half.shape.points).all()  # doctest: +SKIP
        True
    """
    check_range("removed", removed, lambda share: 0 <= share < 1, "a number from 0 to below 1")
    random = np.random.default_rng(seed)
    direction = sample_direction(random) if normal is None else checked_direction("normal", normal)
    target_share = 1 - sample(removed, random)
    faces, areas = mesh_faces(shape), face_areas(shape.points, shape.faces)  # type: ignore[arg-type]
    heights = (shape.points @ direction)[faces].min(axis=1)

    def kept_above(height: float) -> Bool[np.ndarray, " m"]:
        return largest_component(shape, heights >= height)

    descending = np.sort(heights)[::-1]
    position = bisect_left(descending, target_share * areas.sum(), key=lambda height: areas[kept_above(height)].sum())
    return keep_faces(shape, kept_above(descending[min(position, len(faces) - 1)]), advice=_CUT_ADVICE)


def cut_holes(
    shape: Shape, *, holes: int | tuple[int, int] = (5, 20), radius: Range = (0.03, 0.08), seed: int
) -> PartialShape:
    """Remove geodesic discs from a mesh and keep the largest connected component.

    Centres are points of the mesh, sampled uniformly. Points within the radius of a centre, along the edges (Dijkstra,
    1959), are removed with all their faces. Such shapes are the "holes" of SHREC'16 Partial.

    Args:
        shape: a clean mesh; not changed.
        holes: how many discs, or the range from which the number is sampled; discs may overlap.
        radius: in units of the square root of the surface area, or the range from which each disc's is sampled.
        seed: of all random choices.

    Raises:
        ArgumentError: if ``holes`` or ``radius`` is not positive, or there are more holes than points.
        ShapeError: if the shape is a cloud or needs repair, or next to nothing is left.
    """
    faces = mesh_faces(shape)
    ends = holes if isinstance(holes, tuple) else (holes, holes)
    if not (len(ends) == 2 and all(map(is_count, ends)) and ends[0] <= ends[1] <= shape.n_points):
        allowed = f"a whole number from 1 to {shape.n_points}, or two of them, the smaller one first"
        raise bad_value("holes", holes, allowed)
    check_range("radius", radius, lambda length: length > 0, "a positive number, in units of sqrt(area)")
    random = np.random.default_rng(seed)
    centres = random.choice(shape.n_points, size=sample_count(holes, random), replace=False)
    radii = np.array([sample(radius, random) for _ in centres]) * np.sqrt(surface_area(shape))
    kept = ~in_discs(shape, centres, radii)[faces].any(axis=1)
    return keep_faces(shape, largest_component(shape, kept), advice=_HOLES_ADVICE)


def in_discs(shape: Shape, centres: Int[np.ndarray, " h"], radii: Float[np.ndarray, " h"]) -> Bool[np.ndarray, " n"]:
    """Which points of a mesh lie within any geodesic disc, along the edges; radii are in the file's units."""
    graph = edge_graph(shape.points, mesh_faces(shape))
    inside = np.zeros(shape.n_points, dtype=bool)
    for centre, radius in zip(centres, radii, strict=True):
        inside |= dijkstra(graph, indices=centre, limit=radius) < radius
    return inside
