"""What is left of a shape once everything unusable is out; checking reports it, repairing hands it over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from homolog.core.arguments import check_kind
from homolog.shapes.equal_rows import first_of_equal_rows
from homolog.shapes.shape import Shape


@dataclass(frozen=True, eq=False)
class Cleaning:
    """The clean arrays, the way back, and how many of each kind were taken out.

    Args:
        points: the points left, in the order of the original.
        faces: the faces left, in the order of the original; None for a point cloud.
        kept: index in the original of each point left.
        clean_index: for each original point the point left that stands for it, or -1.
        kept_faces: index in the original of each face left; None for a point cloud.
        n_not_finite: points with a coordinate that is NaN or infinite.
        n_duplicates: points equal to an earlier one.
        n_unreferenced: points that no face uses once faces and equal points are dealt with.
        n_out_of_range: faces with a corner that does not exist.
        n_broken: faces with a corner that is not finite.
        n_repeated: faces with the same point at two corners.
        n_folded: faces that lie back to back on a neighbour since equal points were merged.
        n_duplicate_faces: other faces with the same three points as an earlier one.
    """

    points: Float[np.ndarray, "k 3"]
    faces: Int[np.ndarray, "f 3"] | None
    kept: Int[np.ndarray, " k"]
    clean_index: Int[np.ndarray, " n"]
    kept_faces: Int[np.ndarray, " f"] | None
    n_not_finite: int
    n_duplicates: int
    n_unreferenced: int = 0
    n_out_of_range: int = 0
    n_broken: int = 0
    n_repeated: int = 0
    n_folded: int = 0
    n_duplicate_faces: int = 0


def clean(shape: Shape) -> Cleaning:
    """Take out what cannot be used, and nothing else."""
    check_kind("shape", shape, Shape)
    finite = np.isfinite(shape.points).all(axis=1)
    representative = np.arange(shape.n_points)
    (usable,) = np.nonzero(finite)
    representative[usable] = usable[first_of_equal_rows(shape.points[usable])]
    own = finite & (representative == np.arange(shape.n_points))
    n_not_finite, n_own = int(np.sum(~finite)), int(np.sum(own))
    counts = {"n_not_finite": n_not_finite, "n_duplicates": shape.n_points - n_not_finite - n_own}
    if shape.faces is None:
        kept, clean_index = _renumber(own, representative)
        return Cleaning(shape.points[kept], None, kept, clean_index, None, **counts)
    kept_faces, face_counts = _clean_faces(shape.faces, finite, representative)
    faces = representative[shape.faces[kept_faces]]
    referenced = np.zeros(shape.n_points, dtype=bool)
    referenced[faces] = True
    kept, clean_index = _renumber(referenced, representative)
    counts |= face_counts | {"n_unreferenced": n_own - len(kept)}
    return Cleaning(shape.points[kept], clean_index[faces], kept, clean_index, kept_faces, **counts)


def _renumber(
    left: Bool[np.ndarray, " n"], representative: Int[np.ndarray, " n"]
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " n"]]:
    """The points left, and the new number of each original point's representative, -1 where that is gone."""
    kept = np.flatnonzero(left)
    number = np.full(len(left), -1)
    number[kept] = np.arange(len(kept))
    return kept, number[representative]


def _clean_faces(
    faces: Int[np.ndarray, "m 3"], finite: Bool[np.ndarray, " n"], representative: Int[np.ndarray, " n"]
) -> tuple[Int[np.ndarray, " f"], dict[str, int]]:
    """Which faces are left. A thin face with three points of its own stays: no hole opens."""
    in_range = np.flatnonzero(np.all((faces >= 0) & (faces < len(finite)), axis=1))
    at_finite = in_range[finite[faces[in_range]].all(axis=1)]
    a, b, c = representative[faces[at_finite]].T
    proper = at_finite[(a != b) & (b != c) & (c != a)]
    merged = representative[faces[proper]]
    first = first_of_equal_rows(np.sort(merged, axis=1))
    folded = _folded(faces[proper], merged, first)
    left = (first == np.arange(len(first))) & ~folded
    return proper[left], {
        "n_out_of_range": len(faces) - len(in_range),
        "n_broken": len(in_range) - len(at_finite),
        "n_repeated": len(at_finite) - len(proper),
        "n_folded": int(np.sum(folded)),
        "n_duplicate_faces": len(proper) - int(np.sum(left | folded)),
    }


def _folded(
    faces: Int[np.ndarray, "m 3"], merged: Int[np.ndarray, "m 3"], first: Int[np.ndarray, " m"]
) -> Bool[np.ndarray, " m"]:
    """Mark pairs of neighbours that came to lie on each other, back to back, when equal points were merged.

    Dropping both closes the fold; keeping one would tear a closed mesh open.
    """
    (second,) = np.nonzero(first != np.arange(len(first)))
    partner = first[second]
    shared = np.sum(faces[second][:, :, None] == faces[partner][:, None, :], axis=(1, 2))
    back_to_back = _turns(merged[second]) != _turns(merged[partner])
    pairs = (np.bincount(first, minlength=len(first))[partner] == 2) & (shared == 2) & back_to_back
    folded = np.zeros(len(first), dtype=bool)
    folded[second[pairs]] = folded[partner[pairs]] = True
    return folded


def _turns(faces: Int[np.ndarray, "m 3"]) -> Bool[np.ndarray, " m"]:
    """Which way round each face runs, as compared with its corners in increasing order."""
    a, b, c = faces.T
    turns: np.ndarray = (a < b) ^ (b < c) ^ (c < a)
    return turns
