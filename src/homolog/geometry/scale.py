"""Centre and scale: lengths inside Homolog are in units of the square root of a shape's surface area."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from homolog.core.arguments import is_real
from homolog.core.errors import ShapeError, bad_value
from homolog.core.reprs import short_repr
from homolog.geometry.components import main_part, main_points, require_usable
from homolog.shapes import Shape, face_areas

# Radii of the two balls that `cloud_area` counts in, as shares of the cloud's root-mean-square radius.
_BALLS = (0.15, 0.25)
# A ball's flat disc also catches what a curved or thin body has nearby: bodies, animals and people alike come out
# this much too small (5 % standard deviation over such shapes).
_BALL_BIAS = 1.18
_COUNTED_POINTS = 2000


@dataclass(frozen=True)
class Frame:
    """Where a shape's unit-area coordinates lie in its file's: ``file = inside * length + centre``.

    Args:
        centre: the mean of the points, in the file's units.
        scale: the length of one inner unit in the file's units, that is sqrt(surface area).
    """

    centre: Float[np.ndarray, " 3"]
    scale: float

    __repr__ = short_repr

    def to_unit(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Coordinates in inner units, around the centre."""
        inner: np.ndarray = (points - self.centre) / self.scale
        return inner


def unit_frame(shape: Shape, *, scale: float | None = None) -> Frame:
    """The frame that centres a shape and scales it to unit area, or by ``scale`` if that is given.

    A partial shape takes the length of its complete partner. Debris, see ``main_points``, does not count.

    Raises:
        ArgumentError: if ``scale`` is not positive and finite.
        ShapeError: if the shape has no area, or is not clean.
    """
    require_usable(shape)
    return frame_of(main_part(shape, main_points(shape)), scale=scale)


def frame_of(shape: Shape, *, scale: float | None = None) -> Frame:
    """The frame of a usable shape without debris; see ``unit_frame``."""
    if scale is None:
        area = surface_area(shape)
        if not (np.isfinite(area) and area > 0):
            raise ShapeError(f"{shape.name}: its surface area is {area:g}, so it has no scale; check the faces")
        scale = float(np.sqrt(area))
    elif not (is_real(scale) and scale > 0):
        raise bad_value("scale", scale, "a positive finite number")
    return Frame(centre=shape.points.mean(axis=0), scale=scale)


def surface_area(shape: Shape) -> float:
    """Surface area of a mesh, or the estimated area of a cloud, in squared units of the file."""
    if shape.faces is None:
        return cloud_area(shape.points)
    return float(face_areas(shape.points, shape.faces).sum())


def cloud_area(points: Float[np.ndarray, "n 3"]) -> float:
    """Area of the surface that a point cloud samples, in squared units, hardly moved by noise or uneven sampling.

    On a flat patch of density d, a ball of radius r around a point holds d pi r^2 points, so the sum over all points
    of pi r^2 / count is the area, whatever the density. Isotropic noise of standard deviation s thins the count to
    d pi (r^2 - 2 s^2): the factor cancels between two radii. A triangulation's area, in contrast, more than doubles
    at noise of 2 % of the unit length.
    """
    radius = float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))
    if radius == 0:
        return 0.0
    # Every so many-th point in the order of its coordinates: the order in the file must not matter.
    centres = points[np.lexsort(points.T)][:: max(1, len(points) // _COUNTED_POINTS)]
    tree = KDTree(points)
    small, large = (_area_by_counts(tree, centres, share * radius) for share in _BALLS)
    exponent = _BALLS[1] ** 2 / (_BALLS[1] ** 2 - _BALLS[0] ** 2)
    return float(_BALL_BIAS * large**exponent / small ** (exponent - 1))


def _area_by_counts(tree: KDTree, centres: Float[np.ndarray, "c 3"], radius: float) -> float:
    counts = tree.query_ball_point(centres, radius, return_length=True, workers=-1)
    return float(np.mean(tree.n * np.pi * radius**2 / counts))
