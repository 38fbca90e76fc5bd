"""Outliers and densities: how far, how many, and by which law."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from homolog.core.errors import ShapeError
from homolog.geometry import surface_area
from homolog.shapes import Shape, components, face_areas, repair
from homolog.synthesis import add_outliers, add_shells, subsample


def test_outliers_are_far_and_have_no_index(make):
    blob = make.blob(3)
    unit = np.sqrt(face_areas(blob.points, blob.faces).sum())
    found = add_outliers(blob, share=0.2, distance=0.15, seed=1)
    n = blob.n_points
    assert found.shape.faces is None
    assert np.array_equal(found.shape.points[:n], blob.points)
    assert found.full_index.tolist() == [*range(n), *[-1] * round(0.2 * n)]
    far = found.shape.points[n:]
    distances = cdist(far, blob.points).min(axis=1)
    assert distances.min() >= 0.15 * unit
    # They fill the box around the shape, enlarged: none lies beyond it, and some come near its faces.
    low, high = blob.points.min(axis=0) - 0.3 * unit, blob.points.max(axis=0) + 0.3 * unit
    assert (far >= low).all() and (far <= high).all()
    assert (far.min(axis=0) < low + 0.1 * unit).all() and (far.max(axis=0) > high - 0.1 * unit).all()


def test_no_outliers(make):
    assert add_outliers(make.blob(2), share=0.0, seed=1).shape.n_points == make.blob(2).n_points


@pytest.mark.parametrize("least", [0.0, 0.3, 1.0])
def test_density_follows_the_cosine(least):
    """In each of ten slabs as many of the evenly spread points are kept as the law has it, within five deviations."""
    cloud = Shape(np.random.default_rng(0).random((200_000, 3)))
    part = subsample(cloud, least=least, direction=[0, 0, 2], seed=3)
    assert part.shape.faces is None and (np.diff(part.full_index) > 0).all()
    assert np.array_equal(part.shape.points, cloud.points[part.full_index])
    heights = np.linspace(0, 1, 10_001)
    law = least + (1 - least) * np.sin(np.pi * heights / 2) ** 2
    expected = np.array([law[(heights >= k / 10) & (heights <= (k + 1) / 10)].mean() for k in range(10)])
    before, after = (np.histogram(shape.points[:, 2], bins=10, range=(0, 1))[0] for shape in (cloud, part.shape))
    deviation = np.sqrt(before * expected * (1 - expected)) + 1
    assert (np.abs(after - before * expected) < 5 * deviation).all()


def test_of_a_mesh_the_points_are_thinned(make):
    assert subsample(make.blob(3), seed=0).shape.faces is None


def test_shells_are_apart_and_near_the_body_that_they_come_from(demo):
    made = add_shells(demo.amber, seed=1)
    own = made.full_index >= 0
    unit = np.sqrt(surface_area(demo.amber))
    away = np.linalg.norm(made.shape.points[own] - demo.amber.points[made.full_index[own]], axis=1) / unit
    assert away.max() <= 0.004 + 1e-9 and set(made.full_index[own]) == set(range(demo.amber.n_points))
    label = components(made.shape.faces[:, 0], made.shape.faces[:, 1], made.shape.n_points, made.shape.faces[:, 2])
    assert len(np.unique(label[own])) >= 6 and not set(label[own]) & set(label[~own])
    assert repair(made.shape).shape.n_points == made.shape.n_points
    assert (add_shells(demo.amber, seed=1).shape.points == made.shape.points).all()
    with pytest.raises(ShapeError, match="no faces"):
        add_shells(demo.amber.as_cloud(), seed=0)
