"""Isotropic and anisotropic remeshing: near-equilateral triangles, or triangles stretched in one direction."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.sparse import csr_matrix

from homolog.geometry.surface import ReferenceSurface, Surface, unit
from homolog.shapes import face_areas
from homolog.synthesis.mesh_editing import WorkingMesh, collapse_short, edges_of, flip_to_delaunay, split_long

_ROUNDS = 12
# The edge length is adapted to the number of vertices in this many first rounds, and then fixed.
_ADAPTING_ROUNDS = 9
# Vertices do not move where that would rotate a triangle's normal further than this, as a cosine.
_RELAX_COSINE = 0.4
# Random changes to the target lengths in the first rounds, so that no mesh inherits the template's connectivity.
_JITTER, _JITTERED_ROUNDS = 0.15, 3
# An edge may turn by this angle, in radians, but is no shorter than this share of the others; the curvature by which it
# is said to turn is smoothed so many times.
_MOST_TURN, _SHORTEST, _SMOOTHING = 0.4, 0.4, 4


@dataclass(frozen=True)
class MeshSettings:
    """Settings of remeshing.

    Args:
        vertices: the approximate number of vertices.
        stretch: the aspect ratio of triangles, in a direction sampled for each surface; 1 for near-equilateral ones.
    """

    vertices: int = 5000
    stretch: float = 1.0


def remesh(
    reference: ReferenceSurface, detail: Float[np.ndarray, " n"], settings: MeshSettings, generator: np.random.Generator
) -> Surface:
    """Remesh a closed surface, in rounds of edge splits, collapses, flips and tangential relaxation.

    M. Botsch and L. Kobbelt, "A remeshing approach to multiresolution modeling" (SGP 2004). Stretched triangles are
    near-equilateral ones in a space that is compressed in one direction.

    Args:
        reference: the surface.
        detail: the target edge length at each of its vertices, relative to the others.
        settings: number of vertices and aspect ratio.
        generator: of random numbers.

    Returns:
        A closed mesh whose vertices lie near the surface; ``ReferenceSurface.project`` gives their exact positions.

    Examples:
        >>> reference = ReferenceSurface(surface)  # doctest: +SKIP
        >>> even = np.ones(len(surface.vertices))  # doctest: +SKIP
        >>> mesh = remesh(reference, even, MeshSettings(vertices=2000), np.random.default_rng(0))  # doctest: +SKIP
    """
    direction = unit(generator.normal(size=(1, 3)))
    compression = np.eye(3) - (1.0 - 1.0 / settings.stretch) * direction.T @ direction
    mesh, surface = reference.surface, reference.surface
    # The edge length of equilateral triangles around that many vertices, where detail is 1.
    areas = face_areas(surface.vertices, surface.faces)
    area = float((areas / detail[surface.faces].mean(axis=1) ** 2).sum())
    base = math.sqrt(area * 2.0 / math.sqrt(3.0) / settings.vertices)
    for round_ in range(_ROUNDS):
        jitter = _JITTER if round_ < _JITTERED_ROUNDS else 0.0
        mesh = _improved(mesh, reference, base * detail, compression, generator, jitter)
        if round_ < _ADAPTING_ROUNDS:
            base *= math.sqrt(len(mesh.vertices) / settings.vertices)
    return mesh


def _improved(
    mesh: Surface,
    reference: ReferenceSurface,
    target_lengths: Float[np.ndarray, " n"],
    compression: Float[np.ndarray, "3 3"],
    generator: np.random.Generator,
    jitter: float,
) -> Surface:
    """One round."""
    lengths = reference.values_at(reference.nearest_vertices(mesh.vertices, mesh.vertex_normals), target_lengths)
    lengths *= 1.0 + jitter * generator.uniform(-1.0, 1.0, len(lengths))
    working = WorkingMesh(mesh.vertices, mesh.vertices @ compression, lengths, mesh.faces)
    working = flip_to_delaunay(collapse_short(split_long(working)))
    return relax(Surface(working.points, working.faces), reference)


def relax(mesh: Surface, reference: ReferenceSurface) -> Surface:
    """Tangential Laplacian smoothing: move vertices halfway to their neighbours' mean, where that folds nothing."""
    old, normals = mesh.vertices, mesh.vertex_normals
    step = 0.5 * (neighbours_middle(mesh) - old)
    step -= np.einsum("nk,nk->n", step, normals)[:, None] * normals
    new = reference.onto_tangent_planes(old + step, normals)
    has_area = mesh.face_normals.any(axis=1)
    for _ in range(20):
        moved = Surface(new, mesh.faces)
        folded = has_area & (np.einsum("mk,mk->m", moved.face_normals, mesh.face_normals) < _RELAX_COSINE)
        if not folded.any():
            return moved
        stay = mesh.faces[folded].ravel()
        new[stay] = old[stay]
    return mesh


def neighbours_middle(mesh: Surface) -> Float[np.ndarray, "n 3"]:
    """The mean position of each vertex's neighbours, of a closed mesh."""
    count = len(mesh.vertices)
    edges = edges_of(mesh.faces, count)
    here, there = np.concatenate([edges.a, edges.b]), np.concatenate([edges.b, edges.a])
    total = np.stack([np.bincount(here, column, count) for column in mesh.vertices[there].T], axis=1)
    return np.asarray(total / np.bincount(here, minlength=count)[:, None])


def shorter_where_bent(surface: Surface, stretch: float = 1.0) -> Float[np.ndarray, " n"]:
    """Relative edge lengths for ``remesh`` that follow the curvature: fingers would vanish between long triangles.

    Args:
        surface: a closed mesh.
        stretch: the aspect ratio of the triangles to come.

    Examples:
        >>> import trimesh
        >>> from homolog.geometry.surface import Surface
        >>> ball = trimesh.creation.icosphere(subdivisions=3)
        >>> even = shorter_where_bent(Surface(ball.vertices, ball.faces))
        >>> float(even.min()), float(even.max())
        (1.0, 1.0)
    """
    count = len(surface.vertices)
    edges = edges_of(surface.faces, count)
    both = np.concatenate([edges.a, edges.b])
    turn, length = (
        np.linalg.norm(values[edges.a] - values[edges.b], axis=1)
        for values in (surface.vertex_normals, surface.vertices)
    )
    total = np.bincount(both, np.tile(turn / np.maximum(length, 1e-12 + 0.1 * length.mean()), 2), count)
    degrees = np.bincount(both, minlength=count)
    around = csr_matrix((np.ones(len(both)), (both, np.roll(both, len(edges.a)))), shape=(count, count))
    bent = np.asarray(total / degrees)
    for _ in range(_SMOOTHING):
        bent = (bent + around @ bent / degrees) / 2
    return np.asarray(np.clip(_MOST_TURN / (bent * length.mean() * np.sqrt(stretch)), _SHORTEST, 1.0))


def is_one_closed_surface(mesh: Surface, *, euler_number: int = 2) -> bool:
    """Whether a mesh is one closed, outward oriented manifold without unused vertices.

    Args:
        mesh: to check.
        euler_number: 2 for a surface like a ball, 2 less for each hole through it, as a hip bone has one.
    """
    checked = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    sound = (
        checked.is_watertight
        and checked.is_winding_consistent
        and checked.euler_number == euler_number
        and checked.body_count == 1
    )
    return bool(sound and checked.volume > 0 and len(np.unique(mesh.faces)) == len(mesh.vertices))
