"""Shapes whose mirror partners are known."""

from dataclasses import dataclass

import numpy as np
import pytest
import trimesh
from mirror_shapes import bumpy

import homolog
from homolog.statistics import MirrorPlane


@dataclass(frozen=True)
class Known:
    """A shape with the partner of each of its points, and its plane."""

    shape: homolog.Shape
    partner: np.ndarray
    plane: MirrorPlane

    @property
    def size(self):
        """sqrt(area)."""
        return float(np.sqrt(trimesh.Trimesh(self.shape.points, self.shape.faces, process=False).area))


@pytest.fixture(scope="session")
def turned():
    """The bumpy shape, turned, moved and in other units."""
    points, faces, partner = bumpy()
    rotation = trimesh.transformations.rotation_matrix(1.1, [1, 2, 0.5])[:3, :3]
    shift = np.array([5.0, 100, -3])
    normal = rotation[:, 0] * np.sign(rotation[np.abs(rotation[:, 0]).argmax(), 0])
    shape = homolog.Shape(37 * points @ rotation.T + shift, faces, name="turned")
    return Known(shape, partner, MirrorPlane(normal, float(shift @ normal)))
