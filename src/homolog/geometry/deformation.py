"""Non-rigid registration by an as-rigid-as-possible energy: one shape deformed onto another along point maps.

The energy is that of O. Sorkine and M. Alexa, "As-rigid-as-possible surface modeling" (SGP 2007), with a local scale
besides the rotation; correspondences and the closest points of the target's surface pull as in non-rigid ICP
(B. Amberg et al., CVPR 2007). Smoothing the positions themselves, as harmonic and biharmonic energies do, would shrink
fingers and feet below what their meshes can show. The smoothed local scales and the schedule are new here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from jaxtyping import Bool, Float, Int
from scipy.sparse.linalg import splu

from homolog.geometry.laplacian import cloud_laplacian, mesh_laplacian
from homolog.geometry.projection import SurfaceProjector
from homolog.geometry.surface import Surface
from homolog.shapes import Shape

# Lengths are in spacings of the deformed shape's points.
_STIFFNESS = 3.0
_ROTATION_SMOOTHING = 2.0  # radius over which rotations are averaged
_SCALE_SMOOTHING = 10.0  # radius over which scales are averaged
_SCALES = (0.2, 5.0)  # bounds of the local scale, relative to the global one
_ROUNDS = 8
_FREE_ROUNDS = 2
_SURFACE_PULL = 1.0
# A pair whose ends are this many times the median distance apart counts a quarter.
_FAR = 2.0
_HOLD = 1e-9  # keeps the matrices definite where nothing pulls
# The share of agreeing normals above which normals tell the sides of the target.
_ONE_SIDED = 0.5


@dataclass(frozen=True)
class WeightedPairs:
    """Correspondences that pull.

    Args:
        points: of the source (p,).
        positions: where each belongs on the target (p, 3).
        weights: of each (p,).
        n_certain: how many of the last ones are certain: their weights do not fall where they lie far away.
    """

    points: Int[np.ndarray, " p"]
    positions: Float[np.ndarray, "p 3"]
    weights: Float[np.ndarray, " p"]
    n_certain: int = 0

    def held(self, count: int) -> Bool[np.ndarray, " n"]:
        """Which of so many points of the source occur in any pair."""
        return np.bincount(self.points, minlength=count) > 0


class RestShape:
    """A shape before it is deformed: its edges, with the strength of each, and means over its neighbourhoods.

    Masses add up to one, so that lengths are shares of the shape's unit.

    Args:
        points: positions (n, 3).
        laplacian: its positive semi-definite Laplacian (n, n).
        mass: of each point (n,).
        rotation_smoothing: radius over which rotations are averaged, in spacings of the points.
        scale_smoothing: radius over which scales are averaged.
    """

    def __init__(
        self,
        points: Float[np.ndarray, "n 3"],
        laplacian: sparse.sparray,
        mass: Float[np.ndarray, " n"],
        *,
        rotation_smoothing: float = _ROTATION_SMOOTHING,
        scale_smoothing: float = _SCALE_SMOOTHING,
    ) -> None:
        self.count = len(points)
        self.mass = mass / mass.sum()
        edges = sparse.coo_array(sparse.triu(-laplacian, 1))
        positive = edges.data > 0
        self.ends, self.strengths = np.stack([edges.row, edges.col])[:, positive], edges.data[positive]
        self.rest = points[self.ends[0]] - points[self.ends[1]]
        self.around = _incidence(self.ends, self.count, sign=1.0) @ sparse.diags_array(self.strengths)
        self.differences = _incidence(self.ends, self.count, sign=-1.0)
        self.stiffness_matrix = self.differences @ sparse.diags_array(self.strengths) @ self.differences.T
        self.rotation_smoother = self._smoother(rotation_smoothing)
        self.scale_smoother = self._smoother(scale_smoothing)

    @classmethod
    def of(cls, shape: Shape) -> RestShape:
        """A repaired mesh or cloud at rest."""
        return RestShape(shape.points, *_laplacian(shape))

    def local_similarities(
        self, positions: Float[np.ndarray, "n 3"], known: Bool[np.ndarray, " e"], overall: float
    ) -> tuple[Float[np.ndarray, "n 3 3"], Float[np.ndarray, " n"]]:
        """How the neighbourhood of each point is rotated and scaled where the points lie at other positions.

        Args:
            positions: of all points.
            known: which edges count.
            overall: the scale of the whole where no edge counts.
        """
        now = (positions[self.ends[0]] - positions[self.ends[1]]) * known[:, None]
        covariance = self.around @ (now[:, :, None] * self.rest[:, None, :]).reshape(-1, 9)
        rotations = nearest_rotations(self.rotation_smoother.solve(covariance).reshape(-1, 3, 3))
        sizes = np.einsum("nkl,nkl->n", rotations, covariance.reshape(-1, 3, 3))
        rest_sizes = self.around @ (known * (self.rest**2).sum(axis=1))
        with np.errstate(divide="ignore", invalid="ignore"):
            overall = sizes.sum() / rest_sizes.sum() if known.any() else overall
            scales = self.scale_smoother.solve(sizes) / (overall * self.scale_smoother.solve(rest_sizes))
        return rotations, np.asarray(overall * np.nan_to_num(scales, nan=1.0).clip(*_SCALES))

    def edge_forces(
        self, rotations: Float[np.ndarray, "n 3 3"], scales: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "n 3"]:
        """The right-hand side of the ARAP step: rest edges, rotated and scaled as the patches around their ends are."""
        of_edges = (rotations * scales[:, None, None])[self.ends].mean(axis=0)
        forces = self.strengths[:, None] * np.einsum("ekl,el->ek", of_edges, self.rest)
        return np.asarray(self.differences @ forces)

    def length(self, spacings: float) -> float:
        """So many spacings of the points, as a share of the shape's unit."""
        return spacings / float(np.sqrt(self.count))

    def _smoother(self, spacings: float) -> Factors:
        return Factors(sparse.diags_array(self.mass) + self.length(spacings) ** 2 * self.stiffness_matrix)


class DeformedTemplate(RestShape):
    """The source's surface, to be deformed onto the target's.

    Args:
        source: the shape that is deformed.
        target: the shape that it is deformed onto.
        rounds: how often rotations and positions are found in turn.
        free_rounds: in how many of these, the first ones, the pairs alone pull, and not the target's surface.
    """

    def __init__(
        self,
        source: SurfaceProjector,
        target: SurfaceProjector,
        *,
        rounds: int = _ROUNDS,
        free_rounds: int = _FREE_ROUNDS,
    ) -> None:
        super().__init__(source.shape.points, *_laplacian(source.shape))
        self.source, self.target, self.rounds, self.free_rounds = source, target, rounds, free_rounds

    def solve(
        self, pairs: WeightedPairs, *, stiffness: float = _STIFFNESS, orientation: int = 0
    ) -> tuple[int, Float[np.ndarray, "n 3"]]:
        """Alternate between local rotations and positions.

        Args:
            pairs: correspondences between the repaired shapes.
            stiffness: in spacings of the source's points: what is smaller keeps its form, what is larger the pairs
                decide.
            orientation: the relative orientation of both meshes (see ``SurfaceMap``); by default it is found.

        Returns:
            The relative orientation of both meshes, and the deformed positions.
        """
        surface_pull, bending = _SURFACE_PULL * self.mass * pairs.held(self.count), self.length(stiffness) ** 2
        pull, pulled = self._pulled(pairs, pairs.weights)
        # Positions begin at the mean of each point's pairs; rotations come from edges both of whose ends have pairs.
        positions = pulled / np.where(pull > 0, pull, 1.0)[:, None]
        known = (pull > 0)[self.ends].all(axis=0)
        for number in range(self.rounds):
            # Without any edge between paired points the shapes' own sizes give the global scale.
            bends = self.local_similarities(
                positions, known if number == 0 else np.ones_like(known), self.target.unit / self.source.unit
            )
            bent = bending * self.edge_forces(*bends)
            total, right = pull + _HOLD * self.mass, pulled + bent
            if number >= self.free_rounds:
                orientation = orientation or self._orientation(positions, surface_pull)
                normals = orientation * self._normals(positions) if orientation else None
                below = self.target.positions(self.target.project(positions, normals))
                total, right = total + surface_pull, right + surface_pull[:, None] * below
            positions = Factors(sparse.diags_array(total) + bending * self.stiffness_matrix).solve(right)
            # Geman and McClure's robust weights: pairs far from the deformed template count less.
            away = np.linalg.norm(pairs.positions - positions[pairs.points], axis=1)
            far = max(_FAR * float(np.median(away)), self.target.spacing)
            trust = 1.0 / (1.0 + (away / far) ** 2) ** 2
            trust[len(trust) - pairs.n_certain :] = 1.0
            pull, pulled = self._pulled(pairs, pairs.weights * trust)
        return orientation, positions

    def _pulled(
        self, pairs: WeightedPairs, weights: Float[np.ndarray, " p"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        """The total weight of each point's pairs, and the weighted sum of their positions."""
        columns = [np.bincount(pairs.points, weights * axis, self.count) for axis in pairs.positions.T]
        return np.bincount(pairs.points, weights, self.count), np.stack(columns, axis=1)

    def _orientation(self, positions: Float[np.ndarray, "n 3"], weights: Float[np.ndarray, " n"]) -> int:
        """1 or -1 if most normals of template and target agree or disagree; 0 if neither, and for clouds."""
        if self.source.surface is None or self.target.surface is None:
            return 0
        below = self.target.normals(self.target.project(positions))
        assert below is not None
        agreement = np.einsum("pk,pk->p", self._normals(positions), below)
        share = float(np.average(np.sign(agreement), weights=weights))
        return int(np.sign(share)) if abs(share) > _ONE_SIDED else 0

    def _normals(self, positions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        assert self.source.surface is not None
        return Surface(positions, self.source.surface.faces).vertex_normals


def _laplacian(shape: Shape) -> tuple[sparse.sparray, Float[np.ndarray, " n"]]:
    """The Laplacian and the masses of a mesh or cloud."""
    return cloud_laplacian(shape.points) if shape.faces is None else mesh_laplacian(shape.points, shape.faces)


def _incidence(ends: Int[np.ndarray, "2 e"], count: int, *, sign: float) -> sparse.csr_array:
    """The incidence matrix of edges (n, e): 1 where an edge begins, ``sign`` where it ends."""
    edges = np.arange(ends.shape[1])
    entries = np.concatenate([np.ones(len(edges)), np.full(len(edges), sign)])
    return sparse.csr_array((entries, (ends.ravel(), np.concatenate([edges, edges]))), shape=(count, len(edges)))


class Factors:
    """A sparse LU factorisation of a symmetric positive definite matrix."""

    def __init__(self, matrix: sparse.sparray) -> None:
        self._factors = splu(sparse.csc_matrix(matrix), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})

    def solve(self, right: Float[np.ndarray, "n ..."]) -> Float[np.ndarray, "n ..."]:
        """The solution for each column."""
        return np.asarray(self._factors.solve(np.ascontiguousarray(right)))


def nearest_rotations(matrices: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3 3"]:
    """The rotation nearest to each matrix (Kabsch, 1976).

    Examples:
        >>> nearest_rotations(np.diag([2.0, 3.0, 1.0])[None]).round(6).tolist()
        [[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]]
    """
    left, _, right = np.linalg.svd(matrices)
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    return np.asarray(left @ right)
