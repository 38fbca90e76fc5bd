"""Matches whose truth is known: a blob, its image under a smooth map, and point maps between the two."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial import cKDTree

from homolog.matching import Match
from homolog.shapes import Shape


def correspondence(source, target, there, back):
    """A match that is trusted wherever it has a counterpart."""
    return Match(source, target, np.asarray(there), np.asarray(back), method="nearest-features")


def nearest(points, others):
    return cKDTree(others).query(points)[1]


@dataclass(frozen=True)
class Pair:
    """Two meshes of one surface, the second bent; nothing but the nearest vertices is told of the map."""

    source: Shape
    target: Shape
    bend: object

    @property
    def found(self):
        there = nearest(self.bend(self.source.points), self.target.points)
        return correspondence(
            self.source, self.target, there, nearest(self.target.points, self.bend(self.source.points))
        )


def bent(points):
    """Turned, twisted about the vertical axis and stretched."""
    x, y, z = np.asarray(points, dtype=float).T
    angle = 0.8 + 0.5 * y
    turned = np.stack([np.cos(angle) * x - np.sin(angle) * z, 1.1 * y, np.sin(angle) * x + np.cos(angle) * z], axis=1)
    return 2.0 * turned + [5.0, -1.0, 2.0]


@pytest.fixture(scope="session")
def pair(make):
    """Some 2,600 points each, meshed differently."""
    source = make.blob(4)
    # Another mesh of the same surface: the sphere below the blob is turned first.
    sphere, turn = make.sphere(4), make.rotation(3)
    x, y, z = (sphere.points @ turn.T).T
    radius = 1 + 0.25 * x * y + 0.2 * np.sin(2 * z + 0.4) + 0.15 * np.cos(3 * x + y + 0.7) + 0.1 * np.sin(2 * x - z)
    again = np.stack([x, y, z], axis=1) * radius[:, None] * np.array([1.0, 1.4, 0.8])
    return Pair(source, Shape(bent(again), sphere.faces, name="target"), bent)


@pytest.fixture(scope="session")
def matched():
    """``matched(source, target, there, back)``: a match that is trusted wherever it has a counterpart."""
    return correspondence
