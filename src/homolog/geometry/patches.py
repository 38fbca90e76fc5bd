"""Coarse non-rigid registration: a shape in patches, each with a similarity transform, deformed along correspondences.

As in R. Sumner et al., "Embedded deformation for shape manipulation" (SIGGRAPH 2007), few nodes carry all points. Their
energy is that of ``homolog.geometry.deformation``; correspondences pull first, then closest points as well, as in
non-rigid ICP. Patches that fit nowhere are carried along by their neighbours.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from homolog.geometry.deformation import Factors, RestShape, WeightedPairs
from homolog.geometry.operators import Operators
from homolog.shapes import farthest_points

# Radii in spacings of the patches.
_ROTATION_SMOOTHING, _SCALE_SMOOTHING = 0.3, 5.0
# In each round: the stiffness in spacings of the patches, how far away a pair counts a quarter, in units of sqrt(area).
_ALONG_PAIRS = tuple(zip(np.geomspace(0.6, 1.0, 6), np.geomspace(0.15, 0.06, 6), strict=True))
_CLOSEST_ROUNDS, _STEPS = 3, 2
# What pairs weigh beside closest points.
_BESIDE = 0.1
_HOLD = 1e-9  # keeps the matrices definite where nothing pulls


class PatchedShape(RestShape):
    """A shape in patches of like size, which carry its points.

    Args:
        operators: of the shape, at unit area.
        count: how many patches.
    """

    def __init__(self, operators: Operators, count: int) -> None:
        self.points = operators.points.double().cpu().numpy()
        self.masses = operators.mass.double().cpu().numpy()
        self.masses /= self.masses.sum()
        laplacian = operators.sparse_laplacian()
        self.patch = _nearest_nodes(self.points, laplacian, operators.in_main_component.cpu().numpy(), count)
        n, count = len(self.points), int(self.patch.max()) + 1
        member = sparse.csr_array((np.ones(n), (np.arange(n), self.patch)), shape=(n, count))
        masses = np.bincount(self.patch, self.masses, count)
        self.middles = (member.T @ (self.masses[:, None] * self.points)) / masses[:, None]
        between = sparse.csr_array(member.T @ laplacian @ member)
        super().__init__(
            self.middles,
            between,
            masses,
            rotation_smoothing=_ROTATION_SMOOTHING,
            scale_smoothing=_SCALE_SMOOTHING,
        )
        near = sparse.coo_array(member @ ((between != 0) + sparse.eye_array(count)))
        away = np.linalg.norm(self.points[near.row] - self.middles[near.col], axis=1) / self.length(1)
        weights = sparse.csr_array((np.exp(-(away**2)), (near.row, near.col)), shape=(n, count))
        self.blend = sparse.csr_array(sparse.diags_array(1 / (weights.sum(axis=1) + _HOLD)) @ weights)

    def carried(
        self,
        positions: Float[np.ndarray, "k 3"],
        rotations: Float[np.ndarray, "k 3 3"],
        scales: Float[np.ndarray, " k"],
    ) -> Float[np.ndarray, "n 3"]:
        """Where the points lie when the patches do so, by the blended similarity transforms of those around each."""
        turns = rotations * scales[:, None, None]
        shifts = positions - np.einsum("kij,kj->ki", turns, self.middles)
        blended = (self.blend @ turns.reshape(-1, 9)).reshape(-1, 3, 3)
        found: np.ndarray = np.einsum("nij,nj->ni", blended, self.points) + self.blend @ shifts
        return found

    def registered(
        self, target: Float[np.ndarray, "m 3"], pairs: WeightedPairs, allowed: Bool[np.ndarray, " m"]
    ) -> Float[np.ndarray, "n 3"]:
        """The points where the shape is deformed onto another.

        Args:
            target: points of the other, in its own unit.
            pairs: correspondences, which count less the farther they are from the deformed shape.
            allowed: which points of the other this one may be drawn to.
        """
        among, trust, rows = target[allowed], np.ones(len(pairs.weights)), np.arange(len(self.points))
        tree, now, positions = KDTree(among), self.points, None
        for number in range(len(_ALONG_PAIRS) + _CLOSEST_ROUNDS):
            stiffness, reach = _ALONG_PAIRS[min(number, len(_ALONG_PAIRS) - 1)]
            pulls = pairs.points, pairs.positions, pairs.weights * trust
            if number >= len(_ALONG_PAIRS):
                away, nearest = tree.query(now)
                pulls = (
                    np.concatenate([rows, pairs.points]),
                    np.concatenate([among[nearest], pairs.positions]),
                    np.concatenate([self.masses * _robust(away, reach), _BESIDE * pulls[2]]),
                )
            positions, now = self._step(pulls, now, positions, stiffness)
            trust = _robust(np.linalg.norm(pairs.positions - now[pairs.points], axis=1), reach)
        return now

    def _step(
        self,
        pulls: tuple[np.ndarray, ...],
        now: Float[np.ndarray, "n 3"],
        positions: Float[np.ndarray, "k 3"] | None,
        stiffness: float,
    ) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "n 3"]]:
        """Where patches and points lie after a round; the patches begin at the mean of their pairs."""
        rows, targets, weights = pulls
        patch = self.patch[rows]
        goals = targets if positions is None else targets - (now[rows] - positions[patch])
        pull = np.bincount(patch, weights, self.count)
        pulled = np.stack([np.bincount(patch, weights * axis, self.count) for axis in goals.T], axis=1)
        known = np.ones(self.ends.shape[1], dtype=bool)
        if positions is None:
            positions, known = pulled / (pull + _HOLD)[:, None], (pull > _HOLD)[self.ends].all(axis=0)
        bending = self.length(stiffness) ** 2
        factors = Factors(sparse.diags_array(pull + _HOLD * self.mass) + bending * self.stiffness_matrix)
        for _ in range(_STEPS):
            bends = self.local_similarities(positions, known, 1.0)
            positions, known = factors.solve(pulled + bending * self.edge_forces(*bends)), np.ones_like(known)
        return positions, self.carried(positions, *bends)


def _robust(away: Float[np.ndarray, " p"], reach: float) -> Float[np.ndarray, " p"]:
    """Geman and McClure's weights."""
    weights: np.ndarray = 1 / (1 + (away / reach) ** 2) ** 2
    return weights


def _nearest_nodes(
    points: Float[np.ndarray, "n 3"], laplacian: sparse.csr_array, main: Bool[np.ndarray, " n"], count: int
) -> Int[np.ndarray, " n"]:
    """For each point the number of the nearest of some spread nodes: along edges, off the main component straight."""
    nodes = np.flatnonzero(main)[farthest_points(points[main], count, seed=0)]
    edges = sparse.coo_array(laplacian)
    lengths = np.linalg.norm(points[edges.row] - points[edges.col], axis=1)
    graph = sparse.csr_array((lengths, (edges.row, edges.col)), shape=laplacian.shape)
    _, _, origin = dijkstra(graph, directed=False, indices=nodes, min_only=True, return_predecessors=True)
    number = np.full(len(points) + 1, -1)
    number[nodes] = np.arange(len(nodes))
    found = number[np.where(origin >= 0, origin, len(points))]
    lost = found < 0
    if lost.any():
        found[lost] = found[~lost][KDTree(points[~lost]).query(points[lost])[1]]
    return np.asarray(found)
