"""Lists of different lengths, one after the other in an array."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int


def runs(lengths: Int[np.ndarray, " k"]) -> tuple[Int[np.ndarray, " t"], Int[np.ndarray, " t"]]:
    """Runs of so many entries, one after the other: for each entry its run, and its place in it."""
    run = np.repeat(np.arange(len(lengths)), lengths)
    begins = np.cumsum(lengths) - lengths
    return run, np.arange(len(run)) - begins[run]


@dataclass(frozen=True)
class FacesAround:
    """The triangles around each vertex.

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
        """For every triangle around some vertices, the place of the vertex among these, and the triangle."""
        place, within = runs(self.degrees[vertices])
        return place, self.triangles[self.starts[vertices[place]] + within]

    def padded(self) -> Int[np.ndarray, "n d"]:
        """A row a vertex; shorter rows repeat their first triangle."""
        steps = np.arange(self.degrees.max())
        within = np.where(steps < self.degrees[:, None], steps, 0)
        return np.asarray(self.triangles[self.starts[:, None] + within])
