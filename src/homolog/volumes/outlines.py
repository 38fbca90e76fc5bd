"""Point clouds of outlines: an object of which only some slices are known."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from homolog.core.arguments import check_count, is_real
from homolog.core.errors import ShapeError, bad_value, needs_extra
from homolog.shapes import FEWEST_POINTS, Shape, farthest_points
from homolog.volumes.mask import Mask


def slice_cloud(
    mask: Mask,
    *,
    axis: int = 2,
    every: int = 1,
    span: tuple[float, float] = (0.0, 1.0),
    points: int | None = None,
    seed: int = 0,
) -> Shape:
    """The contours of an object in some slices of a volume as a point cloud, in millimetres, by marching squares.

    D. Cao and F. Bernard (CVPR 2023) match lungs with such clouds, made from a subset of a scan's slices.

    Args:
        mask: of the object.
        axis: normal to the slices: 0, 1 or 2, for i, j or k.
        every: use every n-th slice.
        span: use the slices between these two shares of the object's extent.
        points: number of points, by farthest point sampling; None for all.
        seed: of that sampling.

    Raises:
        ArgumentError: if a number is out of range, or there are fewer points.
        ShapeError: if these slices are too few for a cloud.
        MissingExtraError: if scikit-image is not installed.

    Examples:
        >>> ball = np.linalg.norm(np.indices((20, 20, 20)) - 9.5, axis=0) < 8
        >>> cloud = slice_cloud(Mask(ball, np.zeros(3), np.eye(3)), every=4, points=100)
        >>> cloud.points.shape
        (100, 3)
    """
    if axis not in (0, 1, 2):
        raise bad_value("axis", axis, "0, 1 or 2")
    check_count("every", every)
    if not (all(map(is_real, span)) and 0 <= span[0] < span[1] <= 1):
        raise bad_value("span", span, "two shares, the first smaller, from 0 to 1")
    box = mask.cropped(1)
    n_slices = box.inside.shape[axis] - 2
    chosen = 1 + np.arange(round(span[0] * n_slices), round(span[1] * n_slices))[::every]
    contours = [_contours(box.inside.take(number, axis=axis), axis, number) for number in chosen]
    found = box.positions(np.concatenate([np.zeros((0, 3)), *contours]))
    if len(found) < FEWEST_POINTS:
        raise ShapeError(f"{mask.name}: {len(chosen)} slices have {len(found)} points in all; take more slices")
    if points is not None:
        if not 1 <= points <= len(found):
            raise bad_value("points", points, f"from 1 to the number of points of these outlines, {len(found)}")
        found = found[farthest_points(found, points, seed=seed)]
    return Shape(found, None, name=mask.name)


def _contours(inside: np.ndarray, axis: int, number: int) -> Float[np.ndarray, "n 3"]:
    """Voxel coordinates along all contours of one slice."""
    with needs_extra("outlines of slices", "volumes"):
        from skimage import measure
    extract: Any = measure.find_contours
    loops = extract(inside.astype(np.float32), 0.5)
    flat = np.concatenate([np.zeros((0, 2)), *(loop[:-1] for loop in loops)])  # a loop ends where it begins
    return np.insert(flat, axis, number, axis=1)
