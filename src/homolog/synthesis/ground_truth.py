"""Ground truth of remeshed surfaces: correspondences between template points and the new vertices."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int
from scipy.spatial import cKDTree

from homolog.geometry.surface import BarycentricPoints, ReferenceSurface, Surface

# The vertex of a template point is searched among this many nearest on the rest pose, where no limbs touch.
_CANDIDATES = 12


def project_mesh(mesh: Surface, reference: ReferenceSurface) -> tuple[Surface, BarycentricPoints]:
    """Project a mesh exactly onto the surface that it was made from; the barycentric coordinates of its vertices."""
    vertices = reference.project(mesh.vertices, mesh.vertex_normals)
    return Surface(vertices.positions(reference.surface), mesh.faces), vertices


def vertices_at(
    points: BarycentricPoints, mesh: Surface, vertices: BarycentricPoints, body: Surface, rest: Surface
) -> Int[np.ndarray, " p"]:
    """The mesh vertex that corresponds to each template point.

    Candidates are the nearest vertices in the rest pose with an agreeing normal, so that no point jumps to another
    finger or from an arm to the chest. Of those whose normal agrees in the body's pose too, the nearest is taken.

    Args:
        points: template points.
        mesh: a mesh of the body.
        vertices: of the mesh, in barycentric coordinates of the template.
        body: the template in the body's shape and pose.
        rest: the template in the rest pose.
    """
    at_rest, normals_at_rest = points.positions(rest), rest.face_normals[points.triangles]
    _, candidates = cKDTree(vertices.positions(rest)).query(at_rest, k=_CANDIDATES)
    opposite = np.einsum("pck,pk->pc", rest.face_normals[vertices.triangles][candidates], normals_at_rest) < 0
    normals = body.face_normals[points.triangles]
    opposite |= np.einsum("pck,pk->pc", mesh.vertex_normals[candidates], normals) < 0
    distance = np.linalg.norm(mesh.vertices[candidates] - points.positions(body)[:, None], axis=2)
    best = np.where(opposite, np.inf, distance).argmin(axis=1)
    return np.asarray(candidates[np.arange(len(best)), best])
