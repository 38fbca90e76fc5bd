"""Handedness of a point map: whether it keeps left and right, told from positions alone."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.core.arrays import takes_arrays


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
        ``flipped_triangles`` for meshes with an outside.
    """
    near = (torch.cdist(points, points) < radius).to(points)
    counts = near.sum(dim=1)[:, None, None]
    own = _covariances(near, counts, points, points)
    across = _covariances(near, counts, points, images)
    found: Tensor = _signed_sizes(across).sum() / _signed_sizes(own).sum().clamp(min=torch.finfo(points.dtype).tiny)
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
