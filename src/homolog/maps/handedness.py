"""Handedness of a point map: whether it keeps left and right, told from positions alone or from two surfaces."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog.core.arrays import takes_arrays
from homolog.geometry import Basis

# Functions of y are carried to x, and smoothed there by twice as many eigenfunctions.
_CARRIED, _SMOOTHING = 15, 30
_RIDGE, _LEAST_EIGENVALUE = 1e-5, 1e-2


@takes_arrays
def handedness(
    points: Float[Tensor, "n 3"], images: Float[Tensor, "n 3"], *, radius: float = 0.25
) -> Float[Tensor, ""]:
    """Handedness of a map: 1 if it moves every region like a rigid body, -1 if it mirrors every one. New here.

    A rotation cannot take a body to its mirror image, so that a map that exchanges left and right turns regions inside
    out. Around each point, the best affine map of the neighbourhood is that of the covariance of positions and images;
    the sign of its determinant tells its handedness. Neighbourhoods are balls that reach through limbs, so that a cloud
    without normals will do. Returned is the sum of the signed cube roots of these determinants, divided by the same sum
    for the identity.

    Args:
        points: positions in normalised coordinates, of unit area (n, 3).
        images: where the map takes them (n, 3).
        radius: of the neighbourhoods; 0.1 to 0.4 are sensible. A ball must hold more than one side of a limb.

    Returns:
        A number, rarely outside -1 to 1; near 0 where some regions are kept and others mirrored.

    Examples:
        >>> import torch
        >>> from homolog.maps import handedness
        >>> points = torch.rand(200, 3, generator=torch.Generator().manual_seed(0))
        >>> round(float(handedness(points, points)), 4), round(float(handedness(points, -points)), 4)
        (1.0, -1.0)

    See Also:
        ``surface_handedness`` and ``flipped_triangles`` for meshes with an outside.
    """
    near = (torch.cdist(points, points) < radius).to(points)
    counts = near.sum(dim=1)[:, None, None]
    own = _covariances(near, counts, points, points)
    across = _covariances(near, counts, points, images)
    found: Tensor = _signed_sizes(across).sum() / _signed_sizes(own).sum().clamp(min=torch.finfo(points.dtype).tiny)
    return found


def surface_handedness(x: Basis, y: Basis, x_to_y: Int[Tensor, " n_x"]) -> Float[Tensor, ""]:
    """Surface handedness of a map between meshes: 1 if it keeps the orientation of the surface, -1 if it reverses it.

    The map carries smooth functions of y to x. Its differential at a point of x is that linear map of tangent planes
    which takes their gradients on y to those on x, and the sign of its determinant tells its handedness. Returned is
    the sum of the signed square roots of these determinants, divided by the same sum for the identity. Where the map
    tears, gradients do not fit, and it is near 0. Ren, Poulenard, Wonka and Ovsjanikov, "Continuous and
    orientation-preserving correspondences via functional maps", SIGGRAPH Asia 2018, tell orientation by gradients, too.

    Args:
        x: of a mesh whose triangles face outward, at all points or samples.
        y: likewise.
        x_to_y: for each of those of x one of y (n_x,).

    Returns:
        A number, rarely outside -1 to 1. Tangent frames of clouds have no common side: there it means nothing.

    Examples:
        >>> import torch, trimesh
        >>> from homolog import Shape, compute_operators
        >>> from homolog.maps import nearest_neighbour, surface_handedness
        >>> mesh = trimesh.creation.icosphere(subdivisions=3)
        >>> sphere = compute_operators(Shape(mesh.vertices, mesh.faces)).basis
        >>> mirrored = nearest_neighbour(-sphere.points, sphere.points).index
        >>> round(float(surface_handedness(sphere, sphere, torch.arange(642))), 4)
        1.0
        >>> float(surface_handedness(sphere, sphere, mirrored)) < -0.9
        True
    """
    carried = slice(1, _CARRIED)  # the first is constant
    vectors, gradients = x.eigenvectors[:, :_SMOOTHING], x.gradients[:, :, :_SMOOTHING]
    weighted = vectors.mT * x.mass
    # Few samples tell few functions apart.
    normal = weighted @ vectors + _RIDGE * torch.eye(vectors.shape[1]).to(vectors)
    coefficients = torch.linalg.solve(normal, weighted @ y.eigenvectors[x_to_y, carried])
    there = y.gradients[:, :, carried][x_to_y]
    # Each function counts alike, though gradients of higher ones are larger; those of pieces have none.
    levelled = there / y.eigenvalues[carried].clamp(min=_LEAST_EIGENVALUE)
    across = torch.linalg.det(gradients @ coefficients @ levelled.mT)
    own = torch.linalg.det(there @ levelled.mT)
    signed = across.sign() * across.abs().sqrt()
    found: Tensor = (x.mass @ signed) / (x.mass @ own.abs().sqrt()).clamp(min=torch.finfo(x.mass.dtype).tiny)
    return found


def _covariances(
    near: Float[Tensor, "n n"], counts: Float[Tensor, "n 1 1"], a: Float[Tensor, "n 3"], b: Float[Tensor, "n 3"]
) -> Float[Tensor, "n 3 3"]:
    """Covariance of a and b over each point's neighbourhood."""
    products = (a[:, :, None] * b[:, None, :]).flatten(1)
    mean_products = (near @ products).reshape(-1, 3, 3) / counts
    mean_a, mean_b = (near @ values / counts[:, 0] for values in (a, b))
    return mean_products - mean_a[:, :, None] * mean_b[:, None, :]


def _signed_sizes(matrices: Float[Tensor, "n 3 3"]) -> Float[Tensor, " n"]:
    determinants: Tensor = torch.linalg.det(matrices)
    return determinants.sign() * determinants.abs() ** (1 / 3)
