"""Figures of merit of a point map without ground truth; ``confidence`` has one per point.

All are shares, ratios, or lengths in normalised coordinates, so that they do not depend on a file's units.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from homolog.core.arguments import check_indices
from homolog.core.arrays import takes_arrays
from homolog.geometry import Basis, Operators, Surface, outward

# Few samples tell few functions apart.
_RIDGE = 1e-3


@takes_arrays
def cycle_error(
    points_y: Float[Tensor, "n_y 3"], y_to_x: Int[Tensor, " n_y"], x_to_y: Int[Tensor, " n_x"]
) -> Float[Tensor, " n_y"]:
    """Cycle (round-trip) error: the straight distance between each point of y and where x and back lead it.

    Args:
        points_y: positions (n_y, 3).
        y_to_x: for each point of y a point of x (n_y,).
        x_to_y: the map back (n_x,).

    Returns:
        A length per point of y (n_y,), in the units of the positions.

    Raises:
        ArgumentError: if an index is that of no point, as is -1, where there is no counterpart.

    Examples:
        >>> import numpy as np
        >>> from homolog.maps import cycle_error
        >>> points = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]])
        >>> cycle_error(points, np.array([0, 1, 2]), np.array([0, 1, 1]))
        array([0., 0., 2.])
    """
    check_indices("y_to_x", y_to_x, len(x_to_y))
    check_indices("x_to_y", x_to_y, len(points_y))
    misses: Tensor = (points_y - points_y[x_to_y[y_to_x]]).norm(dim=1)
    return misses


def coverage(
    hit: Operators, hitting: Operators, point_map: Int[Tensor, " n_hitting"], *, spacings: float = 2.0
) -> float:
    """Coverage of a point map: the share of a shape's area that a map from another shape hits, from 0 to 1. New here.

    Args:
        hit: operators of the shape that the map leads to.
        hitting: operators of the shape that it comes from.
        point_map: for each point of ``hitting`` one of ``hit``; entries of -1 hit nothing.
        spacings: a point counts as hit if one that is hit lies this near, in a straight line, in point spacings
            sqrt(area / points) of the coarser shape; above 0, 1 to 3 are sensible. A map onto a shape of the same
            density hits some two points in three by chance, which 2 spacings make up for.

    Raises:
        ArgumentError: if another index is that of no point.

    Examples:
        >>> import torch, trimesh
        >>> from homolog import Shape, compute_operators
        >>> from homolog.maps import coverage
        >>> mesh = trimesh.creation.icosphere(subdivisions=3)
        >>> sphere = compute_operators(Shape(mesh.vertices, mesh.faces))
        >>> coverage(sphere, sphere, torch.arange(sphere.n_points))
        1.0
        >>> coverage(sphere, sphere, torch.zeros(sphere.n_points, dtype=torch.int64)) < 0.05
        True
    """
    aims = torch.unique(point_map[point_map >= 0])
    if not len(aims):
        return 0.0
    check_indices("point_map", aims, hit.n_points)
    radius = spacings * max(_spacing(hit), _spacing(hitting))
    points = hit.points.cpu().numpy()
    away, _ = KDTree(points[aims.cpu().numpy()]).query(points, distance_upper_bound=radius)
    return float(np.average(np.isfinite(away), weights=hit.mass.double().cpu().numpy()))


def _spacing(operators: Operators) -> float:
    return float((operators.mass.sum() / operators.n_points).sqrt())


def dirichlet_energy(
    operators_x: Operators,
    points_y: Float[Tensor, "n_y 3"],
    x_to_y: Int[Tensor, " n_x"],
    *,
    spacing_y: Float[Tensor, " n_y"] | None = None,
    left_out: float = 0.0,
) -> float:
    """Dirichlet energy of a map from x to y, relative to that of the identity of x: how smooth the map is.

    trace(Y^T L Y) of the mapped coordinates Y = points_y[x_to_y] as functions on x, over that of x's own coordinates.
    An isometry has 1, a constant map 0, a map that tears neighbours apart much more. Magnet et al. ("Smooth non-rigid
    shape matching via effective Dirichlet energy optimization", 3DV 2022) report such energies.

    A map to points jumps from one to the next, and nearly equal points of x jump as far as others, though the edge
    between them is short. So what an edge of x adds is scaled by its length over the spacing of y where it is shorter
    than that: what the map resolves then counts, and not how finely x is meshed. New here.

    Args:
        operators_x: of x.
        points_y: positions, at the scale of x (n_y, 3).
        x_to_y: for each point of x a point of y (n_x,).
        spacing_y: of y at each of its points, sqrt(mass) (n_y,); None to take every edge as it is.
        left_out: share of the edges that are left out, those that add most: a good map may tear a few, as between
            legs.

    Raises:
        ArgumentError: if an index is that of no point, as is -1, where there is no counterpart.

    Examples:
        >>> import torch, trimesh
        >>> from homolog import Shape, compute_operators
        >>> from homolog.maps import dirichlet_energy
        >>> mesh = trimesh.creation.icosphere(subdivisions=3)
        >>> sphere = compute_operators(Shape(mesh.vertices, mesh.faces))
        >>> identity = torch.arange(sphere.n_points)
        >>> round(dirichlet_energy(sphere, sphere.points, identity), 4)
        1.0
        >>> scrambled = identity[torch.randperm(len(identity), generator=torch.Generator().manual_seed(0))]
        >>> dirichlet_energy(sphere, sphere.points, scrambled) > 10
        True
    """
    check_indices("x_to_y", x_to_y, len(points_y))
    start, end, weight = _edges(operators_x)
    points_x, images = operators_x.points.double(), points_y.double()[x_to_y]
    lengths, steps = (points_x[start] - points_x[end]).norm(dim=1), (images[start] - images[end]).square().sum(dim=1)
    energy = weight * steps
    if spacing_y is not None:
        spacing = spacing_y.double()[x_to_y]
        energy *= (lengths / torch.maximum(spacing[start], spacing[end])).clamp(max=1.0)
    counted = energy.sum()
    if left_out:
        counted -= energy.topk(round(left_out * len(energy))).values.sum()
    return float(counted / (weight * lengths.square()).sum())


def _edges(operators: Operators) -> tuple[Int[Tensor, " e"], Int[Tensor, " e"], Float[Tensor, " e"]]:
    """The edges of the Laplacian, each both ways, and their weights."""
    laplacian: Tensor = operators.laplacian.to_sparse_coo().coalesce()  # type: ignore[no-untyped-call]  # PyTorch types it not
    start, end = laplacian.indices()
    apart = start != end
    return start[apart], end[apart], -laplacian.values()[apart].double()


def smooth_dirichlet_energy(x: Basis, y: Basis, x_to_y: Int[Tensor, " n_x"], *, eigenpairs: int = 50) -> float:
    """Dirichlet energy of a map between samples of two shapes, relative to that of y's own coordinates. New here.

    As ``dirichlet_energy``, but samples have no edges: the coordinates of y, carried to x, are fitted by the lowest
    eigenfunctions there, whose energies are the eigenvalues. So it tells of the map's smooth part alone.

    Args:
        x: at all its points or samples.
        y: likewise.
        x_to_y: for each of those of x one of y (n_x,).
        eigenpairs: how many to fit with; fewer than a fifth of the samples.

    Examples:
        >>> import torch, trimesh
        >>> from homolog import Shape, compute_operators
        >>> from homolog.maps import smooth_dirichlet_energy
        >>> mesh = trimesh.creation.icosphere(subdivisions=3)
        >>> sphere = compute_operators(Shape(mesh.vertices, mesh.faces)).basis
        >>> identity = torch.arange(sphere.n_points)
        >>> round(smooth_dirichlet_energy(sphere, sphere, identity), 3)
        1.0
        >>> smooth_dirichlet_energy(sphere, sphere, torch.zeros_like(identity)) < 1e-6  # a constant map
        True
    """
    carried, own = _energies(x, y.points[x_to_y], eigenpairs), _energies(y, y.points, eigenpairs)
    return float(carried / own)


def _energies(basis: Basis, functions: Float[Tensor, "n d"], eigenpairs: int) -> Float[Tensor, ""]:
    """The Dirichlet energy of the functions' smooth parts, summed."""
    vectors, energies = basis.eigenvectors[:, :eigenpairs], basis.eigenvalues[:eigenpairs]
    weighted = vectors.mT * (basis.mass / basis.mass.sum())
    normal = weighted @ vectors + _RIDGE * torch.eye(vectors.shape[1]).to(vectors)
    found: Tensor = energies @ torch.linalg.solve(normal, weighted @ functions).square().sum(dim=1)
    return found


def flipped_triangles(x: Surface, y: Surface, x_to_y: Int[np.ndarray, " n_x"]) -> Bool[np.ndarray, " m_x"]:
    """Flipped triangles: which triangles of x a point map turns over on y. New here.

    A mapped triangle is turned over if its normal points away from the normals of y at its corners; degenerate ones,
    drawn as a line or a point, are not. If both surfaces have an outside, their orientations are known, so that a map
    that mirrors the shape turns all triangles over; otherwise the majority is taken to be right.

    Args:
        x: a mesh with m triangles.
        y: the mesh that the map leads to.
        x_to_y: for each vertex of x one of y (n_x,).

    Returns:
        True for each triangle that is turned over (m,).

    Raises:
        ArgumentError: if an index is that of no point, as is -1, where there is no counterpart.

    Examples:
        >>> import numpy as np, trimesh
        >>> from homolog.geometry import Surface
        >>> from homolog.maps import flipped_triangles
        >>> mesh = trimesh.creation.icosphere(subdivisions=1)
        >>> sphere = Surface(np.array(mesh.vertices), np.array(mesh.faces))
        >>> mirrored = np.abs((mesh.vertices * [-1, 1, 1])[:, None] - mesh.vertices).sum(axis=2).argmin(axis=1)
        >>> float(flipped_triangles(sphere, sphere, mirrored).mean())
        1.0
    """
    check_indices("x_to_y", torch.from_numpy(x_to_y), len(y.vertices))
    corners = x_to_y[x.faces]
    drawn = Surface(y.vertices, corners)
    agreement = np.sign(np.einsum("mk,mk->m", drawn.face_vectors, y.vertex_normals[corners].sum(axis=1)))
    facing = outward(x) * outward(y) or np.sign(np.average(agreement, weights=np.linalg.norm(x.face_vectors, axis=1)))
    return np.asarray(agreement * facing < 0)
