"""Which points of a cloud lie off the surface that the others sample, one by one or in clusters. New here.

Robust planes tell which points have a surface around them. From these the surface is grown to the points that lie
on it. What it does not reach are outliers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from homolog.geometry.clutter_settings import ClutterSettings
from homolog.shapes import components

# From the first share of points without a plane on a surface is rough for its spacing, up to the second it grows
# rougher; then it needs such bounds as at this level of noise.
_ROUGH, _ROUGHEST, _AS_NOISE = 0.13, 0.148, 0.6
# Fewer outliers than this share must show by these bounds as well.
_FEW = 0.06
# Fewer points have no neighbourhoods to speak of.
_FEWEST_POINTS = 60
# The neighbour whose distance is the width of a neighbourhood, and among how many the densest is looked for, beside
# which none is more than so many times as wide.
_DENSITY, _AROUND, _WIDEST = 8, 16, 2.0
# To how many neighbours a plane is fitted, and within how many widths, without and with noise; in how many rounds.
_FITTED, _FITTED_NOISY, _REACH, _REACH_NOISY, _FITS = 16, 40, 1.0, 1.5, 3
# Planes of so many points at once: memory is bounded.
_BLOCK = 20_000
# So many points that are sure to be on a surface hang together; with noise so many, or this share of all.
_PIECE, _PIECE_NOISY, _PIECE_SHARE = 12, 60, 0.012
# A surface is grown in at most so many rounds, along planes through so many of its points, besides so many of their
# thicknesses; where doubtful points belong to it, so many.
_GROWTH, _NEAREST, _THICKNESS, _THICKNESS_DOUBTFUL = 8, 10, 1.25, 1.5


def find_outliers(points: Float[np.ndarray, "n 3"], settings: ClutterSettings | None = None) -> Bool[np.ndarray, " n"]:
    """Which points of a cloud lie off the surface that the others sample, each by itself or in clusters.

    Points that are a little off, as clean surfaces have, are none; once more than a few are, the others like them are
    outliers as well. Planes are fitted by iteratively reweighted least squares (Holland and Welsch, 1977).

    Args:
        points: positions (n, 3).
        settings: how far off is too far.

    Returns:
        True for each outlier (n,).

    Examples:
        >>> import homolog
        >>> body = homolog.demo_shapes()[0].points
        >>> bool(find_outliers(body).any())
        False
    """
    settings = settings or ClutterSettings()
    found = np.zeros(len(points), dtype=bool)
    if len(points) >= _FEWEST_POINTS:
        # Where points that are near lie near in memory, a large cloud takes half as long.
        order = KDTree(points).indices
        found[order] = _off_surface(points[order], settings)
    return found


def _off_surface(points: Float[np.ndarray, "n 3"], settings: ClutterSettings) -> Bool[np.ndarray, " n"]:
    """The same, of enough points to have neighbourhoods."""
    clean = _Neighbourhoods.of(points, settings, 0.0)
    noise = _noise_level(clean, settings)
    around = clean if noise == 0 else _Neighbourhoods.of(points, settings, noise)
    found, rough, _ = _outliers(around, settings, noise)
    if noise < _AS_NOISE and found.any() and found.mean() < _FEW:
        coarse, _, share = _outliers(_Neighbourhoods.of(points, settings, _AS_NOISE), settings, _AS_NOISE)
        if share <= settings.least_share:  # thin parts of few points look like outliers
            return coarse
    return _outliers(_Neighbourhoods.of(points, settings, rough), settings, rough)[0] if rough > noise else found


def _outliers(
    around: _Neighbourhoods, settings: ClutterSettings, noise: float
) -> tuple[Bool[np.ndarray, " n"], float, float]:
    """Outliers by the bounds for a level of noise (n,), the level that so rough a surface needs, and the share off it.

    How rough it is, is told where no outliers are around.
    """
    near = _between(settings.near, settings.near_noisy, noise)
    surface = around.grown(around.cores(settings, noise), settings.step, near, _THICKNESS)
    wide = around.grown(surface, settings.step, near + settings.doubtful, _THICKNESS_DOUBTFUL)
    apart = wide[around.indices[:, : _AROUND + 1]].all(axis=1)
    bent = around.support[apart] < _between(settings.support, settings.support_noisy, noise)
    share = bent.mean() if apart.any() else 1.0
    rough = _AS_NOISE * float(np.clip((share - _ROUGH) / (_ROUGHEST - _ROUGH), 0, 1))
    off = 1 - wide.mean()
    if off <= _between(settings.least_share, settings.least_share_noisy, noise):
        return ~around.grown(wide, settings.clear, settings.clear, _THICKNESS_DOUBTFUL), rough, off
    return ~surface if off > settings.many else ~wide, rough, off


def noise_level(points: Float[np.ndarray, "n 3"], settings: ClutterSettings | None = None) -> float:
    """How noisy the surface of a cloud is, whatever its outliers: 0 if it is clean, up to 1.

    Args:
        points: positions (n, 3), 17 or more.
        settings: what is clean, and what is noisy.
    """
    settings = settings or ClutterSettings()
    return _noise_level(_Neighbourhoods.of(points, settings, 0.0), settings)


def _noise_level(around: _Neighbourhoods, settings: ClutterSettings) -> float:
    """The same, of neighbourhoods as clean surfaces have them."""
    off = float(np.quantile(np.median(around.off[:, 1 : _DENSITY + 1], axis=1), 0.25))
    return float(np.clip((off - settings.least_noise) / (settings.most_noise - settings.least_noise), 0, 1))


def _between(clean: float, noisy: float, noise: float) -> float:
    """A bound between those for a clean surface and for a noisy one."""
    return clean + (noisy - clean) * noise


@dataclass(frozen=True, eq=False)
class _Planes:
    """The plane through each of many sets of points.

    Args:
        middles: a point of each (n, 3).
        normals: of unit length (n, 3).
        thickness: standard deviation of the points across each plane (n,).
    """

    middles: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    thickness: Float[np.ndarray, " n"]

    @classmethod
    def of(cls, points: Float[np.ndarray, "n j 3"], weights: Float[np.ndarray, "n j"]) -> _Planes:
        """Fit them by least squares, with positive weights."""
        shares = weights / weights.sum(axis=1, keepdims=True)
        middles = np.einsum("nj,njc->nc", shares, points)
        away = points - middles[:, None]
        variances, axes = np.linalg.eigh((away * shares[..., None]).transpose(0, 2, 1) @ away)
        return cls(middles, axes[:, :, 0], np.sqrt(np.maximum(variances[:, 0], 0)))

    def distances(self, points: Float[np.ndarray, "n j 3"]) -> Float[np.ndarray, "n j"]:
        """How far some points lie from each plane (n, j)."""
        found: np.ndarray = np.abs(np.einsum("njc,nc->nj", points - self.middles[:, None], self.normals))
        return found


@dataclass(frozen=True, eq=False)
class _Neighbourhoods:
    """How the points of a cloud lie among their neighbours.

    Args:
        points: positions (n, 3).
        indices: each point, then its neighbours, nearest first (n, j).
        distances: to these (n, j).
        widths: distance to a near neighbour, at least its median over the cloud (n,).
        middles: points of the robust planes through these points (n, 3).
        normals: of these planes (n, 3).
        off: how far each of these points lies from the plane, in widths (n, j).
        support: which share of the neighbours lies in it (n,).
    """

    points: Float[np.ndarray, "n 3"]
    indices: Int[np.ndarray, "n j"]
    distances: Float[np.ndarray, "n j"]
    widths: Float[np.ndarray, " n"]
    middles: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    off: Float[np.ndarray, "n j"]
    support: Float[np.ndarray, " n"]

    @classmethod
    def of(cls, points: Float[np.ndarray, "n 3"], settings: ClutterSettings, noise: float) -> _Neighbourhoods:
        """Fit a robust plane to each."""
        count = min(round(_between(_FITTED, _FITTED_NOISY, noise)), len(points) - 1)
        distances, indices = KDTree(points).query(points, k=count + 1, workers=-1)
        width = distances[:, _DENSITY]
        around = width[indices[:, : _AROUND + 1]]
        widths = np.minimum(np.median(around, axis=1), _WIDEST * around.min(axis=1))
        widths = np.maximum(widths, max(np.median(widths), np.finfo(float).tiny))
        slab, reach = _between(settings.slab, settings.slab_noisy, noise), _between(_REACH, _REACH_NOISY, noise)
        off, support = np.empty(indices.shape), np.empty(len(points))
        middles, normals = np.empty(points.shape), np.empty(points.shape)
        for start in range(0, len(points), _BLOCK):
            rows = slice(start, start + _BLOCK)
            near = points[indices[rows]]
            weights = closeness = np.exp(-((distances[rows] / (reach * widths[rows, None])) ** 2)) + 1e-9
            for _ in range(_FITS):
                planes = _Planes.of(near, weights)
                off[rows] = planes.distances(near) / widths[rows, None]
                weights = closeness / (1 + (off[rows] / slab) ** 2) ** 2
            middles[rows], normals[rows] = planes.middles, planes.normals
            others = closeness[:, 1:]
            support[rows] = np.where(off[rows, 1:] < slab, others, 0).sum(axis=1) / others.sum(axis=1)
        return cls(points, indices, distances, widths, middles, normals, off, support)

    def cores(self, settings: ClutterSettings, noise: float) -> Bool[np.ndarray, " n"]:
        """Points that lie with their neighbours in one plane, where enough of these hang together (n,)."""
        slab = _between(settings.slab, settings.slab_noisy, noise)
        core = (self.support > _between(settings.support, settings.support_noisy, noise)) & (self.off[:, 0] < slab)
        width = self.distances[:, _DENSITY]
        core &= noise * width <= settings.sparse_noisy * np.median(width)  # planes through thick slabs tell little
        others = self.indices[:, 1:]
        near = self.distances[:, 1:] <= settings.link * self.widths[:, None]
        one, column = np.nonzero(near & (self.off[:, 1:] < 2 * slab) & core[:, None] & core[others])
        other = others[one, column]
        linked = np.empty(len(one), dtype=bool)
        for start in range(0, len(one), _AROUND * _BLOCK):
            rows = slice(start, start + _AROUND * _BLOCK)
            away = self.points[one[rows]] - self.middles[other[rows]]
            back = np.abs(np.einsum("kc,kc->k", away, self.normals[other[rows]]))
            linked[rows] = back < 2 * slab * self.widths[one[rows]]
        component = components(one[linked], other[linked], len(core))
        noisy_piece = np.clip(_PIECE_SHARE * len(core), _PIECE, _PIECE_NOISY)
        sure: np.ndarray = core & (np.bincount(component) >= _between(_PIECE, noisy_piece, noise))[component]
        return sure

    def grown(
        self, surface: Bool[np.ndarray, " n"], step: float, near: float, thickness: float
    ) -> Bool[np.ndarray, " n"]:
        """A surface with the points up to a step away that are near its planes, both in widths (n,)."""
        surface = surface.copy()
        for _ in range(_GROWTH):
            (rest,), (own,) = np.nonzero(~surface), np.nonzero(surface)
            if not len(rest) or len(own) < _NEAREST:
                break
            away, nearest = KDTree(self.points[own]).query(self.points[rest], k=_NEAREST, workers=-1)
            widths = self.widths[own[nearest[:, 0]]]
            planes = _Planes.of(self.points[own[nearest]], np.exp(-((away / widths[:, None]) ** 2)) + 1e-9)
            off = planes.distances(self.points[rest, None])[:, 0]
            on = (away[:, 0] <= step * widths) & (off < near * widths + thickness * planes.thickness)
            if not on.any():
                break
            surface[rest[on]] = True
        return surface
