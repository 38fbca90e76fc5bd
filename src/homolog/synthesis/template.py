"""The template: the closed surface that all synthetic bodies share, and its points that carry the ground truth."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import trimesh
from jaxtyping import Float, Int

from homolog.geometry.surface import BarycentricPoints, Surface, closest_weights
from homolog.shapes import farthest_points, half_edges
from homolog.synthesis.remeshing import shorter_where_bent

# The template points are the same in all datasets.
_SEED = 7
_CANDIDATES_PER_POINT = 5


@dataclass(frozen=True)
class Template:
    """The closed surface that all bodies of a model share.

    Args:
        kept: the model's vertices that lie on the outer surface.
        rims: boundary loops, in the numbering of ``kept``. Each is closed with one vertex at its centre, appended to
            the kept ones.
        faces: triangles over the kept vertices and the centres.
        detail: the target edge length at each vertex, relative to the trunk's.
        rest: the mean body in the rest pose.
        lid: triangles that close a cut, where there is one; they may be taken away.
    """

    kept: Int[np.ndarray, " k"]
    rims: tuple[Int[np.ndarray, " r"], ...]
    faces: Int[np.ndarray, "m 3"]
    detail: Float[np.ndarray, " n"]
    rest: Surface
    lid: Int[np.ndarray, " l"] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @classmethod
    def of_outer_faces(
        cls,
        faces: Int[np.ndarray, "m 3"],
        vertices: Float[np.ndarray, "v 3"],
        detail: Float[np.ndarray, " v"],
        *,
        cut: bool = False,
    ) -> Template:
        """Close the holes of a model's outer surface.

        Args:
            faces: triangles of the model's vertices.
            vertices: all the model's vertices, of the mean body in the rest pose.
            detail: the relative target edge length at each of them.
            cut: whether the longest hole is where the surface was cut.
        """
        kept, renumbered = np.unique(faces, return_inverse=True)
        open_faces = renumbered.reshape(-1, 3)
        rims = tuple(boundary_loops(open_faces))
        fans = [
            np.stack([np.roll(rim, -1), rim, np.full(len(rim), len(kept) + i)], axis=1) for i, rim in enumerate(rims)
        ]
        closed = np.concatenate([open_faces, *fans])
        rest = Surface(_with_centres(vertices[kept], rims), closed)
        lid = np.arange(len(open_faces), len(closed))
        if cut:
            outlines = [vertices[kept][rim] for rim in rims]
            lengths = [np.linalg.norm(each - np.roll(each, 1, axis=0), axis=1).sum() for each in outlines]
            longest = int(np.argmax(lengths))
            lid = np.split(lid, np.cumsum([len(rim) for rim in rims])[:-1])[longest]
        return cls(kept, rims, closed, _with_centres(detail[kept], rims), rest, lid if cut else lid[:0])

    @classmethod
    def of_closed(cls, rest: Surface) -> Template:
        """A closed surface as it is, with shorter edges where it is bent."""
        return cls(np.arange(len(rest.vertices)), (), rest.faces, shorter_where_bent(rest), rest)

    @cached_property
    def euler_number(self) -> int:
        """2 for a surface like a ball, 2 less for each hole through it."""
        return int(trimesh.Trimesh(self.rest.vertices, self.faces, process=False).euler_number)

    def surface(self, vertices: Float[np.ndarray, "v 3"]) -> Surface:
        """The closed surface of a body, from all the model's vertices."""
        return Surface(self.at_vertices(vertices), self.faces)

    def at_vertices(self, values: Float[np.ndarray, "v ..."]) -> Float[np.ndarray, "n ..."]:
        """Values of all the model's vertices at those of the closed surface."""
        return _with_centres(values[self.kept], self.rims)


def _with_centres(values: np.ndarray, rims: tuple[np.ndarray, ...]) -> np.ndarray:
    """Values at the kept vertices, followed by their means over the rims."""
    return np.concatenate([values, *(values[rim].mean(axis=0, keepdims=True) for rim in rims)])


def boundary_loops(faces: Int[np.ndarray, "m 3"]) -> list[Int[np.ndarray, " r"]]:
    """The boundary loops of a triangle mesh, oriented as its triangles."""
    known = {(a, b) for a, b in half_edges(faces).tolist()}
    follows = {a: b for a, b in sorted(known) if (b, a) not in known}
    loops = []
    while follows:
        start, current = follows.popitem()
        loop = [start]
        while current != start:
            loop.append(current)
            current = follows.pop(current)
        loops.append(np.array(loop, dtype=np.int64))
    return loops


def sample_evenly(surface: Surface, count: int, *, without: Int[np.ndarray, " l"] | None = None) -> BarycentricPoints:
    """Sample a surface evenly: farthest point sampling (Y. Eldar et al., 1997) of uniform random points.

    Args:
        surface: to sample.
        count: number of points.
        without: triangles that get no points.
    """
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    weights = np.array(mesh.area_faces)
    weights[[] if without is None else without] = 0.0
    candidates = _CANDIDATES_PER_POINT * count
    points, triangle_of = trimesh.sample.sample_surface(mesh, candidates, face_weight=weights, seed=_SEED)
    chosen = farthest_points(np.asarray(points), count, seed=_SEED)
    triangles = np.asarray(triangle_of)[chosen].astype(np.int64)
    corners = surface.vertices[surface.faces[triangles]]
    return BarycentricPoints(triangles, closest_weights(corners, np.asarray(points)[chosen]))
