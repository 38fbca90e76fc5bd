"""One closed surface around a mesh in many shells, by the winding number of its triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from jaxtyping import Bool, Float
from scipy.ndimage import label

from homolog.core.arguments import check_count
from homolog.core.errors import ShapeError
from homolog.geometry import Surface, split_long
from homolog.shapes import Shape
from homolog.volumes.surface import check_points, isosurface

# Inside, the winding number of a closed surface is 1, and outside 0.
_HALF = 0.5
# Margin around the shape, as a share of its longest side: the grid repeats, and what open shells leave there fades.
_MARGIN = 0.15
# Triangles are sampled at pieces with sides of at most so many voxels, and at most so many pieces.
_PIECE, _MOST_PIECES = 0.7, 4_000_000
# Standard deviation of the Gaussian that the surface is smoothed by, in voxels.
_SMOOTHING = 0.6


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

    def spread(self, points: Float[np.ndarray, "p 3"], values: Float[np.ndarray, " p"]) -> Float[np.ndarray, "i j k"]:
        """Sums of values at points, each spread over the eight voxels around it, trilinearly."""
        voxels = (points - self.origin) / self.side
        first = np.floor(voxels).astype(np.int64)
        beyond = voxels - first
        total = np.zeros(int(np.prod(self.shape)))
        for corner in np.ndindex(2, 2, 2):
            share = np.where(corner, beyond, 1 - beyond).prod(axis=1)
            at = np.ravel_multi_index(tuple((first + corner).T), self.shape, mode="wrap")
            total += np.bincount(at, share * values, len(total))
        return total.reshape(self.shape)


def wrapping_surface(mesh: Shape, *, points: int | None = 8000, resolution: int = 256) -> Shape:
    """The closed surface around all shells of a mesh: where the winding number of its triangles is one half.

    Shells may be open, overlap, lie within each other, or touch; of all regions inside, the largest is taken, and
    cavities are filled. What is nearer than about a voxel grows together.

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
    winding = _winding_number(grid, Surface(mesh.points, mesh.faces))
    inside = _largest_solid(winding > _HALF)
    if inside is None:
        raise ShapeError(f"{mesh.name}: its faces enclose nothing; check which way they face")
    # Outside of the solid the number stays just below one half, and within just above: there is no other surface.
    step = np.finfo(np.float32).eps
    solid = np.where(inside, np.maximum(winding, _HALF + step), np.minimum(winding, _HALF - step))
    return isosurface(solid, _HALF, grid.positions, points=points, name=mesh.name)


def _winding_number(grid: _Grid, surface: Surface) -> Float[np.ndarray, "i j k"]:
    """The winding number of triangles at all voxels, smoothed; 0 far away."""
    pieces = split_long(surface, _PIECE * grid.side, most=_MOST_PIECES).surface
    middles, areas = pieces.vertices[pieces.faces].mean(axis=1), pieces.face_vectors / (2 * grid.side**2)
    frequencies = [2 * np.pi * scipy.fft.fftfreq(n) for n in grid.shape[:2]]
    frequencies.append(2 * np.pi * scipy.fft.rfftfreq(grid.shape[2]))
    waves = np.meshgrid(*frequencies, indexing="ij", sparse=True)
    square = sum(wave**2 for wave in waves)
    square[0, 0, 0] = 1.0
    flux = sum(
        1j * wave * scipy.fft.rfftn(grid.spread(middles, component).astype(np.float32))
        for wave, component in zip(waves, areas.T, strict=True)
    )
    found = scipy.fft.irfftn(flux / square * np.exp(-0.5 * _SMOOTHING**2 * square), s=grid.shape)
    winding: np.ndarray = (found - found[0, 0, 0]).astype(np.float32)
    return winding


def _largest_solid(inside: Bool[np.ndarray, "i j k"]) -> Bool[np.ndarray, "i j k"] | None:
    """The largest connected region of voxels, with its cavities; None if there is none."""
    regions, count = label(inside)
    if not count:
        return None
    largest = regions == 1 + int(np.bincount(regions.ravel())[1:].argmax())
    around, _ = label(~largest)
    outside: np.ndarray = around == around[0, 0, 0]
    return ~outside
