"""Clouds of outlines: what remains of an object of which only some slices are known."""

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
    """Points along the outlines of an object in some slices of a volume, in millimetres.

    D. Cao and F. Bernard (CVPR 2023) match lungs with such clouds, made from a part of the slices of a scan.

    Args:
        mask: what is inside.
        axis: along which slices lie one upon the other: 0, 1 or 2, for i, j or k.
        every: take every so many-th slice.
        span: of the slices that the object is in, those from this share to that one.
        points: how many points to keep, far from each other; None for all.
        seed: of that choice.

    Raises:
        ArgumentError: if a number is out of range, or there are not so many points.
        ShapeError: if these slices are too few for a cloud.
        MissingExtraError: if scikit-image is not installed.
    """
    if axis not in (0, 1, 2):
        raise bad_value("axis", axis, "0, 1 or 2")
    check_count("every", every)
    if not (all(map(is_real, span)) and 0 <= span[0] < span[1] <= 1):
        raise bad_value("span", span, "two shares, the first smaller, from 0 to 1")
    box = mask.cropped(1)
    n_slices = box.inside.shape[axis] - 2
    chosen = 1 + np.arange(round(span[0] * n_slices), round(span[1] * n_slices))[::every]
    places = [_outline(box.inside.take(number, axis=axis), axis, number) for number in chosen]
    found = box.positions(np.concatenate([np.zeros((0, 3)), *places]))
    if len(found) < FEWEST_POINTS:
        raise ShapeError(f"{mask.name}: {len(chosen)} slices have {len(found)} points in all; take more slices")
    if points is not None:
        if not 1 <= points <= len(found):
            raise bad_value("points", points, f"from 1 to the number of points of these outlines, {len(found)}")
        found = found[farthest_points(found, points, seed=seed)]
    return Shape(found, None, name=mask.name)


def _outline(inside: np.ndarray, axis: int, number: int) -> Float[np.ndarray, "n 3"]:
    """Places in voxels, along all outlines of one slice."""
    loops = _find_contours()(inside.astype(np.float32), 0.5)
    flat = np.concatenate([np.zeros((0, 2)), *(loop[:-1] for loop in loops)])  # a loop ends where it begins
    return np.insert(flat, axis, number, axis=1)


def _find_contours() -> Any:
    with needs_extra("outlines of slices", "volumes"):
        from skimage.measure import find_contours
    return find_contours
