"""For each point of one shape a place on another's surface, made smooth from point-to-point maps.

A point map leads from vertex to vertex, so that it folds and tears at the size of the triangles. Here shape a is laid
over shape b as an elastic skin (Sorkine and Alexa, "As-rigid-as-possible surface modeling", SGP 2007, with a scale of
its own everywhere): it is pulled to where both point maps want it, by their confidence, less where that is far from
where its neighbours go, and to b's surface (as in non-rigid ICP, Amberg et al., CVPR 2007). Smoothing the positions
themselves, as harmonic and biharmonic energies do, would shrink fingers and feet to less than their meshes can show.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sparse
from jaxtyping import Bool, Float, Int
from scipy.sparse.linalg import splu

from homolog.core.errors import ArgumentError
from homolog.geometry import Surface, cloud_laplacian, mesh_laplacian, unit
from homolog.matching import Match
from homolog.shapes import Shape
from homolog.transfer.places import PlaceFinder, ShapePlaces

# Lengths are in spacings of a's points.
_STIFFNESS = 3.0  # Below this length the skin keeps its form, above it follows the point maps.
_TURN_SMOOTHING = 2.0  # Rotations are those of patches of this radius,
_SCALE_SMOOTHING = 10.0  # and scales those of patches of this one.
_SCALES = (0.2, 5.0)  # of the shape as a whole
_ROUNDS = 8
_FREE_ROUNDS = 2  # The first ones know nothing of b's surface.
_SURFACE_PULL = 1.0
# A pair of points that is so many times the median distance away from where the skin is counts a quarter.
_FAR = 2.0
_LEAST_CONFIDENCE = 0.01
_HOLD = 1e-9  # keeps the matrices definite where nothing pulls
# The share of agreement above which normals tell the sides of b's surface.
_ONE_SIDED = 0.5


class SurfaceMap:
    """For each point of a shape a place on another's surface.

    Args:
        start: the shape that the map leads from.
        goal: the one that it leads to.
        positions: for each of the start's points, in the goal's coordinates, about where it comes to lie; NaN where it
            has no counterpart (n, 3).
        turned: 1 if both have their outer sides on the same side of their triangles, -1 if on different ones, and 0 if
            sides cannot be told.
    """

    def __init__(
        self, start: PlaceFinder, goal: PlaceFinder, positions: Float[np.ndarray, "n 3"], *, turned: int = 0
    ) -> None:
        self.start, self.goal, self.turned = start, goal, turned
        self.places: ShapePlaces = goal.places(positions, self._normals_of(positions) if turned else None)
        """The place of each of the start's points."""

    @cached_property
    def positions(self) -> Float[np.ndarray, "n 3"]:
        """Where the places lie, in the goal's coordinates; NaN where there is no counterpart."""
        return self.goal.positions(self.places)

    @cached_property
    def flipped_triangles(self) -> Bool[np.ndarray, " m"] | None:
        """Which of the start's triangles, as repaired, lie turned over on the goal; None where either is a cloud.

        A triangle is turned over if its normal looks away from the goal's below it. Where sides cannot be told, most
        are taken to lie as they should.
        """
        below = self.goal.normals(self.places)
        if below is None or self.start.surface is None:
            return None
        kept, faces = self.start.repaired.kept, self.start.surface.faces
        laid = Surface(self.positions[kept], faces)
        agreement = np.sign(np.einsum("mk,mk->m", laid.face_vectors, below[kept][faces].sum(axis=1)))
        return np.asarray(agreement * (self.turned or np.sign(agreement.sum())) < 0)

    def at(self, places: ShapePlaces) -> ShapePlaces:
        """The places on the goal of places on the start, continuous across its triangles.

        A place whose corner with the largest weight has no counterpart has none; of the others' corners, only those
        with one count.
        """
        known = self.places.exist[places.corners] & ~np.isnan(places.weights)
        weights = np.where(known, places.weights, 0.0)
        largest = np.nan_to_num(places.weights).argmax(axis=1)
        exist = known[np.arange(len(known)), largest]
        with np.errstate(invalid="ignore"):
            weights = weights / weights.sum(axis=1, keepdims=True)
        amid = ShapePlaces(places.corners, weights).only(exist)
        normals = None if not self.turned or self._normals is None else unit(np.nan_to_num(amid.values(self._normals)))
        return self.goal.places(amid.values(self.positions), normals)

    @cached_property
    def _normals(self) -> Float[np.ndarray, "n 3"] | None:
        found = self.goal.normals(self.places)
        return None if found is None else np.where(self.places.exist[:, None], found, 0.0)

    def _normals_of(self, positions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """The normals that the start's triangles have once they are laid over the goal."""
        assert self.start.shape.faces is not None
        laid = Surface(np.nan_to_num(positions[self.start.repaired.kept]), self.start.shape.faces)
        return self.start.repaired.to_original(self.turned * laid.vertex_normals, fill=0.0)


def surface_map(start: Shape | PlaceFinder, goal: Shape | PlaceFinder, found: Match) -> SurfaceMap:
    """Make a smooth map between surfaces of the point maps between their points.

    Args:
        start: the shape that the map is to lead from, in any state.
        goal: the one that it is to lead to.
        found: point maps between the two, with ``start`` for their source; ``found.inverse()`` for the other way.

    Returns:
        A place on the goal for each of the start's points that ``found`` has a counterpart for.

    Raises:
        ArgumentError: if the point maps are those of other shapes, or no point has a counterpart.
        ShapeError: if a shape cannot be repaired, or is too degenerate for a Laplacian.
    """
    start, goal = (shape if isinstance(shape, PlaceFinder) else PlaceFinder(shape) for shape in (start, goal))
    pairs = _pairs(start, goal, found)
    turned, laid = _Skin(start, goal, pairs).laid()
    positions = start.repaired.to_original(laid, fill=np.nan)
    positions[found.source_to_target < 0] = np.nan
    return SurfaceMap(start, goal, positions, turned=turned)


@dataclass(frozen=True)
class _Pairs:
    """Points of the start, where they belong on the goal, and how much each such pair counts."""

    points: Int[np.ndarray, " p"]
    positions: Float[np.ndarray, "p 3"]
    weights: Float[np.ndarray, " p"]


def _pairs(start: PlaceFinder, goal: PlaceFinder, found: Match) -> _Pairs:
    """The pairs of both directions, those of each adding up to a weight of at most one."""
    for finder, indices, other in (
        (start, found.source_to_target, goal),
        (goal, found.target_to_source, start),
    ):
        if len(indices) != finder.given.n_points or indices.max(initial=-1) >= other.given.n_points:
            raise ArgumentError(
                f"the point maps are not those of {finder.given.name}; give the shapes that were matched"
            )
    there = _clean_map(start, goal, found.source_to_target)
    back = _clean_map(goal, start, found.target_to_source)
    (leave,), (arrive,) = np.nonzero(there >= 0), np.nonzero(back >= 0)
    if not len(leave) + len(arrive):
        raise ArgumentError(f"no point of {start.given.name} has a counterpart, so that nothing can be transferred")
    confidences = (found.source_confidence[start.repaired.kept], found.target_confidence[goal.repaired.kept])
    there_weights, back_weights = (confidence.clip(_LEAST_CONFIDENCE) / len(confidence) for confidence in confidences)
    return _Pairs(
        np.concatenate([leave, back[arrive]]),
        goal.shape.points[np.concatenate([there[leave], arrive])],
        np.concatenate([there_weights[leave], back_weights[arrive]]),
    )


def _clean_map(start: PlaceFinder, goal: PlaceFinder, indices: Int[np.ndarray, " n"]) -> Int[np.ndarray, " k"]:
    """A point map between shapes as given, as one between the repaired ones."""
    given = indices[start.repaired.kept]
    return np.asarray(np.where(given >= 0, goal.repaired.clean_index[given], -1))


class _Skin:
    """The start's surface, laid over the goal's. Masses add up to one, so that lengths are shares of the unit."""

    def __init__(self, start: PlaceFinder, goal: PlaceFinder, pairs: _Pairs) -> None:
        self.start, self.goal, self.pairs = start, goal, pairs
        self.count = start.shape.n_points
        laplacian, mass = _laplacian(start.shape)
        self.mass = mass / mass.sum()
        links = sparse.coo_array(sparse.triu(-laplacian, 1))
        held = links.data > 0
        self.ends, self.strengths = np.stack([links.row, links.col])[:, held], links.data[held]
        self.rest = start.shape.points[self.ends[0]] - start.shape.points[self.ends[1]]
        self.around = _incidence(self.ends, self.count, sign=1.0) @ sparse.diags_array(self.strengths)
        self.differences = _incidence(self.ends, self.count, sign=-1.0)
        self.elastic = self.differences @ sparse.diags_array(self.strengths) @ self.differences.T
        self.turn_smoother = self._smoother(_TURN_SMOOTHING)
        self.scale_smoother = self._smoother(_SCALE_SMOOTHING)

    def laid(self) -> tuple[int, Float[np.ndarray, "n 3"]]:
        """Which way the surfaces face each other, and where the start's points come to lie."""
        weights, turned = self.pairs.weights, 0
        pull, wanted = self._pulled(weights)
        # At first every point lies where its pairs want it; rotations come from links of which both ends are wanted.
        positions = wanted / np.where(pull > 0, pull, 1.0)[:, None]
        known = (pull > 0)[self.ends].all(axis=0)
        for turn in range(_ROUNDS):
            stiffness = self._length(_STIFFNESS) ** 2
            bent = stiffness * self._bent(positions, known if turn == 0 else np.ones_like(known))
            total, right = pull + _HOLD * self.mass, wanted + bent
            if turn >= _FREE_ROUNDS:
                turned = turned or self._turned(positions)
                surface_pull = _SURFACE_PULL * self.mass * self.covered
                total, right = total + surface_pull, right + surface_pull[:, None] * self._on_goal(positions, turned)
            positions = _factorised(sparse.diags_array(total) + stiffness * self.elastic).solve(right)
            pull, wanted = self._pulled(weights * self._trust(positions))
        return turned, positions

    @cached_property
    def covered(self) -> Bool[np.ndarray, " n"]:
        """Which points any pair is of."""
        return np.bincount(self.pairs.points, minlength=self.count) > 0

    def _length(self, spacings: float) -> float:
        return spacings / float(np.sqrt(self.count))

    def _smoother(self, spacings: float) -> _Factors:
        return _factorised(sparse.diags_array(self.mass) + self._length(spacings) ** 2 * self.elastic)

    def _pulled(self, weights: Float[np.ndarray, " p"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        """How strongly each point is pulled, and to where, times that."""
        columns = [np.bincount(self.pairs.points, weights * axis, self.count) for axis in self.pairs.positions.T]
        return np.bincount(self.pairs.points, weights, self.count), np.stack(columns, axis=1)

    def _bent(self, positions: Float[np.ndarray, "n 3"], known: Bool[np.ndarray, " e"]) -> Float[np.ndarray, "n 3"]:
        """The forces that the links exert at rest, each turned and scaled as the patches around its ends are."""
        now = (positions[self.ends[0]] - positions[self.ends[1]]) * known[:, None]
        spread = self.around @ (now[:, :, None] * self.rest[:, None, :]).reshape(-1, 9)
        rotations, sizes = _nearest_rotations(self.turn_smoother.solve(spread).reshape(-1, 3, 3), spread)
        rest_sizes = self.around @ (known * (self.rest**2).sum(axis=1))
        with np.errstate(divide="ignore", invalid="ignore"):
            # Without any link between points that are wanted somewhere, the shapes' own sizes tell.
            whole = sizes.sum() / rest_sizes.sum() if known.any() else self.goal.unit / self.start.unit
            scales = self.scale_smoother.solve(sizes) / (whole * self.scale_smoother.solve(rest_sizes))
        scales = whole * np.nan_to_num(scales, nan=1.0).clip(*_SCALES)
        turns = (rotations * scales[:, None, None])[self.ends].mean(axis=0)
        forces = self.strengths[:, None] * np.einsum("ekl,el->ek", turns, self.rest)
        return np.asarray(self.differences @ forces)

    def _turned(self, positions: Float[np.ndarray, "n 3"]) -> int:
        """1 or -1 if most normals of skin and goal agree or disagree; 0 if neither, and for clouds."""
        if self.start.surface is None or self.goal.surface is None:
            return 0
        below = self.goal.normals(self.goal.places(positions))
        assert below is not None
        agreement = np.einsum("pk,pk->p", self._normals(positions), below)
        share = float(np.average(np.sign(agreement), weights=self.mass * self.covered))
        return int(np.sign(share)) if abs(share) > _ONE_SIDED else 0

    def _normals(self, positions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        assert self.start.surface is not None
        return Surface(positions, self.start.surface.faces).vertex_normals

    def _on_goal(self, positions: Float[np.ndarray, "n 3"], turned: int) -> Float[np.ndarray, "n 3"]:
        normals = turned * self._normals(positions) if turned else None
        return self.goal.positions(self.goal.places(positions, normals))

    def _trust(self, positions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " p"]:
        """How far to believe each pair, by how far it is from where the skin lies (Geman and McClure's weights)."""
        away = np.linalg.norm(self.pairs.positions - positions[self.pairs.points], axis=1)
        far = max(_FAR * float(np.median(away)), self.goal.spacing)
        return np.asarray(1.0 / (1.0 + (away / far) ** 2) ** 2)


def _laplacian(shape: Shape) -> tuple[sparse.csr_matrix, Float[np.ndarray, " n"]]:
    return cloud_laplacian(shape.points) if shape.faces is None else mesh_laplacian(shape.points, shape.faces)


def _incidence(ends: Int[np.ndarray, "2 e"], count: int, *, sign: float) -> sparse.csr_array:
    """(n, e): 1 where a link begins, ``sign`` where it ends."""
    links = np.arange(ends.shape[1])
    entries = np.concatenate([np.ones(len(links)), np.full(len(links), sign)])
    return sparse.csr_array((entries, (ends.ravel(), np.concatenate([links, links]))), shape=(count, len(links)))


class _Factors:
    """A factorised matrix, symmetric and positive definite."""

    def __init__(self, matrix: sparse.sparray) -> None:
        self._factors = splu(sparse.csc_matrix(matrix), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})

    def solve(self, right: Float[np.ndarray, "n ..."]) -> Float[np.ndarray, "n ..."]:
        """The solution for each column."""
        return np.asarray(self._factors.solve(np.ascontiguousarray(right)))


def _factorised(matrix: sparse.sparray) -> _Factors:
    return _Factors(matrix)


def _nearest_rotations(
    smooth: Float[np.ndarray, "n 3 3"], spread: Float[np.ndarray, "n 9"]
) -> tuple[Float[np.ndarray, "n 3 3"], Float[np.ndarray, " n"]]:
    """The rotation nearest to each matrix, and how far the unsmoothed matrices stretch along with it."""
    left, _, right = np.linalg.svd(smooth)
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    rotations = left @ right
    return rotations, np.einsum("nkl,nkl->n", rotations, spread.reshape(-1, 3, 3))
