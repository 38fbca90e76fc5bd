"""Which point of a mesh lies at which place of the surface that it was made from."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int
from scipy.spatial import cKDTree

from homolog.geometry.surface import Ground, Places, Surface

# So many mesh vertices nearest to a point on the template at rest, where no parts touch, may be the one on the body.
_CANDIDATES = 12


def settled(mesh: Surface, ground: Ground) -> tuple[Surface, Places]:
    """A mesh put exactly onto the surface that it was made from, and the places of its vertices there."""
    places = ground.places(mesh.vertices, mesh.vertex_normals)
    return Surface(places.on(ground.surface), mesh.faces), places


def vertices_at(points: Places, mesh: Surface, places: Places, body: Surface, rest: Surface) -> Int[np.ndarray, " p"]:
    """The mesh vertex at each of some points of the common surface.

    Candidates are near on the template at rest and face the same way there, so that no point jumps to another finger or
    from an arm to the chest; of those that face the same way on the body, too, the nearest there is taken.

    Args:
        points: places on the common surface.
        mesh: a mesh of the body.
        places: where its vertices lie on the common surface.
        body: the common surface as the body stands.
        rest: the common surface at rest.
    """
    at_rest, normals_at_rest = points.on(rest), rest.face_normals[points.triangles]
    _, candidates = cKDTree(places.on(rest)).query(at_rest, k=_CANDIDATES)
    away = np.einsum("pck,pk->pc", rest.face_normals[places.triangles][candidates], normals_at_rest) < 0
    normals = body.face_normals[points.triangles]
    away |= np.einsum("pck,pk->pc", mesh.vertex_normals[candidates], normals) < 0
    distance = np.linalg.norm(mesh.vertices[candidates] - points.on(body)[:, None], axis=2)
    best = np.where(away, np.inf, distance).argmin(axis=1)
    return np.asarray(candidates[np.arange(len(best)), best])
