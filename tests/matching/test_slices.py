"""A surface and a cloud of some of its slices, which leave most of the surface empty."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

import homolog
from homolog.shapes import Shape

HEIGHTS = np.linspace(-0.95, 0.95, 14)


def form(directions):
    """A smooth body without symmetry, by the directions of its points."""
    x, y, z = directions.T
    stretched = directions * (1 + 0.25 * x * z + 0.2 * y**3 + 0.15 * x)[:, None]
    return stretched * [40.0, 60.0, 90.0]


@pytest.fixture(scope="module")
def body():
    ball = trimesh.creation.icosphere(subdivisions=4)
    return Shape(form(np.asarray(ball.vertices)), np.asarray(ball.faces), name="body")


@pytest.fixture(scope="module")
def slices():
    """Contours of the body, twice as many points on those that are below, and no more area for it."""
    rings = []
    for height in HEIGHTS:
        angles = 2 * np.pi * np.arange(160 if height < 0 else 80) / (160 if height < 0 else 80)
        wide = np.sqrt(1 - height**2)
        rings.append(np.c_[wide * np.cos(angles), wide * np.sin(angles), np.full(len(angles), height)])
    return Shape(form(np.concatenate(rings)), name="slices")


@pytest.mark.parametrize("orient", ["given", "auto"])
def test_slices_stay_on_their_own_surface(body, slices, orient):
    """Truth: the nearest point, as they lie where they belong. Points of the body are 3 to 7 mm apart."""
    found = homolog.match(body, slices, method="registration", orient=orient)
    true = KDTree(body.points).query(slices.points)[1]
    assert np.linalg.norm(body.points[found.target_to_source] - body.points[true], axis=1).mean() < 3.0
    there = slices.points[found.source_to_target]
    nearest = KDTree(slices.points).query(body.points)[0].mean()
    assert np.linalg.norm(there - body.points, axis=1).mean() < 1.5 * nearest
