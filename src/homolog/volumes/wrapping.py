"""One closed surface around a mesh in many shells, by the winding number of its triangles."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy.fft
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt, label, map_coordinates

from homolog.core.arguments import check_count
from homolog.core.errors import ShapeError
from homolog.geometry import Surface, split_long, surface_area, unit
from homolog.shapes import Shape, components, half_edges, mesh_components
from homolog.volumes.surface import check_points, isosurface

# Inside, the winding number of a closed surface is 1, and outside 0.
_HALF = 0.5
# Margin around the shape, as a share of its longest side: the grid repeats, and what open shells leave there fades.
_MARGIN = 0.15
# Triangles are sampled at pieces with sides of at most so many voxels, and at most so many pieces.
_PIECE, _MOST_PIECES = 0.7, 4_000_000
# Standard deviation of the Gaussian that the surface is smoothed by, in voxels.
_SMOOTHING = 0.6
# Layers are told on a coarser grid. A layer is not farther away than this from what it covers, in units of sqrt(area);
# no more than the second share of the area may lose its cover without it. Components with less than the third share of
# the area, or beyond so many, are taken together.
_COARSE, _LAYER, _LOST, _SMALL, _MOST_SHELLS = 96, 0.05, 0.002, 0.01, 20
# What is farther than this from all triangles, in voxels of the coarse grid, is free; one looks from so far before and
# behind each triangle, and a shell is turned round if its back is seen by more than such a share of its area.
_WALL, _LOOK, _SURE = 1.5, 3.5, 0.2


@dataclass(frozen=True)
class _Grid:
    """A grid of voxels that repeats.

    Args:
        origin: the centre of voxel (0, 0, 0).
        side: of a voxel.
        shape: how many voxels there are along each axis.
    """

    origin: Float[np.ndarray, " 3"]
    side: float
    shape: tuple[int, int, int]

    @classmethod
    def around(cls, points: Float[np.ndarray, "n 3"], resolution: int) -> _Grid:
        low, extent = points.min(axis=0), np.ptp(points, axis=0)
        side, margin = float(extent.max()) / resolution, _MARGIN * float(extent.max())
        counts = [scipy.fft.next_fast_len(int(np.ceil((length + 2 * margin) / side)), real=True) for length in extent]
        return cls(low - margin, side, (counts[0], counts[1], counts[2]))

    def positions(self, voxels: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
        """Convert voxel coordinates to positions."""
        found: np.ndarray = self.origin + self.side * voxels
        return found

    def at(self, field: Float[np.ndarray, "i j k"], points: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, " p"]:
        """Interpolate a field at points, trilinearly."""
        found: np.ndarray = map_coordinates(field, ((points - self.origin) / self.side).T, order=1)
        return found

    def spread(self, points: Float[np.ndarray, "p 3"], values: Float[np.ndarray, " p"]) -> Float[np.ndarray, "i j k"]:
        """Sums of values at points, each spread over the eight voxels around it, trilinearly."""
        voxels = ((points - self.origin) / self.side).T
        first = np.floor(voxels).astype(np.int64)
        beyond = voxels - first
        total = np.zeros(int(np.prod(self.shape)))
        # Along each axis, the two voxels around a point, and its share of each.
        sides = [((f % n, 1 - b), ((f + 1) % n, b)) for f, b, n in zip(first, beyond, self.shape, strict=True)]
        for (x, of_x), (y, of_y), (z, of_z) in product(*sides):
            at = (x * self.shape[1] + y) * self.shape[2] + z
            total += np.bincount(at, of_x * of_y * of_z * values, len(total))
        return total.reshape(self.shape)


@dataclass(frozen=True)
class _Samples:
    """Small pieces of triangles.

    Args:
        middles: of the pieces (p, 3).
        vectors: their normals, as long as their areas (p, 3).
        parents: the triangle that each is a piece of (p,).
    """

    middles: Float[np.ndarray, "p 3"]
    vectors: Float[np.ndarray, "p 3"]
    parents: Int[np.ndarray, " p"]

    @classmethod
    def of(cls, surface: Surface, side: float) -> _Samples:
        """Those of a surface on a grid of voxels of such a side."""
        split = split_long(surface, _PIECE * side, most=_MOST_PIECES)
        pieces = split.surface
        return cls(pieces.vertices[pieces.faces].mean(axis=1), pieces.face_vectors / 2, split.parents)

    @property
    def areas(self) -> Float[np.ndarray, " p"]:
        """The area of each piece."""
        found: np.ndarray = np.linalg.norm(self.vectors, axis=1)
        return found

    def depth(self, grid: _Grid, winding: Float[np.ndarray, "i j k"]) -> float:
        """How deep the pieces lie below others: the mean winding number in front of them."""
        in_front = self.middles + 2 * grid.side * unit(self.vectors)
        return float(np.average(grid.at(winding, in_front), weights=self.areas))


def wrapping_surface(mesh: Shape, *, points: int | None = 8000, resolution: int = 256) -> Shape:
    """The closed surface around all shells of a mesh: where the winding number of its triangles is one half.

    Shells may be open, overlap, lie within each other, or touch; of all regions inside, the largest is taken, and
    cavities are filled. What is nearer than about a voxel grows together. Clothes over a whole body are left out: the
    surface goes around the innermost shells that are whole without the others.

    The winding number is as in A. Jacobson et al., "Robust inside-outside segmentation using generalized winding
    numbers" (SIGGRAPH 2013). Its gradient is minus the normals, so that it solves a Poisson equation, as in M. Kazhdan,
    "Reconstruction of solid models from oriented point sets" (SGP 2005), here by a fast Fourier transform.

    Args:
        mesh: a clean mesh, whose faces run counter-clockwise from outside for the most part.
        points: approximate number of points; None for no simplification.
        resolution: number of voxels along its longest side.

    Returns:
        A closed mesh, oriented outwards, in the mesh's coordinates.

    Raises:
        ArgumentError: if a number is out of range.
        ShapeError: if it is no mesh, or its triangles enclose nothing.
        MissingExtraError: if scikit-image or fast-simplification is not installed.
    """
    check_points(points)
    check_count("resolution", resolution, least=16)
    if mesh.faces is None:
        raise ShapeError(f"{mesh.name} has no faces, but a surface around it needs them")
    grid = _Grid.around(mesh.points, resolution)
    faces = _without_layers(mesh, _facing_out(mesh, _in_accord(mesh.faces, mesh.n_points)))
    winding = _winding_number(grid, _Samples.of(Surface(mesh.points, faces), grid.side))
    inside = _largest_solid(winding)
    if not inside.any():
        raise ShapeError(f"{mesh.name}: its faces enclose nothing; check which way they face")
    # Outside of the solid the number stays just below one half, and within just above: there is no other surface.
    step = np.finfo(np.float32).eps
    solid = np.where(inside, np.maximum(winding, _HALF + step), np.minimum(winding, _HALF - step))
    return isosurface(solid, _HALF, grid.positions, points=points, name=mesh.name)


def _winding_number(grid: _Grid, samples: _Samples) -> Float[np.ndarray, "i j k"]:
    """The winding number of triangles at all voxels, smoothed; 0 far away."""
    frequencies = [2 * np.pi * scipy.fft.fftfreq(n) for n in grid.shape[:2]]
    frequencies.append(2 * np.pi * scipy.fft.rfftfreq(grid.shape[2]))
    waves = np.meshgrid(*frequencies, indexing="ij", sparse=True)
    square = sum(wave**2 for wave in waves)
    square[0, 0, 0] = 1.0
    flux = sum(
        1j * wave * scipy.fft.rfftn(grid.spread(samples.middles, component).astype(np.float32))
        for wave, component in zip(waves, samples.vectors.T / grid.side**2, strict=True)
    )
    found = scipy.fft.irfftn(flux / square * np.exp(-0.5 * _SMOOTHING**2 * square), s=grid.shape)
    winding: np.ndarray = (found - found[0, 0, 0]).astype(np.float32)
    return winding


def _largest_solid(winding: Float[np.ndarray, "i j k"]) -> Bool[np.ndarray, "i j k"]:
    """The largest connected region of voxels inside, with its cavities; no voxel if there is none."""
    regions, count = label(winding > _HALF)
    if not count:
        return np.zeros(winding.shape, dtype=bool)
    largest = regions == 1 + int(np.bincount(regions.ravel())[1:].argmax())
    around, _ = label(~largest)
    outside: np.ndarray = around == around[0, 0, 0]
    return ~outside


def _in_accord(faces: Int[np.ndarray, "m 3"], n_points: int) -> Int[np.ndarray, "m 3"]:
    """The faces with the fewer ones turned round of those that share an edge and run against each other."""
    sides = half_edges(faces)
    edge = np.sort(sides, axis=1) @ np.array([n_points, 1])
    order, runs_up = np.argsort(edge, kind="stable"), sides[:, 0] < sides[:, 1]
    _, first, count = np.unique(edge[order], return_index=True, return_counts=True)
    one, other = order[first[count == 2]], order[first[count == 2] + 1]
    # Each face is there twice, as it is and turned round, each linked to what it is in accord with.
    turned = len(faces) * (runs_up[one] == runs_up[other])
    a, b = one // 3, other // 3
    n_both = 2 * len(faces)
    links = np.concatenate([a, a + len(faces)]), np.concatenate([b + turned, (b + turned + len(faces)) % n_both])
    as_it_is, reversed_ = components(*links, n_both).reshape(2, -1)
    patch, is_turned = np.minimum(as_it_is, reversed_), reversed_ < as_it_is
    mostly = np.bincount(patch, is_turned) > np.bincount(patch, ~is_turned)
    return _turned(faces, (is_turned != mostly[patch]) & (as_it_is != reversed_))


def _facing_out(mesh: Shape, faces: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "m 3"]:
    """The faces with those components turned round whose back is to be seen from afar, and not their front."""
    grid = _Grid.around(mesh.points, _COARSE)
    component = mesh_components(mesh.points, faces)[0][faces[:, 0]]
    samples = _Samples.of(Surface(mesh.points, faces), grid.side)
    occupied = grid.spread(samples.middles, samples.areas) > 0
    free, _ = label(distance_transform_edt(~occupied) > _WALL)
    afar, step = (free == free[0, 0, 0]).astype(np.float32), _LOOK * grid.side * unit(samples.vectors)
    seen = grid.at(afar, samples.middles + step) - grid.at(afar, samples.middles - step)
    shell = component[samples.parents]
    votes, areas = np.bincount(shell, samples.areas * seen), np.bincount(shell, samples.areas)
    return _turned(faces, (votes < -_SURE * areas)[component])


def _turned(faces: Int[np.ndarray, "m 3"], which: Bool[np.ndarray, " m"]) -> Int[np.ndarray, "m 3"]:
    """The faces with some of them turned round."""
    return np.where(which[:, None], faces[:, ::-1], faces)


def _without_layers(mesh: Shape, faces: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "k 3"]:
    """The faces without shells that only cover others, such as clothes over a whole body, or lie within.

    The shells are gone through from the outside to the inside. One that can go without anything being left uncovered
    goes.
    """
    grid, shells = _Grid.around(mesh.points, _COARSE), _shells(mesh, faces)
    each_surface = (Surface(mesh.points, faces[shells == number]) for number in range(shells.max() + 1))
    samples = [_Samples.of(surface, grid.side) for surface in each_surface]
    windings = [_winding_number(grid, each) for each in samples]
    total, reach = np.sum(windings, axis=0), _LAYER * float(np.sqrt(surface_area(mesh))) / grid.side
    every, areas = [np.concatenate([getattr(each, name) for each in samples]) for name in ("middles", "areas")]

    def covered(winding: Float[np.ndarray, "i j k"]) -> float:
        inside = _largest_solid(winding)
        return 0.0 if not inside.any() else float(areas[grid.at(distance_transform_edt(~inside), every) <= reach].sum())

    kept, best = np.ones(len(faces), dtype=bool), covered(total)
    for number in np.argsort([each.depth(grid, total) for each in samples]):
        if covered(total - windings[number]) >= best - _LOST * areas.sum():
            total = total - windings[number]
            kept &= shells != number
    return faces[kept]


def _shells(mesh: Shape, faces: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, " m"]:
    """Which shell each face belongs to: the largest connected components, and all the others together."""
    component, areas = mesh_components(mesh.points, faces)
    order = np.argsort(-areas)
    is_large = np.arange(len(areas)) < np.minimum((areas > _SMALL * areas.sum()).sum(), _MOST_SHELLS)
    rank = np.empty(len(areas), dtype=np.int64)
    rank[order] = np.where(is_large, np.arange(len(areas)), is_large.sum())
    return np.unique(rank[component[faces[:, 0]]], return_inverse=True)[1]
