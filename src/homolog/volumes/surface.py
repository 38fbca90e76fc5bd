"""The surface of what a mask marks."""

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

# A closed surface of genus 0 has twice as many triangles as vertices, but for a few.
_FACES_PER_POINT = 2
# Beyond so many standard deviations a Gaussian is nothing.
_REACH = 4.0


def mask_surface(mask: Mask, *, points: int | None = 5000, smoothing: float = 1.0) -> Shape:
    """The surface of what a mask marks, by marching cubes, in millimetres.

    The mask is blurred first, which takes its steps away, and the surface drawn where it encloses as much as the mask
    does. Then edges are collapsed until about so many points are left.

    W. Lorensen and H. Cline, "Marching cubes" (SIGGRAPH 1987), with the cases of T. Lewiner et al. (2003), which close
    every surface; M. Garland and P. Heckbert, "Surface simplification using quadric error metrics" (SIGGRAPH 1997).

    Args:
        mask: what is inside.
        points: about how many points the surface is to have; fewer if it has fewer; None for all.
        smoothing: standard deviation of the blur in voxels, along each axis of the volume; 0 for none.

    Returns:
        A closed mesh with its faces turned outwards; several pieces where the mask has several.

    Raises:
        ArgumentError: if a number is out of range.
        MissingExtraError: if scikit-image or fast-simplification is not installed.
    """
    check_points(points)
    if not (is_real(smoothing) and smoothing >= 0):
        raise bad_value("smoothing", smoothing, "a number of voxels of at least 0")
    box = mask.cropped(int(np.ceil(_REACH * smoothing)) + 1)
    density = gaussian_filter(box.inside.astype(np.float32), smoothing, truncate=_REACH)
    return level_surface(density, _level(density, box.inside), box.positions, points=points, name=mask.name)


def check_points(points: int | None) -> None:
    """Refuse numbers of points that no surface can have."""
    if points is not None:
        check_count("points", points, least=FEWEST_POINTS)


def level_surface(
    density: Float[np.ndarray, "i j k"],
    level: float,
    positions: Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, "n 3"]],
    *,
    points: int | None,
    name: str,
) -> Shape:
    """The surface around where a density exceeds a level.

    Args:
        density: per voxel; below the level along the borders.
        level: of the surface.
        positions: where places given in voxels are.
        points: about how many points the surface is to have, at most; None for all.
        name: of the surface.

    Returns:
        A closed mesh with its faces turned outwards.
    """
    places, faces, _, _ = _marching_cubes()(density, level, allow_degenerate=False)
    found, faces = positions(places.astype(np.float64)), faces.astype(np.int64)
    if points is not None and len(found) > points:
        found, faces = _simplified(found, faces, points)
    return Shape(found, _outwards(found, faces), name=name)


def _level(density: Float[np.ndarray, "i j k"], inside: Bool[np.ndarray, "i j k"]) -> float:
    """What the density exceeds in as many voxels as are inside."""
    n_outside = int((~inside).sum())
    return float(np.partition(density, (n_outside - 1, n_outside), axis=None)[n_outside - 1 : n_outside + 1].mean())


def _simplified(
    points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], count: int
) -> tuple[Float[np.ndarray, "p 3"], Int[np.ndarray, "f 3"]]:
    # Single precision is enough for positions about their middle.
    middle = points.mean(axis=0)
    found, triangles = _simplify()(
        (points - middle).astype(np.float32), faces.astype(np.int32), target_count=_FACES_PER_POINT * count
    )
    return found.astype(np.float64) + middle, triangles.astype(np.int64)


def _outwards(points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "m 3"]:
    """Faces turned so that the volume they enclose is positive."""
    p, q, r = np.moveaxis((points - points.mean(axis=0))[faces], 1, 0)
    return faces if np.einsum("nk,nk->", p, np.cross(q, r)) >= 0 else faces[:, ::-1].copy()


def _marching_cubes() -> Any:
    with needs_extra("making surfaces of volumes", "volumes"):
        from skimage.measure import marching_cubes
    return marching_cubes


def _simplify() -> Any:
    with needs_extra("making surfaces smaller", "volumes"):
        from fast_simplification import simplify
    return simplify
