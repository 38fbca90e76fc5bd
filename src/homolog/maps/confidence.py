"""Confidence in a point map, and the overlap of a partial and a full shape, both without ground truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from annotated_types import Gt, Le
from jaxtyping import Bool, Float, Int
from scipy.sparse import diags_array
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree
from torch import Tensor

from homolog.core.arguments import check_indices, given_or_default
from homolog.core.arrays import takes_arrays
from homolog.core.settings import Count, Positive, Settings
from homolog.geometry import Operators
from homolog.maps.quality import cycle_error


@dataclass(frozen=True, kw_only=True)
class ConfidenceSettings(Settings):
    """Settings of ``confidence`` and ``overlap``.

    Args:
        n_neighbours: nearest points over which the confidence of a point is averaged, at least 1; 10 to 40 are
            sensible.
        scale: distortion in normalised coordinates, of unit area, at which the confidence has fallen to 1/e; above 0,
            0.03 to 0.3 are sensible. It changes no ranking.
        smoothing: width over which carried mass is smoothed, in point spacings; above 0, 1 to 4 are sensible. Less
            leaves gaps between samples, more blurs the boundary of the overlap.
        overlap_threshold: a point of the full shape has a counterpart if the density of the carried mass is at least
            this; above 0 and at most 1. The density is 1 inside the overlap, 0 outside, 0.5 on a straight boundary.

    Examples:
        >>> from homolog.maps import ConfidenceSettings
        >>> ConfidenceSettings(overlap_threshold=0.3)
        ConfidenceSettings(n_neighbours=20, scale=0.1, smoothing=2.0, overlap_threshold=0.3)
    """

    n_neighbours: Count = 20
    scale: Positive = 0.1
    smoothing: Positive = 2.0
    overlap_threshold: Annotated[float, Gt(0), Le(1)] = 0.5


@takes_arrays
def confidence(
    points_y: Float[Tensor, "n_y 3"],
    points_x: Float[Tensor, "n_x 3"],
    y_to_x: Int[Tensor, " n_y"],
    x_to_y: Int[Tensor, " n_x"],
    *,
    settings: ConfidenceSettings | None = None,
    near: Int[Tensor, "n_y j"] | None = None,
) -> Float[Tensor, " n_y"]:
    """Confidence in each entry of a point map, between 0 and 1, from cycle error and local distortion. New here.

    Two things betray a wrong match: the way to x and back misses its start, and neighbours do not keep their distances.
    Both are averaged over a point's nearest neighbours, as errors come in patches:
    exp(-(mean cycle error + mean change of distance) / scale).

    Args:
        points_y: positions in normalised coordinates, of unit area (n_y, 3).
        points_x: likewise (n_x, 3).
        y_to_x: the map, for each point of y a point of x (n_y,).
        x_to_y: the map back (n_x,).
        settings: neighbours and scale.
        near: the indices of each point of y and its neighbours (n_y, j), where many maps of one shape are judged; by
            default ``neighbourhoods`` looks for them.

    Returns:
        A number per point of y (n_y,).

    Raises:
        ArgumentError: if an index is that of no point, as is -1, where there is no counterpart.

    Examples:
        >>> import torch
        >>> from homolog.maps import confidence
        >>> points = torch.rand(100, 3, generator=torch.Generator().manual_seed(0))
        >>> identity = torch.arange(100)
        >>> float(confidence(points, points, identity, identity).min())
        1.0
        >>> float(confidence(points, points, identity.flip(0), identity).max()) < 0.1
        True

    See Also:
        ``cycle_error``, ``dirichlet_energy`` and ``flipped_triangles`` for figures of a whole map.
    """
    settings = given_or_default("settings", settings, ConfidenceSettings)
    home = cycle_error(points_y, y_to_x, x_to_y)
    near = neighbourhoods(points_y, settings.n_neighbours) if near is None else near
    stretch = local_stretch(points_y, points_x[y_to_x], near)
    return torch.exp(-(home[near].mean(dim=1) + stretch) / settings.scale)


@takes_arrays
def neighbourhoods(points: Float[Tensor, "n 3"], count: int) -> Int[Tensor, "n j"]:
    """The indices of each point and so many of the others, or all of them, the nearest first.

    Args:
        points: positions (n, 3).
        count: how many others.

    Returns:
        For each point its own index, and those of its nearest ones (n, count + 1).

    Examples:
        >>> import torch
        >>> from homolog.maps import neighbourhoods
        >>> neighbourhoods(torch.tensor([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]]), 1).tolist()
        [[0, 1], [1, 0], [2, 1]]
    """
    positions = points.cpu().numpy()
    _, indices = KDTree(positions).query(positions, k=min(count + 1, len(positions)))
    return torch.from_numpy(indices).to(points.device)


@takes_arrays
def local_stretch(
    points: Float[Tensor, "n 3"], images: Float[Tensor, "n 3"], near: Int[Tensor, "n j"]
) -> Float[Tensor, " n"]:
    """Local distortion: the mean change, under a map, of the distances between a point and its neighbours. New here.

    Args:
        points: positions (n, 3).
        images: where the map takes each of them (n, 3).
        near: indices of each point's neighbours (n, j).

    Returns:
        A length per point (n,), in the units of the positions.

    Examples:
        >>> import torch
        >>> from homolog.maps import local_stretch
        >>> points, near = torch.tensor([[0.0, 0, 0], [1, 0, 0]]), torch.tensor([[1], [0]])
        >>> local_stretch(points, 3 * points, near)
        tensor([2., 2.])
    """
    before = (points[near] - points[:, None]).norm(dim=2)
    after = (images[near] - images[:, None]).norm(dim=2)
    stretch: Tensor = (after - before).abs().mean(dim=1)
    return stretch


def overlap(
    full: Operators,
    partial: Operators,
    partial_to_full: Int[Tensor, " n_p"],
    *,
    settings: ConfidenceSettings | None = None,
) -> Bool[Tensor, " n_f"]:
    """Overlap region of a full and a partial shape: which points of the full one have a counterpart. New here.

    The partial shape's mass is pushed forward along the map and smoothed by a heat step on the full shape, see
    ``coverage_density``; a point has a counterpart where the density is at least ``settings.overlap_threshold``.

    Args:
        full: operators of the full shape.
        partial: operators of the partial one, at the same scale.
        partial_to_full: for each point of the partial shape a point of the full one (n_p,).
        settings: smoothing and threshold.

    Returns:
        True for each point of the full shape with a counterpart (n_f,).

    Raises:
        ArgumentError: if an index is that of no point of the full shape.

    Examples:
        >>> import torch, trimesh
        >>> from homolog import Shape, compute_operators
        >>> from homolog.maps import overlap
        >>> mesh = trimesh.creation.icosphere(subdivisions=3)
        >>> sphere = compute_operators(Shape(mesh.vertices, mesh.faces))
        >>> bool(overlap(sphere, sphere, torch.arange(sphere.n_points)).all())
        True
        >>> bool(overlap(sphere, sphere, torch.zeros(sphere.n_points, dtype=torch.int64)).all())
        False
    """
    settings = given_or_default("settings", settings, ConfidenceSettings)
    return coverage_density(full, partial.mass, partial_to_full, settings=settings) >= settings.overlap_threshold


def coverage_density(
    full: Operators,
    mass: Float[Tensor, " n_p"],
    partial_to_full: Int[Tensor, " n_p"],
    *,
    settings: ConfidenceSettings | None = None,
) -> Float[Tensor, " n_f"]:
    """Density of the mass that a map pushes to a full shape, smoothed by a heat step, over the shape's own. New here.

    Solves (M + w^2 L) u = (pushed mass), a backward Euler step of the heat equation, where w is ``settings.smoothing``
    times the point spacing sqrt(area / n). It keeps the mass; u is 1 where the map covers the shape evenly.

    Args:
        full: operators of the full shape.
        mass: of the points of the partial shape, at the full shape's scale (n_p,).
        partial_to_full: for each point of the partial shape a point of the full one (n_p,).
        settings: the width of the smoothing.

    Returns:
        A density per point of the full shape (n_f,).

    Raises:
        ArgumentError: if an index is that of no point of the full shape.

    Examples:
        >>> import torch, trimesh
        >>> from homolog import Shape, compute_operators
        >>> from homolog.maps import coverage_density
        >>> mesh = trimesh.creation.icosphere(subdivisions=3)
        >>> sphere = compute_operators(Shape(mesh.vertices, mesh.faces))
        >>> density = coverage_density(sphere, sphere.mass, torch.arange(sphere.n_points))
        >>> bool(((density - 1).abs() < 1e-4).all())
        True
    """
    settings = given_or_default("settings", settings, ConfidenceSettings)
    check_indices("partial_to_full", partial_to_full, len(full.mass))
    own = full.mass.double().cpu().numpy()
    pushed = np.bincount(partial_to_full.cpu().numpy(), weights=mass.double().cpu().numpy(), minlength=len(own))
    width = settings.smoothing * np.sqrt(own.sum() / len(own))
    heat = splu((diags_array(own) + width**2 * full.sparse_laplacian()).tocsc(), permc_spec="MMD_AT_PLUS_A")
    return torch.from_numpy(heat.solve(pushed)).to(full.mass)
