"""Lists of different lengths, concatenated in one array."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int


def runs(lengths: Int[np.ndarray, " k"]) -> tuple[Int[np.ndarray, " t"], Int[np.ndarray, " t"]]:
    """For each entry of concatenated lists of these lengths: its list, and its position in it."""
    run = np.repeat(np.arange(len(lengths)), lengths)
    begins = np.cumsum(lengths) - lengths
    return run, np.arange(len(run)) - begins[run]


@dataclass(frozen=True)
class FacesAround:
    """The triangles around each vertex, concatenated.

    Args:
        triangles: those of the first vertex, then those of the second, and so on.
        starts: where those of each vertex begin.
        degrees: how many each has.
    """

    triangles: Int[np.ndarray, " 3m"]
    starts: Int[np.ndarray, " n"]
    degrees: Int[np.ndarray, " n"]

    @classmethod
    def of(cls, faces: Int[np.ndarray, "m 3"], n_vertices: int) -> FacesAround:
        """Those of a mesh."""
        degrees = np.bincount(faces.ravel(), minlength=n_vertices)
        return cls(np.argsort(faces.ravel(), kind="stable") // 3, np.cumsum(degrees) - degrees, degrees)

    def of_each(self, vertices: Int[np.ndarray, " v"]) -> tuple[Int[np.ndarray, " t"], Int[np.ndarray, " t"]]:
        """For every triangle around some vertices, the position of the vertex among these, and the triangle."""
        position, within = runs(self.degrees[vertices])
        return position, self.triangles[self.starts[vertices[position]] + within]

    def joined(self, size: int) -> FacesAround:
        """The same for groups of so many triangles, each group once around a vertex, in the order of its first one."""
        vertex, groups = np.repeat(np.arange(len(self.degrees)), self.degrees), self.triangles // size
        _, first = np.unique(vertex * (int(groups.max(initial=0)) + 1) + groups, return_index=True)
        kept = np.sort(first)
        degrees = np.bincount(vertex[kept], minlength=len(self.degrees))
        return FacesAround(groups[kept], np.cumsum(degrees) - degrees, degrees)
