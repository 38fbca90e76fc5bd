"""Deformation transfer: how a mesh is deformed is done to another one, along a smooth map between the two.

R. W. Sumner and J. Popović, "Deformation transfer for triangle meshes" (SIGGRAPH 2004): each triangle of the source has
the gradient of its deformation, and the target is deformed so that its triangles have these gradients. The unknowns are
the vertices alone, as in the Poisson form of M. Botsch et al., "Deformation transfer for detail-preserving surface
editing" (2006). New here: gradients are turned along with the map, so that both meshes may stand in any way; points
whose counterparts do not move are held; and a weak pull to the moved counterparts says where loose parts belong.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy.sparse as sparse
from jaxtyping import Bool, Float, Int
from scipy.sparse.linalg import splu

from homolog.core.errors import ArgumentError
from homolog.geometry import Surface, unit
from homolog.geometry.deformation import RestShape, nearest_rotations
from homolog.geometry.projection import SurfacePoints
from homolog.transfer.smooth_map import SurfaceMap

# The middles of the four quarters of a triangle, in barycentric coordinates.
_QUARTERS = np.array([[1 / 3, 1 / 3, 1 / 3], [2 / 3, 1 / 6, 1 / 6], [1 / 6, 2 / 3, 1 / 6], [1 / 6, 1 / 6, 2 / 3]])
# What moves less than this share of the largest offset does not move.
_STILL = 1e-5
# Of the pull to the moved counterparts, for waves as long as the unit; gradients count some forty times one.
_PULL = 1e-2
# The share of a triangle without a counterpart.
_UNKNOWN = 1e-3
_HOLD = 1e-9  # keeps the matrix definite where nothing pulls
# Areas below this share of the mean count as that much.
_SMALLEST_AREA = 1e-6


class DeformationTransfer:
    """Transfers deformations of one mesh to another.

    Args:
        to_source: the map from the target, which is to be deformed, to the source.

    Raises:
        ArgumentError: if either shape has no faces.

    Examples:
        >>> smile = DeformationTransfer(transfer.to_source).offsets(smile_of_source)  # doctest: +SKIP
    """

    def __init__(self, to_source: SurfaceMap) -> None:
        self.map = to_source
        for projector in (to_source.source, to_source.target):
            if projector.surface is None:
                raise ArgumentError(f"{projector.given.name} has no faces, but deformations are those of triangles")
        assert to_source.source.surface is not None and to_source.target.given.faces is not None
        self._surface: Surface = to_source.source.surface
        self._kept = to_source.source.repaired.kept
        self._last: tuple[Bool[np.ndarray, " n"], sparse.linalg.SuperLU] | None = None

    def offsets(self, offsets: Float[np.ndarray, "n_source 3"]) -> Float[np.ndarray, "n_target 3"]:
        """The target's offsets for those of the source's points, each in the coordinates of its shape.

        Points whose counterparts do not move, and those that repair leaves out, have exactly zero. Points without a
        counterpart follow their neighbours.

        Args:
            offsets: what each point of the source is moved by.

        Raises:
            ArgumentError: if there is not one for each point.
        """
        if np.shape(offsets) != self.map.target.given.points.shape:
            count = self.map.target.given.n_points
            raise ArgumentError(f"offsets has shape {np.shape(offsets)}, but must have shape ({count}, 3)")
        # The counterparts' offsets, turned and scaled as the map is; zero without a counterpart.
        rotations, scales = self._similarities
        at_points = np.nan_to_num(self.map.surface_points.interpolate(offsets)[self._kept])
        pulled = np.einsum("nji,nj->ni", rotations, at_points) / scales[:, None]
        largest = float(np.linalg.norm(pulled, axis=1).max(initial=0.0))
        still = self._known & (np.linalg.norm(pulled, axis=1) <= _STILL * largest)
        found = np.zeros_like(pulled)
        if not still.all():
            right = self._gradient.T @ (self._gradients(offsets) * self._weights[:, None])
            right += self._pull[:, None] * pulled
            found[~still] = self._factors(~still).solve(right[~still])
        found[np.linalg.norm(found, axis=1) <= _STILL * np.linalg.norm(found, axis=1).max(initial=0.0)] = 0.0
        return np.asarray(self.map.source.repaired.to_original(found, fill=0.0))

    @cached_property
    def _known(self) -> Bool[np.ndarray, " n"]:
        """Which vertices have a counterpart."""
        return np.asarray(self.map.surface_points.valid[self._kept])

    @cached_property
    def _similarities(self) -> tuple[Float[np.ndarray, "n 3 3"], Float[np.ndarray, " n"]]:
        """How the surroundings of each vertex are turned and scaled from the target to the source."""
        rest = RestShape.of(self.map.source.shape)
        positions = np.nan_to_num(self.map.positions[self._kept])
        return rest.local_similarities(
            positions, self._known[rest.ends].all(axis=0), self.map.target.unit / self.map.source.unit
        )

    @cached_property
    def _areas(self) -> Float[np.ndarray, " m"]:
        areas = np.linalg.norm(self._surface.face_vectors, axis=1) / 2
        return np.asarray(np.maximum(areas, _SMALLEST_AREA * areas.mean()))

    @cached_property
    def _weights(self) -> Float[np.ndarray, " m3"]:
        """The area of each triangle, thrice; less where it has no counterpart, so that it follows its neighbours."""
        known = (self._below.reshape(-1, len(_QUARTERS)) >= 0).any(axis=1)
        return np.repeat(self._areas * np.where(known, 1.0, _UNKNOWN), 3)

    @cached_property
    def _gradient(self) -> sparse.csr_array:
        """The gradient (3m, n) of a function that is linear on each of the target's triangles."""
        corners = self._surface.vertices[self._surface.faces]
        opposite = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
        hats = np.cross(self._surface.face_normals[:, None], opposite) / (2 * self._areas[:, None, None])
        count = len(corners)
        rows = np.broadcast_to(3 * np.arange(count)[:, None, None] + np.arange(3), (count, 3, 3))
        columns = np.broadcast_to(self._surface.faces[:, :, None], (count, 3, 3))
        shape = (3 * count, len(self._surface.vertices))
        return sparse.csr_array((hats.ravel(), (rows.ravel(), columns.ravel())), shape=shape)

    @cached_property
    def _pull(self) -> Float[np.ndarray, " n"]:
        """The weight of the pull to each vertex's moved counterpart."""
        mass = np.bincount(self._surface.faces.ravel(), np.repeat(self._areas / 3, 3), len(self._surface.vertices))
        return np.asarray(mass * self._known * _PULL / self.map.source.unit**2)

    @cached_property
    def _matrix(self) -> sparse.csr_array:
        weighted = sparse.diags_array(self._weights) @ self._gradient
        held = sparse.diags_array(self._pull + _HOLD)
        return sparse.csr_array(self._gradient.T @ weighted + held)

    def _factors(self, free: Bool[np.ndarray, " n"]) -> sparse.linalg.SuperLU:
        """The factors of the equations of the vertices that may move; those of the last deformation if they are its."""
        if self._last is None or not np.array_equal(self._last[0], free):
            matrix = sparse.csc_matrix(self._matrix[free][:, free])
            self._last = free, splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        return self._last[1]

    @cached_property
    def _below(self) -> Int[np.ndarray, " m4"]:
        """The source's triangle below the middle of each quarter of the target's triangles; -1 for none."""
        corners = np.repeat(self._kept[self._surface.faces], len(_QUARTERS), axis=0)
        middles = SurfacePoints(corners, np.tile(_QUARTERS, (len(self._surface.faces), 1)))
        faces = self.map.apply(middles).faces
        assert faces is not None
        return faces

    def _gradients(self, offsets: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m3 3"]:
        """The gradients of the offsets that the target's triangles should have, (3m, 3): rows are directions."""
        rotations, _ = self._similarities
        turns = nearest_rotations(rotations[self._surface.faces].sum(axis=1))
        faces = self._below
        of_source, usable = _deformation_gradients(
            self.map.target.given.points, np.asarray(self.map.target.given.faces), offsets
        )
        counted = ((faces >= 0) & usable[faces]).reshape(-1, len(_QUARTERS))
        sums = (of_source[faces].reshape(*counted.shape, 3, 3) * counted[:, :, None, None]).sum(axis=1)
        mean = sums / np.maximum(counted.sum(axis=1), 1)[:, None, None]
        # From the source's axes to the target's, on both sides; and without what leaves the triangle's plane.
        turned = turns.transpose(0, 2, 1) @ mean @ turns
        normals = self._surface.face_normals
        within = np.eye(3) - normals[:, :, None] * normals[:, None, :]
        return np.asarray((turned @ within).transpose(0, 2, 1).reshape(-1, 3))


def _deformation_gradients(
    points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], offsets: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "m 3 3"], Bool[np.ndarray, " m"]]:
    """The gradient of each triangle's deformation less the identity, and which triangles have one.

    Two sides and the normal over the root of its length (Sumner and Popović 2004, equations 2 to 4) make a frame. The
    gradient takes the frame of the triangle to that of the moved triangle.
    """
    usable: Bool[np.ndarray, " m"] = np.linalg.norm(np.nan_to_num(_frames(points[faces])[:, :, 2]), axis=1) > 0
    gradients = np.zeros((len(faces), 3, 3))
    moving = np.flatnonzero(usable & np.any(offsets != 0, axis=1)[faces].any(axis=1))
    frames, moved = _frames(points[faces[moving]]), _frames((points + offsets)[faces[moving]])
    gradients[moving] = (moved - frames) @ np.linalg.inv(frames)
    return gradients, usable


def _frames(corners: Float[np.ndarray, "m 3 3"]) -> Float[np.ndarray, "m 3 3"]:
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    vectors = np.cross(first, second)
    normals = unit(vectors) * np.sqrt(np.linalg.norm(vectors, axis=1, keepdims=True))
    return np.stack([first, second, normals], axis=2)
