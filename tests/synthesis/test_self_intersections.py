"""Crossing triangles against a slow reference, and in cases where one knows."""

import itertools

import numpy as np
import pytest
from stand_in import sphere

from homolog.geometry.surface import Surface
from homolog.synthesis.self_intersections import self_intersecting_faces, self_intersection_share


def pair(offset, scale=1.0):
    vertices, faces = sphere(1)
    return Surface(
        np.concatenate([vertices, scale * vertices + offset]), np.concatenate([faces, faces + len(vertices)])
    )


def reference(surface):
    """Each side of each triangle against each other triangle, by solving for where they meet."""
    crosses = np.zeros(len(surface.faces), dtype=bool)
    for s, t in itertools.permutations(range(len(surface.faces)), 2):
        first, second = surface.faces[s], surface.faces[t]
        if len(set(first) & set(second)) > 1:
            continue
        p, q, r = surface.vertices[first]
        for i in range(3):
            ends = second[i], second[(i + 1) % 3]
            if set(ends) & set(first):
                continue
            a, b = surface.vertices[list(ends)]
            system = np.stack([q - p, r - p, a - b], axis=1)
            if abs(np.linalg.det(system)) < 1e-12:
                continue
            u, v, along = np.linalg.solve(system, a - p)
            if u > 0 and v > 0 and u + v < 1 and 0 < along < 1:
                crosses[s] = crosses[t] = True
    return crosses


@pytest.mark.parametrize(
    ("offset", "scale"), [((1.1, 0.2, 0.05), 1.0), ((0.9, 0.13, 0.21), 0.3), ((1.93, 0.1, 0.03), 1.0)]
)
def test_two_spheres(offset, scale):
    surface = pair(np.array(offset), scale)
    expected = reference(surface)
    assert expected.any()
    np.testing.assert_array_equal(self_intersecting_faces(surface), expected)


def test_spheres_that_do_not_meet():
    assert not self_intersecting_faces(pair(np.array([3.0, 0.0, 0.0]))).any()
    assert not self_intersecting_faces(pair(np.array([0.01, 0.02, 0.03]), 0.2)).any(), "one within the other"


def test_a_sphere_folded_through_itself():
    vertices, faces = sphere(1)
    pushed = vertices.copy()
    pushed[np.argmax(pushed[:, 1])] = [0.05, -1.7, 0.02]
    surface = Surface(pushed, faces)
    np.testing.assert_array_equal(self_intersecting_faces(surface), reference(surface))
    assert self_intersecting_faces(surface).any()


def test_shares():
    surface = pair(np.array([0.9, 0.13, 0.21]), 0.3)
    crosses = self_intersecting_faces(surface)
    assert self_intersection_share(surface) == pytest.approx(crosses.mean())
    areas = np.linalg.norm(surface.face_vectors, axis=1)
    assert self_intersection_share(surface, by_area=True) == pytest.approx(areas[crosses].sum() / areas.sum())
