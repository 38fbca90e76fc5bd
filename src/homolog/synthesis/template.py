"""The surface that all bodies share, and the points on it that carry the ground truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float, Int

from homolog.geometry.surface import Places, Surface, closest_weights
from homolog.shapes import farthest_points

# The points are always the same ones, whatever set they are for.
_SEED = 7
_DRAWN_PER_POINT = 5


@dataclass(frozen=True)
class Template:
    """The closed surface that all bodies of a model share.

    Args:
        kept: the model's vertices that lie on the outer surface.
        rims: vertex loops of openings, in the numbering of ``kept``. Each gets one more vertex, at its centre, after
            the kept ones.
        faces: triangles over the kept vertices and the centres.
        detail: for each of these the edge length wanted there, relative to that of the trunk.
        rest: the mean body at rest, on which places are compared.
    """

    kept: Int[np.ndarray, " k"]
    rims: tuple[Int[np.ndarray, " r"], ...]
    faces: Int[np.ndarray, "m 3"]
    detail: Float[np.ndarray, " n"]
    rest: Surface

    @classmethod
    def of_outer_faces(
        cls, faces: Int[np.ndarray, "m 3"], vertices: Float[np.ndarray, "v 3"], detail: Float[np.ndarray, " v"]
    ) -> Template:
        """Close the openings of a model's outer triangles.

        Args:
            faces: triangles of the model's vertices.
            vertices: all the model's vertices, of the mean body at rest.
            detail: the relative edge length wanted at each of them.
        """
        kept, renumbered = np.unique(faces, return_inverse=True)
        open_faces = renumbered.reshape(-1, 3)
        rims = tuple(boundary_loops(open_faces))
        closed = np.concatenate([open_faces, *_fans(rims, len(kept))])
        rest = Surface(_with_centres(vertices[kept], rims), closed)
        return cls(kept, rims, closed, _with_centres(detail[kept], rims), rest)

    def surface(self, vertices: Float[np.ndarray, "v 3"]) -> Surface:
        """The closed surface of a body, from all the model's vertices."""
        return Surface(_with_centres(vertices[self.kept], self.rims), self.faces)


def _with_centres(values: np.ndarray, rims: tuple[np.ndarray, ...]) -> np.ndarray:
    """Values at the kept vertices, followed by their means over the rims."""
    return np.concatenate([values, *(values[rim].mean(axis=0, keepdims=True) for rim in rims)])


def _fans(rims: tuple[np.ndarray, ...], n_kept: int) -> list[np.ndarray]:
    """For each rim the triangles that join it to its centre."""
    return [np.stack([np.roll(rim, -1), rim, np.full(len(rim), n_kept + i)], axis=1) for i, rim in enumerate(rims)]


def boundary_loops(faces: Int[np.ndarray, "m 3"]) -> list[Int[np.ndarray, " r"]]:
    """The closed vertex loops along the open edges of a triangle mesh, in the direction of its triangles."""
    half_edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    known = {(a, b) for a, b in half_edges.tolist()}
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


def sample_evenly(surface: Surface, count: int) -> Places:
    """Places spread over a surface, each far from all before it."""
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    points, on = trimesh.sample.sample_surface(mesh, _DRAWN_PER_POINT * count, seed=_SEED)
    chosen = farthest_points(np.asarray(points), count, seed=_SEED)
    triangles = np.asarray(on)[chosen].astype(np.int64)
    corners = surface.vertices[surface.faces[triangles]]
    return Places(triangles, closest_weights(corners, np.asarray(points)[chosen]))
