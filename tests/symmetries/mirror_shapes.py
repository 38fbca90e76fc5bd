"""A shape whose mirror partners are known."""

import numpy as np
import trimesh
from scipy.spatial import KDTree


def bumpy():
    """A closed mesh that x = 0 divides into mirror images, of one form above and another in front."""
    sphere = trimesh.creation.icosphere(subdivisions=3)
    x, y, z = sphere.vertices.T
    radii = 1 + 0.35 * np.exp(-((np.abs(x) - 0.6) ** 2 + (y - 0.5) ** 2 + (z - 0.6) ** 2) / 0.1)
    radii += 0.5 * np.exp(-(x**2 + (y + 0.9) ** 2 + (z - 0.4) ** 2) / 0.15) + 0.25 * y + 0.15 * z * y
    points = sphere.vertices * radii[:, None] * [1, 1.4, 0.8]
    return points, np.asarray(sphere.faces), KDTree(points).query(points * [-1, 1, 1])[1]
