"""Fewer points of a shape: which stay, and what is between them."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from homolog.viewing.decimation import decimate


@pytest.mark.parametrize("most", [40, 300])
def test_a_mesh_keeps_its_surface(make, most):
    """Its own points, all over it; a closed surface of the same area and orientation."""
    blob = make.blob(4)
    found = decimate(blob.points, blob.faces, most, 10_000)
    assert 0.8 * most < len(found.index) <= most
    assert (np.diff(found.index) > 0).all()
    assert np.unique(found.faces).tolist() == list(range(len(found.index)))
    points = blob.points[found.index]
    spacing = np.sqrt(area(blob.points, blob.faces) / len(points))
    assert KDTree(points).query(blob.points)[0].max() < 1.5 * spacing
    assert area(points, found.faces) == pytest.approx(area(blob.points, blob.faces), rel=0.2)
    assert volume(points, found.faces) == pytest.approx(volume(blob.points, blob.faces), rel=0.25)


def area(points, faces):
    a, b, c = points[faces].transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def volume(points, faces):
    """Signed: it is negative if triangles are turned over."""
    return np.linalg.det(points[faces]).sum() / 6


def test_triangles_are_bounded_as_well(make):
    blob = make.blob(3)
    found = decimate(blob.points, blob.faces, 10_000, 200)
    assert 100 < len(found.faces) <= 200 and len(np.unique(np.sort(found.faces, axis=1), axis=0)) == len(found.faces)


def test_clouds_keep_their_form_where_they_are_sparse_too():
    """A dense ball beside a sparse one: both are there; the density is evened out."""
    rng = np.random.default_rng(0)
    sphere = rng.standard_normal((5000, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    points = np.concatenate([sphere[:4500], sphere[4500:] + np.array([5, 0, 0])])
    found = decimate(points, None, 400, 1)
    assert found.faces is None and 300 < len(found.index) <= 400
    assert 0.3 < (found.index >= 4500).mean() < 0.6


def test_what_is_small_enough_stays_as_it_is(make):
    blob = make.blob(1)
    found = decimate(blob.points, blob.faces, blob.n_points, len(blob.faces))
    assert found.index.tolist() == list(range(blob.n_points)) and found.faces is blob.faces


@pytest.mark.parametrize(
    "points", [np.zeros((100, 3)), np.concatenate([np.random.default_rng(0).random((99, 3)), [[1e9, 0, 1e9]]])]
)
def test_odd_shapes(points):
    """All points in one place, and one that is extremely far off."""
    assert 1 <= len(decimate(points, None, 10, 1).index) <= 10
