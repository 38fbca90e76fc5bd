"""An articulated model without anny: a blob of two shape parameters that three bones bend and twist."""

import numpy as np
from scipy.spatial.transform import Rotation

from homolog.fitting import Fit, Pose
from homolog.shapes import Shape


class Worm:
    """As high as a person; its bones lie one above the other."""

    name = "worm"
    parameters = ("height", "width")
    bones = ("low", "middle", "high", "idle")
    parents = np.array([-1, 0, 1, 2])
    turning = np.array([0, 1, 2])
    firmness = np.ones(3)

    def __init__(self, blob):
        points = blob.points / np.abs(blob.points).max(axis=0) * [0.25, 0.85, 0.18]
        self.rest = points
        self.faces = blob.faces
        rising = [1 / (1 + np.exp(-(points[:, 1] - height) / 0.08)) for height in (-0.3, 0.35)]
        self.shares = np.stack([1 - rising[0], rising[0] - rising[1], rising[1], 0 * rising[0]], axis=1)
        self.heads = np.array([[0, -0.85, 0], [0, -0.3, 0], [0, 0.35, 0], [0, 0.8, 0]])

    @property
    def template(self):
        return Shape(self.points(np.full((1, 2), 0.5), np.tile(np.eye(3), (4, 1, 1)))[0], self.faces, name=self.name)

    def pose(self, build, rotations, rows=None):
        sizes = np.array([0.7 + 0.6 * build[1], 0.6 + 0.8 * build[0], 1.0])
        rest, heads = self.rest * sizes, self.heads * sizes
        turns, posed = [rotations[0]], [heads[0]]
        for bone in range(1, 4):
            posed.append(posed[-1] + turns[-1] @ (heads[bone] - heads[bone - 1]))
            turns.append(turns[-1] @ rotations[bone])
        carried = np.stack([(rest - heads[b]) @ turns[b].T + posed[b] for b in range(4)], axis=1)
        carried *= self.shares[:, :, None]
        carried = carried if rows is None else carried[rows]
        return Pose(carried.sum(axis=1), carried, np.stack(posed), np.stack(turns))

    def points(self, builds, rotations):
        return np.stack([self.pose(build, rotations).points for build in builds])


def wormlike():
    """Bent, twisted, turned over, small and stout."""
    turns = Rotation.from_rotvec([[0.5, 0.2, 2.5], [0.9, 0.3, 0], [0, -0.4, 0.8], [0, 0, 0]]).as_matrix()
    return Fit(np.array([0.3, 0.9]), turns, np.array([3.0, -1.0, 0.5]))


def scan_of(worm, fit):
    """Its surface with its points in another order, in centimetres, inside out; and which point each of them is."""
    order = np.random.default_rng(0).permutation(worm.shares.shape[0])
    points, faces = 100 * fit.points(worm)[order], np.argsort(order)[worm.faces[:, [0, 2, 1]]]
    return Shape(points, faces, name="scan.ply"), order


def faulty_maps(order, wrong=0.1):
    """Maps in both directions of which a tenth is wrong, and some points have none."""
    rng, count = np.random.default_rng(1), len(order)
    found = []
    for right in (np.argsort(order), order):
        indices = np.where(rng.random(count) < wrong, rng.integers(0, count, count), right)
        indices[rng.random(count) < 0.05] = -1
        found.append(indices)
    return found
