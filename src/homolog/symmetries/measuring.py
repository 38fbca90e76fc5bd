"""How a map stretches the surroundings of each point."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
from jaxtyping import Float
from scipy.sparse.linalg import splu

from homolog.core.errors import ArgumentError
from homolog.geometry import cloud_laplacian, mesh_laplacian
from homolog.shapes import Shape

# Radius of the surroundings, in units of sqrt(area): about a thumb of a body.
_RADIUS = 0.03


def local_stretch(shape: Shape, images: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """By what factor a map stretches lengths around each point; NaN where it has no image. New here.

    The square root of the ratio of two Dirichlet energy densities, that of the images and that of the points
    themselves. Each is the sum of squared edges with cotangent weights, smoothed by one implicit step of heat over a
    radius of 0.03 sqrt(area). It does not depend on how the surface is triangulated.

    Args:
        shape: a clean mesh or cloud.
        images: where the map takes its points (n, 3).

    Returns:
        A factor for each point: 1 where lengths are kept, 2 where they are doubled (n,).

    Raises:
        ArgumentError: if there is not one image for each point.
        ShapeError: if the shape is too degenerate for a Laplacian.

    Examples:
        >>> import homolog
        >>> from homolog.symmetries import local_stretch
        >>> body = homolog.demo_shapes()[0]
        >>> stretch = local_stretch(body, 3 * body.points[:, [1, 0, 2]] + 7)
        >>> bool(np.allclose(stretch, 3))
        True
    """
    if images.shape != shape.points.shape:
        raise ArgumentError(f"images have shape {images.shape}, but must be one for each point, {shape.points.shape}")
    laplacian, mass = (
        cloud_laplacian(shape.points) if shape.faces is None else mesh_laplacian(shape.points, shape.faces)
    )
    edges = sparse.coo_array(-laplacian)
    is_edge = (edges.row != edges.col) & (edges.data > 0)
    ends, weights = np.stack([edges.row, edges.col])[:, is_edge], edges.data[is_edge]
    smoother = splu(sparse.csc_matrix(sparse.diags_array(mass) + _RADIUS**2 * mass.sum() * laplacian))
    known = np.isfinite(images).all(axis=1)
    weights = weights * known[ends].all(axis=0)
    own, at_images = (
        smoother.solve(
            np.bincount(ends[0], weights * ((places[ends[0]] - places[ends[1]]) ** 2).sum(axis=1), len(places))
        )
        for places in (shape.points, np.nan_to_num(images))
    )
    has_edges = known & (own > 0)
    ratio = np.divide(at_images, own, out=np.full(len(own), np.nan), where=has_edges)
    return np.asarray(np.sqrt(np.maximum(ratio, 0.0)))
