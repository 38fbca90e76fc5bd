"""Planes in the background of a shape: floors, tables and walls. New here."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import ConvexHull, KDTree, QhullError

from homolog.geometry.clutter_settings import ClutterSettings
from homolog.geometry.outliers import find_outliers
from homolog.geometry.tangent import normals_of
from homolog.shapes import Shape, face_areas

# How many positions of the surface are looked at, from how many of them planes start, how many are looked for, and to
# how many neighbours the normal of a cloud's point is fitted.
_SAMPLES, _STARTS, _MOST_PLANES, _AROUND = 5000, 200, 6, 30
# Half the thickness of a plane at first, and at most and least, as shares of the diagonal of the bounding box.
_BAND, _WIDEST_BAND, _NARROWEST_BAND = 0.005, 0.02, 0.0005
_FEWEST_OF_OBJECT = 100
# The cosine of the angle to the vertical up to which a plane is a floor.
_UPRIGHT = 0.87


@dataclass(frozen=True, eq=False)
class _Plane:
    """A plane that many points lie in.

    Args:
        centre: a point of it (3,).
        normal: of unit length (3,).
        band: half its thickness.
    """

    centre: Float[np.ndarray, " 3"]
    normal: Float[np.ndarray, " 3"]
    band: float

    def heights(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Signed distances from the plane (n,)."""
        found: np.ndarray = (points - self.centre) @ self.normal
        return found

    def holds(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Which points lie in it (n,)."""
        held: np.ndarray = np.abs(self.heights(points)) <= self.band
        return held

    def is_sharp(self, points: Float[np.ndarray, "n 3"], settings: ClutterSettings) -> bool:
        """Whether points lie in it and not beside it, as they do around a plane through a curved surface."""
        around = replace(self, band=2 * self.band).holds(points).sum()
        return bool(around <= (1 + settings.most_beside) * self.holds(points).sum())

    def shadow(self, points: Float[np.ndarray, "n 3"]) -> float:
        """Area of the convex hull of points on the plane."""
        flat = (points - self.centre) @ np.linalg.svd(self.normal[None])[2][1:].T
        try:
            return float(ConvexHull(flat).volume)  # of two dimensions, the area
        except QhullError:  # all on one line
            return 0.0

    def is_behind(
        self, rest: Float[np.ndarray, "m 3"], own: Float[np.ndarray, "p 3"], settings: ClutterSettings
    ) -> bool:
        """Whether an object lies on one side of the plane, and the plane reaches far beyond its shadow."""
        above = self.heights(rest) > 0
        if min(above.mean(), 1 - above.mean()) > settings.most_behind:
            return False
        rise = self.normal[1] * (1 if above.mean() > 0.5 else -1)
        if rise < -_UPRIGHT:  # the object hangs below, as a table does below its top
            return False
        beyond = settings.floor_beyond if rise > _UPRIGHT else settings.wall_beyond
        return self.shadow(own) > beyond * self.shadow(rest)


def find_backgrounds(shape: Shape, settings: ClutterSettings) -> Iterator[Bool[np.ndarray, " n"]]:
    """The points of each plane in the background (n,): all else lies on one side of it, and it reaches far beyond."""
    samples, normals = _samples(shape)
    planes = sorted(_planes(samples, normals, settings), key=lambda plane: -plane.shadow(samples[plane.holds(samples)]))
    for count in range(len(planes), 0, -1):
        behind = planes[:count]
        rest = samples[~np.any([plane.holds(samples) for plane in behind], axis=0)]
        if shape.faces is None and len(rest) > _FEWEST_OF_OBJECT:
            rest = rest[~find_outliers(rest, settings)]
        if len(rest) >= _FEWEST_OF_OBJECT and all(
            plane.is_behind(rest, samples[plane.holds(samples)], settings) for plane in behind
        ):
            taken = np.zeros(shape.n_points, dtype=bool)
            for plane in behind:
                own = _points_of_plane(shape, plane) & ~taken
                taken |= own
                yield own
            return


def _samples(shape: Shape) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, "t 3"]]:
    """Positions spread evenly over the surface, and normals at the first of them."""
    random = np.random.default_rng(0)
    if shape.faces is None:
        chosen = random.permutation(shape.n_points)[:_SAMPLES]
        starts = shape.points[chosen[:_STARTS]]
        _, near = KDTree(shape.points).query(starts, k=min(_AROUND, shape.n_points))
        away = shape.points[near] - starts[:, None]
        return shape.points[chosen], normals_of(away.transpose(0, 2, 1) @ away)
    areas = face_areas(shape.points, shape.faces)
    corners = shape.points[shape.faces[random.choice(len(areas), _SAMPLES, p=areas / areas.sum())]]
    weights = random.dirichlet(np.ones(3), _SAMPLES)
    normals = np.cross(corners[:_STARTS, 1] - corners[:_STARTS, 0], corners[:_STARTS, 2] - corners[:_STARTS, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.einsum("sk,skc->sc", weights, corners), normals / np.maximum(lengths, np.finfo(float).tiny)


def _planes(
    samples: Float[np.ndarray, "s 3"], normals: Float[np.ndarray, "t 3"], settings: ClutterSettings
) -> Iterator[_Plane]:
    """Planes with many samples, each without those of the planes before."""
    size = float(np.linalg.norm(np.ptp(samples, axis=0)))
    starts, left = samples[: len(normals)], samples
    for _ in range(_MOST_PLANES):
        if len(left) < settings.least_plane * len(samples):
            return
        heights = normals @ left.T  # a row for each plane, counted along it: five times as fast as columns
        heights -= np.einsum("tc,tc->t", starts, normals)[:, None]
        best = int(np.argmax(np.count_nonzero(np.abs(heights, out=heights) < _BAND * size, axis=1)))
        plane = _refined(_Plane(starts[best], normals[best], _BAND * size), left, size)
        if plane.holds(left).sum() < settings.least_plane * len(samples):
            return
        if plane.band < _WIDEST_BAND * size and plane.is_sharp(left, settings):
            yield plane
        left = left[~plane.holds(left)]


def _refined(plane: _Plane, samples: Float[np.ndarray, "s 3"], size: float) -> _Plane:
    """The plane through the samples near it, as thick as they scatter."""
    for _ in range(5):
        own = samples[plane.holds(samples)]
        if len(own) < 3:
            break
        centre = own.mean(axis=0)
        normal = np.linalg.eigh((own - centre).T @ (own - centre))[1][:, 0]
        spread = 4.5 * float(np.median(np.abs((own - centre) @ normal)))  # three standard deviations of Gaussian noise
        plane = _Plane(centre, normal, float(np.clip(spread, _NARROWEST_BAND * size, _WIDEST_BAND * size)))
    return plane


def _points_of_plane(shape: Shape, plane: _Plane) -> Bool[np.ndarray, " n"]:
    """The points that lie in a plane, of a mesh with all of their faces."""
    own = plane.holds(shape.points)
    if shape.faces is not None:
        own[shape.faces[~own[shape.faces].all(axis=1)]] = False
    return own
