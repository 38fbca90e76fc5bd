"""A body model without anny: an ellipsoid whose two halves bend apart, and a stick figure for a skeleton."""

import numpy as np
import trimesh

from homolog.synthesis.template import Template


def sphere(subdivisions=3, radius=1.0):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)


def stick_skeleton():
    """Left bones as anny has them at rest: arms half raised, forearms bent forward, fingers a little bent."""
    heads = {
        "upperarm01.L": (0.165, 0.427, 0.013),
        "lowerarm01.L": (0.334, 0.239, 0.019),
        "wrist.L": (0.45, 0.121, 0.174),
    }
    for finger in range(1, 6):
        start = np.array([0.45 + 0.01 * finger, 0.09 - 0.005 * finger, 0.25])
        heads[f"finger{finger}-1.L"] = start
        heads[f"finger{finger}-2.L"] = start + np.array([0.003, -0.014, 0.021])
        heads[f"finger{finger}-3.L"] = start + np.array([0.003, -0.030, 0.037])
    return {name: np.array(head, dtype=float) for name, head in heads.items()}


class StandIn:
    """Bodies that are ellipsoids as high as their build says."""

    def __init__(self, *, details=False):
        self._vertices, faces = sphere(3)
        self.skeleton = stick_skeleton()
        self.template = Template.of_outer_faces(faces, self.vertices({}, {}), np.ones(len(self._vertices)))

    def vertices(self, build, rotations):
        vertices = self._vertices * [0.3, 0.5 + 0.5 * build.get("height", 0.5), 0.2]
        return vertices - [0.0, vertices[:, 1].min(), 0.0]


class Crossing(StandIn):
    """Bodies that pass through themselves whenever a joint turns far."""

    def vertices(self, build, rotations):
        vertices = super().vertices(build, rotations)
        turned = max((np.arccos(np.clip((np.trace(r) - 1) / 2, -1, 1)) for r in rotations.values()), default=0.0)
        if turned > np.deg2rad(70.0):
            vertices[::2, 0] *= -1.0
        return vertices


def hand_skeleton():
    """A left hand whose fingers point to +y; its thumb is at +x, and its palm looks to -z."""
    heads = {"wrist.L": (0.0, 0.0, 0.0), "finger1-1.L": (0.02, 0.02, -0.01)}
    heads |= {"finger1-2.L": (0.045, 0.04, -0.02), "finger1-3.L": (0.06, 0.06, -0.03)}
    for number, across in zip(range(2, 6), (0.03, 0.0, -0.02, -0.04), strict=True):
        for joint in (1, 2, 3):
            heads[f"finger{number}-{joint}.L"] = (across, 0.06 + 0.03 * joint, -0.002 * (joint - 1))
    return {name: np.array(head) for name, head in heads.items()}


class PartStandIn:
    """Parts that are ellipsoids cut off at the bottom, as high as their build says."""

    local_changes = ("l-ear-scale-incr", "r-ear-scale-incr", "nose-hump-incr", "l-hand-scale-incr")

    def __init__(self, *, details=False):
        self._vertices, self._faces = sphere(3)
        self.skeleton = hand_skeleton()
        self.at_joints = np.zeros(len(self._vertices), dtype=bool)
        self.seen = []

    def part(self, label):
        outer = self._faces[(self._vertices[self._faces][:, :, 1] > -0.8).all(axis=1)]
        assert label in ("hand.L", "head")
        return Template.of_outer_faces(outer, self.vertices({}, {}), np.ones(len(self._vertices)), cut=True)

    def vertices(self, build, linear, changes=None, actions=None):
        self.seen.append((dict(build), dict(linear), dict(changes or {}), dict(actions or {})))
        return self._vertices * [0.3, 0.5 + 0.5 * build.get("height", 0.5), 0.2]
