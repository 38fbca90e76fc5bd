"""Meshes of their own for surfaces: near-equilateral triangles, or ones that are stretched in some direction."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float

from homolog.geometry.surface import Ground, Surface, unit
from homolog.shapes import face_areas
from homolog.synthesis.mesh_editing import Draft, collapse_short, edges_of, flip_to_delaunay, split_long

_ROUNDS = 12
# After so many rounds the edge length is settled; until then it follows the number of vertices.
_SETTLING = 9
# Vertices stay where moving them would turn a triangle further than this, as a cosine.
_RELAX_COSINE = 0.4
# Random changes to the wanted lengths in the first rounds, so that no mesh inherits the connectivity it comes from.
_JITTER, _JITTERED_ROUNDS = 0.15, 3


@dataclass(frozen=True)
class MeshSettings:
    """How a surface is meshed.

    Args:
        vertices: about how many vertices the mesh shall have.
        stretch: how much longer than wide triangles are, in a direction drawn for each surface; 1 for near-equilateral
            ones.
    """

    vertices: int = 5000
    stretch: float = 1.0


def remesh(
    ground: Ground, detail: Float[np.ndarray, " n"], settings: MeshSettings, generator: np.random.Generator
) -> Surface:
    """Mesh a closed surface anew, in rounds of splits, collapses, flips and relaxation.

    Stretched triangles are near-equilateral ones of a space that is squeezed in one direction.

    Args:
        ground: the surface.
        detail: the edge length wanted at each of its vertices, relative to the others.
        settings: how many vertices, and how stretched the triangles are.
        generator: the surface's own source of random numbers.

    Returns:
        A closed mesh whose vertices lie near the surface; ``Ground.places`` says where.
    """
    squeeze = _squeeze(settings.stretch, generator)
    mesh, base = ground.surface, _first_length(ground.surface, detail, settings.vertices)
    for round_ in range(_ROUNDS):
        jitter = _JITTER if round_ < _JITTERED_ROUNDS else 0.0
        mesh = _improved(mesh, ground, base * detail, squeeze, generator, jitter)
        if round_ < _SETTLING:
            base *= math.sqrt(len(mesh.vertices) / settings.vertices)
    return mesh


def _first_length(surface: Surface, detail: Float[np.ndarray, " n"], count: int) -> float:
    """The edge length that equilateral triangles around so many vertices would have, where detail is 1."""
    areas = face_areas(surface.vertices, surface.faces)
    return math.sqrt(float((areas / detail[surface.faces].mean(axis=1) ** 2).sum()) * 2.0 / math.sqrt(3.0) / count)


def _improved(
    mesh: Surface,
    ground: Ground,
    wanted: Float[np.ndarray, " n"],
    squeeze: Float[np.ndarray, "3 3"],
    generator: np.random.Generator,
    jitter: float,
) -> Surface:
    """One round."""
    lengths = ground.values_at(ground.nearest(mesh.vertices, mesh.vertex_normals), wanted)
    lengths *= 1.0 + jitter * generator.uniform(-1.0, 1.0, len(lengths))
    draft = Draft(mesh.vertices, mesh.vertices @ squeeze, lengths, mesh.faces)
    draft = flip_to_delaunay(collapse_short(split_long(draft)))
    return relaxed(Surface(draft.points, draft.faces), ground)


def _squeeze(stretch: float, generator: np.random.Generator) -> Float[np.ndarray, "3 3"]:
    """The map that makes lengths in a random direction shorter by the stretch."""
    direction = unit(generator.normal(size=(1, 3)))
    return np.asarray(np.eye(3) - (1.0 - 1.0 / stretch) * direction.T @ direction)


def relaxed(mesh: Surface, ground: Ground) -> Surface:
    """Move vertices along the surface, halfway to the middle of their neighbours, where that folds nothing."""
    old, normals = mesh.vertices, mesh.vertex_normals
    step = 0.5 * (_neighbours_middle(mesh) - old)
    step -= np.einsum("nk,nk->n", step, normals)[:, None] * normals
    new = ground.slid(old + step, normals)
    has_area = mesh.face_normals.any(axis=1)
    for _ in range(20):
        moved = Surface(new, mesh.faces)
        folded = has_area & (np.einsum("mk,mk->m", moved.face_normals, mesh.face_normals) < _RELAX_COSINE)
        if not folded.any():
            return moved
        stay = mesh.faces[folded].ravel()
        new[stay] = old[stay]
    return mesh


def _neighbours_middle(mesh: Surface) -> Float[np.ndarray, "n 3"]:
    count = len(mesh.vertices)
    edges = edges_of(mesh.faces, count)
    here, there = np.concatenate([edges.a, edges.b]), np.concatenate([edges.b, edges.a])
    total = np.stack([np.bincount(here, column, count) for column in mesh.vertices[there].T], axis=1)
    return np.asarray(total / np.bincount(here, minlength=count)[:, None])


def is_one_closed_surface(mesh: Surface) -> bool:
    """Whether a mesh is one closed manifold of the sphere's topology without loose vertices, its inside within."""
    checked = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    sound = (
        checked.is_watertight
        and checked.is_winding_consistent
        and checked.euler_number == 2
        and checked.body_count == 1
    )
    return bool(sound and checked.volume > 0 and len(np.unique(mesh.faces)) == len(mesh.vertices))
