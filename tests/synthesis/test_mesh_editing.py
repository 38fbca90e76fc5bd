"""Splits, collapses and flips: closed manifolds stay such, and lengths and angles come out as wanted."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from stand_in import sphere

from homolog.synthesis.mesh_editing import LONG, SHORT, Draft, collapse_short, edges_of, flip_to_delaunay, split_long


def draft_of(vertices, faces, length):
    return Draft(vertices, vertices, np.full(len(vertices), length), faces)


def uneven_sphere(seed=0, n=600):
    points = np.random.default_rng(seed).normal(size=(n, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    hull = trimesh.convex.convex_hull(points)
    return np.array(hull.vertices), np.array(hull.faces, dtype=np.int64)


def is_sphere(draft):
    mesh = trimesh.Trimesh(draft.points, draft.faces, process=False)
    return mesh.is_watertight and mesh.is_winding_consistent and mesh.euler_number == 2 and mesh.body_count == 1


def relative_lengths(draft):
    edges = edges_of(draft.faces, len(draft.points))
    return draft.relative_lengths(edges.a, edges.b)


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
    draft = draft_of(*uneven_sphere(seed), 0.12)
    split = split_long(draft)
    assert is_sphere(split)
    long = (relative_lengths(draft) > LONG).sum()
    assert len(split.points) == len(draft.points) + long
    area = np.linalg.norm(np.cross(*np.moveaxis(np.diff(draft.points[draft.faces], axis=1), 1, 0)), axis=1).sum()
    after = np.linalg.norm(np.cross(*np.moveaxis(np.diff(split.points[split.faces], axis=1), 1, 0)), axis=1).sum()
    assert after == pytest.approx(area)


@pytest.mark.parametrize("seed", range(3))
def test_collapsing_leaves_little_that_is_too_short(seed):
    draft = draft_of(*uneven_sphere(seed), 0.3)
    collapsed = collapse_short(draft)
    assert is_sphere(collapsed)
    assert len(collapsed.points) < len(draft.points) / 2
    # What is left could not be merged without making a long edge or folding the surface.
    assert (relative_lengths(collapsed) < SHORT).mean() < 0.35 * (relative_lengths(draft) < SHORT).mean()
    assert relative_lengths(collapsed).max() <= max(LONG, relative_lengths(draft).max()) + 1e-12


def test_collapsing_never_pinches_a_tetrahedron():
    mesh = trimesh.creation.icosahedron()
    collapsed = collapse_short(draft_of(np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64), 100.0))
    assert is_sphere(collapsed)


def test_flips_undo_flips():
    """The convex hull of points on a sphere is their Delaunay triangulation; where it is spoilt it comes back."""
    vertices, faces = uneven_sphere(4, 1500)
    draft = draft_of(vertices, faces, 1.0)
    assert sum_of_angles(draft).max() < np.pi + 0.1
    spoilt = spoil(draft, np.random.default_rng(0))
    assert sum_of_angles(spoilt).max() > np.pi + 0.5
    mended = flip_to_delaunay(spoilt)
    assert is_sphere(mended)
    assert sum_of_angles(mended).max() < np.pi + 0.1


def sum_of_angles(draft):
    """For each edge the sum of the angles across, one edge at a time."""
    edges = edges_of(draft.faces, len(draft.points))
    sums = []
    for a, b, c, d in zip(edges.a, edges.b, edges.c, edges.d, strict=True):
        total = 0.0
        for across in (c, d):
            u, v = draft.points[a] - draft.points[across], draft.points[b] - draft.points[across]
            total += np.arccos(u @ v / np.linalg.norm(u) / np.linalg.norm(v))
        sums.append(total)
    return np.array(sums)


def spoil(draft, generator):
    """Flip some edges the wrong way, where that hardly bends the surface."""
    faces = draft.faces.copy()
    for _ in range(300):
        edges = edges_of(faces, len(draft.points))
        i = generator.integers(len(edges.key))
        a, b, c, d = edges.a[i], edges.b[i], edges.c[i], edges.d[i]
        joined = ((faces == c).any(axis=1) & (faces == d).any(axis=1)).any()
        normals = [normal(draft.points[list(corners)]) for corners in ((a, b, c), (b, a, d), (a, d, c), (d, b, c))]
        if not joined and min(first @ second for first in normals for second in normals) > 0.95:
            faces[edges.first[i]], faces[edges.second[i]] = (a, d, c), (d, b, c)
    return replace(draft, faces=faces)


def normal(corners):
    across = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    return across / np.linalg.norm(across)
