"""Splits, collapses and flips: closed manifolds stay such, and lengths and angles come out as wanted."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from stand_in import sphere

from homolog.synthesis.mesh_editing import (
    LONG,
    SHORT,
    WorkingMesh,
    collapse_short,
    edges_of,
    flip_to_delaunay,
    split_long,
)


def draft_of(vertices, faces, length):
    return WorkingMesh(vertices, vertices, np.full(len(vertices), length), faces)


def uneven_sphere(seed=0, n=600):
    points = np.random.default_rng(seed).normal(size=(n, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    hull = trimesh.convex.convex_hull(points)
    return np.array(hull.vertices), np.array(hull.faces, dtype=np.int64)


def is_sphere(working):
    mesh = trimesh.Trimesh(working.points, working.faces, process=False)
    return mesh.is_watertight and mesh.is_winding_consistent and mesh.euler_number == 2 and mesh.body_count == 1


def relative_lengths(working):
    edges = edges_of(working.faces, len(working.points))
    return working.relative_lengths(edges.a, edges.b)


def test_edges_have_their_triangles():
    _, faces = sphere(1)
    edges = edges_of(faces, faces.max() + 1)
    assert len(edges.key) == len(faces) * 3 // 2
    turned = [{tuple(np.roll(face, turn)) for turn in range(3)} for face in faces.tolist()]
    for a, b, c, d, first, second in zip(edges.a, edges.b, edges.c, edges.d, edges.first, edges.second, strict=True):
        assert (a, b, c) in turned[first]
        assert (b, a, d) in turned[second]
    assert (np.diff(edges.key) > 0).all()


@pytest.mark.parametrize("seed", range(3))
def test_splitting_halves_what_is_too_long(seed):
    working = draft_of(*uneven_sphere(seed), 0.12)
    split = split_long(working)
    assert is_sphere(split)
    long = (relative_lengths(working) > LONG).sum()
    assert len(split.points) == len(working.points) + long
    area = np.linalg.norm(np.cross(*np.moveaxis(np.diff(working.points[working.faces], axis=1), 1, 0)), axis=1).sum()
    after = np.linalg.norm(np.cross(*np.moveaxis(np.diff(split.points[split.faces], axis=1), 1, 0)), axis=1).sum()
    assert after == pytest.approx(area)


@pytest.mark.parametrize("seed", range(3))
def test_collapsing_leaves_little_that_is_too_short(seed):
    working = draft_of(*uneven_sphere(seed), 0.3)
    collapsed = collapse_short(working)
    assert is_sphere(collapsed)
    assert len(collapsed.points) < len(working.points) / 2
    # What is left could not be merged without making a long edge or folding the surface.
    assert (relative_lengths(collapsed) < SHORT).mean() < 0.35 * (relative_lengths(working) < SHORT).mean()
    assert relative_lengths(collapsed).max() <= max(LONG, relative_lengths(working).max()) + 1e-12


def test_collapsing_never_pinches_a_tetrahedron():
    mesh = trimesh.creation.icosahedron()
    collapsed = collapse_short(draft_of(np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64), 100.0))
    assert is_sphere(collapsed)


def test_flips_undo_flips():
    """The convex hull of points on a sphere is their Delaunay triangulation; where it is spoilt it comes back."""
    vertices, faces = uneven_sphere(4, 1500)
    working = draft_of(vertices, faces, 1.0)
    assert sum_of_angles(working).max() < np.pi + 0.1
    spoilt = spoil(working, np.random.default_rng(0))
    assert sum_of_angles(spoilt).max() > np.pi + 0.5
    mended = flip_to_delaunay(spoilt)
    assert is_sphere(mended)
    assert sum_of_angles(mended).max() < np.pi + 0.1


def sum_of_angles(working):
    """For each edge the sum of the angles across, one edge at a time."""
    edges = edges_of(working.faces, len(working.points))
    sums = []
    for a, b, c, d in zip(edges.a, edges.b, edges.c, edges.d, strict=True):
        total = 0.0
        for across in (c, d):
            u, v = working.points[a] - working.points[across], working.points[b] - working.points[across]
            total += np.arccos(u @ v / np.linalg.norm(u) / np.linalg.norm(v))
        sums.append(total)
    return np.array(sums)


def spoil(working, generator):
    """Flip some edges the wrong way, where that hardly bends the surface."""
    faces = working.faces.copy()
    for _ in range(300):
        edges = edges_of(faces, len(working.points))
        i = generator.integers(len(edges.key))
        a, b, c, d = edges.a[i], edges.b[i], edges.c[i], edges.d[i]
        joined = ((faces == c).any(axis=1) & (faces == d).any(axis=1)).any()
        normals = [normal(working.points[list(corners)]) for corners in ((a, b, c), (b, a, d), (a, d, c), (d, b, c))]
        if not joined and min(first @ second for first in normals for second in normals) > 0.95:
            faces[edges.first[i]], faces[edges.second[i]] = (a, d, c), (d, b, c)
    return replace(working, faces=faces)


def normal(corners):
    across = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    return across / np.linalg.norm(across)
