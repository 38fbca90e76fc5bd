"""Surfaces of segmentation masks by marching cubes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter

from homolog.core.arguments import check_count, is_real
from homolog.core.errors import bad_value, needs_extra
from homolog.shapes import FEWEST_POINTS, Shape
from homolog.volumes.mask import Mask

# A closed surface of genus 0 has twice as many triangles as vertices, less four (Euler).
_FACES_PER_POINT = 2
# The Gaussian is cut off at this many standard deviations.
_REACH = 4.0


def mask_surface(mask: Mask, *, points: int | None = 5000, smoothing: float = 1.0) -> Shape:
    """The surface of a segmentation mask by marching cubes, in millimetres.

    The mask is smoothed first, to remove the voxels' steps; the isovalue is chosen so that the volume is preserved. The
    mesh is then simplified by edge collapses.

    W. Lorensen and H. Cline, "Marching cubes" (SIGGRAPH 1987), with the cases of T. Lewiner et al. (2003), which close
    every surface; M. Garland and P. Heckbert, "Surface simplification using quadric error metrics" (SIGGRAPH 1997).

    Args:
        mask: of the object.
        points: approximate number of points after simplification; None for no simplification.
        smoothing: standard deviation of the Gaussian filter, in voxels along each axis; 0 for none.

    Returns:
        A closed mesh, oriented outwards; it has as many components as the mask.

    Raises:
        ArgumentError: if a number is out of range.
        MissingExtraError: if scikit-image or fast-simplification is not installed.

    Examples:
        >>> ball = np.linalg.norm(np.indices((20, 20, 20)) - 9.5, axis=0) < 8
        >>> surface = mask_surface(Mask(ball, np.zeros(3), np.eye(3)), points=200)
        >>> float(np.linalg.norm(surface.points - 9.5, axis=1).mean().round())
        8.0
    """
    check_points(points)
    if not (is_real(smoothing) and smoothing >= 0):
        raise bad_value("smoothing", smoothing, "a number of voxels of at least 0")
    box = mask.cropped(int(np.ceil(_REACH * smoothing)) + 1)
    density = gaussian_filter(box.inside.astype(np.float32), smoothing, truncate=_REACH)
    return isosurface(density, _isovalue(density, box.inside), box.positions, points=points, name=mask.name)


def check_points(points: int | None) -> None:
    """Refuse a number of points that no surface can have."""
    if points is not None:
        check_count("points", points, least=FEWEST_POINTS)


def isosurface(
    density: Float[np.ndarray, "i j k"],
    isovalue: float,
    positions: Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, "n 3"]],
    *,
    points: int | None,
    name: str,
) -> Shape:
    """Extract an isosurface by marching cubes, and simplify it.

    Args:
        density: per voxel; below the isovalue at the borders.
        isovalue: of the surface.
        positions: converts voxel coordinates to positions.
        points: approximate largest number of points; None for no simplification.
        name: of the surface.

    Returns:
        A closed mesh, oriented outwards.
    """
    with needs_extra("making surfaces of volumes", "volumes"):
        from skimage import measure
    extract: Any = measure.marching_cubes
    voxels, faces, _, _ = extract(density, isovalue, allow_degenerate=False)
    found, faces = positions(voxels.astype(np.float64)), faces.astype(np.int64)
    if points is not None and len(found) > points:
        found, faces = simplified(found, faces, points)
    p, q, r = np.moveaxis((found - found.mean(axis=0))[faces], 1, 0)
    outwards = np.einsum("nk,nk->", p, np.cross(q, r)) >= 0  # the sign of the enclosed volume
    return Shape(found, faces if outwards else faces[:, ::-1].copy(), name=name)


def _isovalue(density: Float[np.ndarray, "i j k"], inside: Bool[np.ndarray, "i j k"]) -> float:
    """The isovalue that preserves the volume: as many voxels exceed it as are inside."""
    n_outside = int((~inside).sum())
    return float(np.partition(density, (n_outside - 1, n_outside), axis=None)[n_outside - 1 : n_outside + 1].mean())


def simplified(
    points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], count: int
) -> tuple[Float[np.ndarray, "p 3"], Int[np.ndarray, "f 3"]]:
    """Quadric edge collapse (Garland and Heckbert, 1997)."""
    with needs_extra("making surfaces smaller", "volumes"):
        from fast_simplification import simplify
    # It works in single precision, which is enough for positions relative to their mean.
    middle = points.mean(axis=0)
    found, triangles = simplify(
        (points - middle).astype(np.float32), faces.astype(np.int32), target_count=_FACES_PER_POINT * count
    )
    return found.astype(np.float64) + middle, triangles.astype(np.int64)
