"""A proxy: a shape that is matched in place of another one, and the way back to the other's points. New here."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped
from scipy.spatial import KDTree

from homolog.geometry.projection import SurfacePoints, SurfaceProjector
from homolog.geometry.scale import surface_area
from homolog.geometry.surface import Surface
from homolog.shapes import Finding, Repaired, Shape

# Of two points on either side of a thin part, that which faces the same way is nearer: normals count as positions do,
# with this length, in units of sqrt(area).
_NORMAL = 0.05
# What a map takes farther apart than this, in units of sqrt(area), has nothing in between.
_TORN = 0.1


@dataclass(frozen=True, eq=False)
class Proxy(Repaired):
    """A shape that stands for another one, and the way back to the points of that one's original.

    Each point has a place on the proxy; what is known of the proxy's points is interpolated there. ``kept`` has the
    point nearest to each of the proxy's, and ``clean_index`` the proxy's point nearest to each place.

    Args:
        full: what the proxy stands for.
        places: on the proxy, of the points of ``full.shape``; invalid where they are too far away.

    See Also:
        ``proxy_for`` makes it.
    """

    full: Repaired
    places: SurfacePoints

    def __repr__(self) -> str:
        return f"Proxy({self.shape!r} for {self.full.shape!r})"

    def to_original(
        self, values: Shaped[np.ndarray, "n_clean ..."], fill: Any = None
    ) -> Shaped[np.ndarray, "n_original ..."]:
        """Bring one value per point of the proxy to the original's points: real numbers are interpolated.

        Args:
            values: shape (n_clean, ...).
            fill: the value of points without a place on the proxy; see ``Repaired.to_original``.
        """
        values = np.asarray(values)
        if values.dtype.kind != "f" or values.ndim < 1 or len(values) != len(self.kept):
            return super().to_original(values, fill)
        # Weights of one in sum may be rounded to more, but nothing is interpolated beyond the values that there are.
        found = np.clip(self.places.interpolate(values), values.min(axis=0), values.max(axis=0)).astype(values.dtype)
        if fill is not None:
            found[~self.places.valid] = fill
        return self.full.to_original(found, fill)

    def original_map(
        self, source_to_target: Int[np.ndarray, " n_clean"], target: Repaired
    ) -> Int[np.ndarray, " n_original"]:
        """Turn a point map from the proxy into one between the originals, as smooth as the map is.

        Args:
            source_to_target: for each point of the proxy a point of the target's clean shape, or proxy; or -1.
            target: the other shape's repair, or proxy.
        """
        ends = _Ends.of(target)
        (rows,) = np.nonzero(self.places.valid & (source_to_target[self._nearest] >= 0))
        corners, weights = self.places.corners[rows], self.places.weights[rows]
        reached = source_to_target[corners]
        middle = ends.at_clean[source_to_target[self._nearest[rows]]]
        images = ends.at_clean[reached]
        torn = (reached < 0) | (np.linalg.norm(images - middle[:, None], axis=2) > _TORN * ends.unit)
        images[torn] = np.broadcast_to(middle[:, None], images.shape)[torn]
        found = np.full(self.full.shape.n_points, -1)
        found[rows] = ends.nearest(np.einsum("pk,pkc->pc", weights, images))
        return self.full.to_original(found, fill=-1)

    @cached_property
    def _nearest(self) -> Int[np.ndarray, " n"]:
        """The proxy's point nearest to each place."""
        return _nearest_corners(self.places)


@dataclass(frozen=True, eq=False)
class _Ends:
    """Where a map may end: the points of a shape as given that have a place, by positions and normals.

    Args:
        at_clean: of the points of the clean shape, or proxy (n_clean, 6); of clouds positions alone (n_clean, 3).
        at_full: of the points of the original that have a place (n, 6).
        numbers: of these in the original.
        unit: sqrt(area) of the shape.
    """

    at_clean: Float[np.ndarray, "n_clean c"]
    at_full: Float[np.ndarray, "n c"]
    numbers: Int[np.ndarray, " n"]
    unit: float

    @classmethod
    def of(cls, repaired: Repaired) -> _Ends:
        """Those of a repaired shape, or of one that a proxy stands for."""
        shape, unit = repaired.shape, float(np.sqrt(surface_area(repaired.shape)))
        if not isinstance(repaired, Proxy):
            at_clean = _with_normals(shape.points, _normals(shape), unit)
            return cls(at_clean, at_clean, repaired.kept, unit)
        normals, (rows,) = _normals(shape), np.nonzero(repaired.places.valid)
        there = None if normals is None else repaired.places.interpolate(normals)[rows]
        at_full = _with_normals(repaired.full.shape.points[rows], there, unit)
        return cls(_with_normals(shape.points, normals, unit), at_full, repaired.full.kept[rows], unit)

    def nearest(self, queries: Float[np.ndarray, "p c"]) -> Int[np.ndarray, " p"]:
        """The nearest of them, as indices of the original."""
        found: np.ndarray = self.numbers[KDTree(self.at_full).query(queries, workers=-1)[1]]
        return found


def proxy_for(full: Repaired, shape: Shape, *, finding: Finding, reach: float) -> Proxy:
    """Let one shape stand for another.

    Args:
        full: what it stands for.
        shape: the proxy, clean, in the same coordinates; a cloud for a cloud.
        finding: what the report says of it.
        reach: how far a point may be from the proxy to have a place on it, in units of sqrt(area).
    """
    points = full.shape.points
    projector = SurfaceProjector(shape)
    places = projector.project(points, _normals(full.shape))
    away = np.linalg.norm(projector.positions(places) - points, axis=1)
    places = places.masked(away <= reach * projector.unit)
    nearest = np.where(places.valid, _nearest_corners(places), -1)
    report = replace(full.report, findings=(*full.report.findings, finding))
    clean_index = np.append(nearest, -1)[full.clean_index]
    proxy = Proxy(shape, report, np.zeros(shape.n_points, dtype=np.int64), clean_index, full, places)
    ends = _Ends.of(proxy)
    return replace(proxy, kept=ends.nearest(ends.at_clean))


def _nearest_corners(places: SurfacePoints) -> Int[np.ndarray, " p"]:
    """The corner with the largest weight; the first of invalid places."""
    largest = np.where(places.valid, places.weights.argmax(axis=1), 0)
    found: np.ndarray = places.corners[np.arange(len(largest)), largest]
    return found


def _normals(shape: Shape) -> Float[np.ndarray, "n 3"] | None:
    """The unit normals of a mesh; None for a cloud."""
    return None if shape.faces is None else Surface(shape.points, shape.faces).vertex_normals


def _with_normals(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"] | None, unit: float
) -> Float[np.ndarray, "n c"]:
    return points if normals is None else np.concatenate([points, _NORMAL * unit * normals], axis=1)
