"""Which points of a cloud lie off the surface that the others sample, one by one or in clusters. New here."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from homolog.geometry.clutter_settings import ClutterSettings
from homolog.geometry.components import in_large_components
from homolog.shapes import components

# Neighbours whose distance tells how dense a cloud is, to whom a plane is fitted, and among whom the densest is found.
_DENSITY, _FITTED, _AROUND = 8, 16, 30
_ROUNDS = 10
# Noise of a surface is told by planes that half of a neighbourhood lies close to, so that outliers count for nothing:
# of how many points, and through how many random triples of neighbours.
_PLANE_SAMPLES, _TRIPLES = 2000, 24
# From their thin parts surfaces are grown by so many steps, of such a length, to points so near to their planes.
_THIN = 0.12
_GROWTH, _STEP, _NEAR_PLANE, _PLANE_THICKNESS = 5, 1.5, 0.8, 1.5


def find_outliers(points: Float[np.ndarray, "n 3"], settings: ClutterSettings | None = None) -> Bool[np.ndarray, " n"]:
    """Which points of a cloud lie off the surface that the others sample.

    Points are taken away in rounds: what hides among other outliers is seen once these are gone. Single points that are
    a little off, as surfaces have, are none; once more than a few are, the others like them are outliers as well.

    Args:
        points: positions (n, 3).
        settings: how far off is too far.

    Returns:
        True for each outlier (n,).
    """
    settings = settings or ClutterSettings()
    left, is_sure, noisy = np.arange(len(points)), False, is_noisy(points, settings)
    for _ in range(_ROUNDS):
        if len(left) <= 2 * _AROUND:
            break
        around = _Neighbourhoods.of(points[left])
        clear = around.clear(settings)
        if not is_sure:
            suspicious = clear | around.suspicious(settings.residual, settings, noisy=noisy)
            is_sure = bool(suspicious.mean() > settings.suspicious_share)
        out = clear | around.suspicious(settings.residual_once_sure, settings, noisy=noisy) if is_sure else clear
        if not out.any():
            break
        left = left[~out]
    outliers = np.ones(len(points), dtype=bool)
    outliers[left] = False
    return outliers


def is_noisy(points: Float[np.ndarray, "n 3"], settings: ClutterSettings | None = None) -> bool:
    """Whether a cloud's surface itself has noise: of 0.003 sqrt(area) or more at 5,000 points, whatever its outliers.

    Planes are fitted by the least median of distances (Rousseeuw, "Least median of squares regression", 1984).

    Args:
        points: positions (n, 3).
        settings: with the least distance that means noise.
    """
    if len(points) <= _FITTED:
        return False
    random = np.random.default_rng(0)
    some = random.permutation(len(points))[:_PLANE_SAMPLES]
    distances, indices = KDTree(points).query(points[some], k=_FITTED + 1, workers=-1)
    near = points[indices]
    least = np.full(len(some), np.inf)
    for _ in range(_TRIPLES):
        a, b, c = near[:, random.choice(_FITTED + 1, 3, replace=False)].transpose(1, 0, 2)
        normals = np.cross(b - a, c - a)
        heights = np.abs(np.einsum("sjc,sc->sj", near - a[:, None], normals))
        heights /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
        least = np.minimum(least, np.median(heights, axis=1))
    widths = np.maximum(distances[:, _DENSITY], np.finfo(float).tiny)
    return bool(np.quantile(least / widths, 0.1) > (settings or ClutterSettings()).least_noise)


def find_clustered(points: Float[np.ndarray, "n 3"], settings: ClutterSettings) -> Bool[np.ndarray, " n"]:
    """Which points of a cloud are in small clusters, and on no surface of more than a few points (n,)."""
    none = np.zeros(len(points), dtype=bool)
    if len(points) <= 2 * _AROUND:
        return none
    distances, indices = KDTree(points).query(points, k=_FITTED + 1, workers=-1)
    width = distances[:, _DENSITY]
    width = np.maximum(np.median(width[indices], axis=1), np.median(width))
    linked = distances[:, 1:] <= settings.link * width[:, None]
    if 1 - _in_large_pieces(indices, linked).mean() <= settings.least_clustered:
        return none
    thin = _Neighbourhoods.of(points).thickness < _THIN
    surface = thin & _in_large_pieces(indices, linked & thin[:, None] & thin[indices[:, 1:]])
    for _ in range(_GROWTH):
        (rest,) = np.nonzero(~surface)
        own = points[surface]
        if len(own) < _DENSITY or not len(rest):
            break
        away, near = KDTree(own).query(points[rest], k=_DENSITY, workers=-1)
        plane = _FittedPlanes.of(own[near], np.exp(-((away / width[rest, None]) ** 2)) + 1e-9)
        off = plane.distances(points[rest]) - _PLANE_THICKNESS * plane.thickness
        surface[rest[(away[:, 0] <= _STEP * width[rest]) & (off < _NEAR_PLANE * width[rest])]] = True
    clustered: np.ndarray = ~surface
    return clustered


def _in_large_pieces(indices: Int[np.ndarray, "n j"], linked: Bool[np.ndarray, "n i"]) -> Bool[np.ndarray, " n"]:
    """Which points are in large pieces, where some neighbours are linked; each comes first among its own (n,)."""
    rows, columns = np.nonzero(linked)
    component = components(rows, indices[:, 1:][rows, columns], len(indices))
    return in_large_components(component, np.bincount(component))


@dataclass(frozen=True, eq=False)
class _FittedPlanes:
    """The plane through each of many sets of points.

    Args:
        middles: a point of each (n, 3).
        normals: of unit length (n, 3).
        variances: of the points along the axes of each set, the least first, which is across the plane (n, 3).
    """

    middles: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    variances: Float[np.ndarray, "n 3"]

    @classmethod
    def of(cls, points: Float[np.ndarray, "n j 3"], weights: Float[np.ndarray, "n j"]) -> _FittedPlanes:
        """Fit them by least squares, with positive weights."""
        shares = weights / weights.sum(axis=1, keepdims=True)
        middles = np.einsum("nj,njc->nc", shares, points)
        away = points - middles[:, None]
        variances, axes = np.linalg.eigh(np.einsum("nj,nja,njb->nab", shares, away, away))
        return cls(middles, axes[:, :, 0], variances)

    @property
    def thickness(self) -> Float[np.ndarray, " n"]:
        """The standard deviation across each plane (n,)."""
        found: np.ndarray = np.sqrt(np.maximum(self.variances[:, 0], 0))
        return found

    def distances(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """How far each point lies from its plane (n,)."""
        found: np.ndarray = np.abs(np.einsum("nc,nc->n", points - self.middles, self.normals))
        return found


@dataclass(frozen=True, eq=False)
class _Neighbourhoods:
    """How each point of a cloud lies among its neighbours.

    Args:
        sparsity: distance to a near neighbour, in its median over the cloud (n,).
        relative: the same, in the least among the neighbours (n,).
        residual: distance from the plane through the neighbours, in their distance to a near neighbour (n,).
        usual: residual of the neighbours, its upper quartile (n,).
        thickness: share of the neighbours' variance across the plane (n,).
    """

    sparsity: Float[np.ndarray, " n"]
    relative: Float[np.ndarray, " n"]
    residual: Float[np.ndarray, " n"]
    usual: Float[np.ndarray, " n"]
    thickness: Float[np.ndarray, " n"]

    @classmethod
    def of(cls, points: Float[np.ndarray, "n 3"]) -> _Neighbourhoods:
        """Find them; two neighbours may not coincide."""
        distances, indices = KDTree(points).query(points, k=_AROUND + 1, workers=-1)
        width = distances[:, _DENSITY]
        densest = width[indices[:, 1:]].min(axis=1)
        near, distances = indices[:, 1 : _FITTED + 1], distances[:, 1 : _FITTED + 1]
        scale = np.median(width[near], axis=1)
        weights = np.exp(-((distances / scale[:, None]) ** 2)) + 1e-9  # far from all, the nearest still count
        planes = _FittedPlanes.of(points[near], weights)
        residual = planes.distances(points) / scale
        usual = np.quantile(residual[near], 0.75, axis=1)
        thickness = planes.variances[:, 0] / planes.variances.sum(axis=1)
        return cls(width / np.median(width), width / densest, residual, usual, thickness)

    def clear(self, settings: ClutterSettings) -> Bool[np.ndarray, " n"]:
        """What is an outlier however few there are (n,)."""
        sparse = (self.sparsity > settings.clear_sparsity) & (self.thickness > settings.thick)
        return sparse | (self.sparsity > settings.ever_sparse) | (self.residual > settings.clear_residual)

    def suspicious(self, residual: float, settings: ClutterSettings, *, noisy: bool) -> Bool[np.ndarray, " n"]:
        """What is an outlier if there are more like it (n,); of a noisy surface only what lies farther off."""
        off = self.residual - 2 * self.usual > (settings.residual_noisy if noisy else residual)
        sparse = self.sparsity > (settings.sparsity_noisy if noisy else settings.sparsity)
        sparse = (sparse & (self.relative > settings.sparser_than_near)) | (self.sparsity > settings.sparsity_alone)
        found: np.ndarray = off | (sparse & (self.thickness > settings.thick))
        return found
