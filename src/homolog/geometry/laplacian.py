"""Laplacian and lumped mass of meshes and point clouds.

Sign and scale: L is positive semidefinite and integrated (weak), so that L phi = lambda M phi with the mass M.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal, get_args

import numpy as np
import robust_laplacian
import scipy.sparse as sparse
from jaxtyping import Float, Int

from homolog.core.errors import ShapeError, bad_choice, bad_value
from homolog.geometry.components import require_usable
from homolog.shapes import Shape

LaplacianKind = Literal["robust", "cotangent"]
"""Laplacian of meshes: ``"robust"`` (Sharp and Crane 2020), for any triangles, or ``"cotangent"``."""

CLOUD_NEIGHBOURS = 14
"""Neighbours per point of the point-cloud Laplacian and gradient: enough for noise and uneven sampling. With the 30 of
published code, hands that touch grow together; fewer than 14 are no better."""
# With fewer, a point's neighbours make no triangles, on which the library for clouds can end the process.
FEWEST_NEIGHBOURS = 3

# A point's mass is at least this share of the mean mass: a point between slivers would otherwise have none.
_SMALLEST_MASS = 1e-6
# For the cotangent Laplacian, a triangle's area is at least this share of the mean area.
_SMALLEST_AREA = 1e-8


def mesh_laplacian(
    points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], *, kind: LaplacianKind = "robust"
) -> tuple[sparse.csr_matrix, Float[np.ndarray, " n"]]:
    """Laplacian (n, n) and lumped mass (n,) of a triangle mesh: robust (Sharp and Crane 2020), or cotangent.

    Args:
        points: positions (n, 3).
        faces: triangles (m, 3).
        kind: ``"robust"``, the default, is the intrinsic Delaunay Laplacian on the tufted cover (Sharp and Crane, "A
            Laplacian for nonmanifold triangle meshes", SGP 2020): no negative weights, any connectivity.
            ``"cotangent"`` is the classical one (Pinkall and Polthier 1993), for comparison.

    Raises:
        ArgumentError: if ``kind`` is neither.
        ShapeError: if they are no mesh, or the triangles are too degenerate for a Laplacian.

    Examples:
        >>> import trimesh
        >>> from homolog.geometry import mesh_laplacian
        >>> mesh = trimesh.creation.icosphere(subdivisions=3)
        >>> laplacian, mass = mesh_laplacian(mesh.vertices, mesh.faces)
        >>> laplacian.shape, round(float(mass.sum()), 1)  # the area, 4 pi but for the mesh's edges
        ((642, 642), 12.5)

    See Also:
        ``compute_operators`` for all of a shape's operators.
    """
    mesh = Shape(points, faces, name="the mesh", allow_broken=True)
    require_usable(mesh, fewest=3)
    if kind == "robust":
        with _degenerate_if_refused():
            laplacian, mass = robust_laplacian.mesh_laplacian(mesh.points, mesh.faces)
        return _checked(laplacian, mass.diagonal())
    if kind == "cotangent":
        return _checked(*_cotangent_laplacian(points, faces))
    raise bad_choice("laplacian", kind, get_args(LaplacianKind))


def cloud_laplacian(
    points: Float[np.ndarray, "n 3"], *, n_neighbours: int = CLOUD_NEIGHBOURS
) -> tuple[sparse.csr_matrix, Float[np.ndarray, " n"]]:
    """Laplacian (n, n) and lumped mass (n,) of a point cloud, from local triangulations (Sharp and Crane 2020).

    The mass sums to the area of those triangulations, which noise inflates: see ``cloud_area`` for a scale.

    Args:
        points: positions (n, 3).
        n_neighbours: neighbours per point, at least 3; 10 to 30 are sensible. 14 is enough for noise and uneven
            sampling; with 30, as in published code, surfaces that touch grow together.

    Raises:
        ArgumentError: if ``n_neighbours`` is too small.
        ShapeError: if they are no cloud, or too degenerate for a Laplacian.

    Examples:
        >>> import trimesh
        >>> from homolog.geometry import cloud_laplacian
        >>> laplacian, mass = cloud_laplacian(trimesh.creation.icosphere(subdivisions=3).vertices)
        >>> laplacian.shape, round(float(mass.sum()), 1)
        ((642, 642), 12.5)
    """
    if n_neighbours < FEWEST_NEIGHBOURS:
        raise bad_value("n_neighbours", n_neighbours, f"at least {FEWEST_NEIGHBOURS}")
    cloud = Shape(points, name="the cloud")
    require_usable(cloud)
    n_neighbours = min(n_neighbours, cloud.n_points - 1)
    # Far from the origin rounding changes which points the library takes for neighbours.
    about_origin = cloud.points - cloud.points.mean(axis=0)
    with _degenerate_if_refused():
        laplacian, mass = robust_laplacian.point_cloud_laplacian(about_origin, n_neighbors=n_neighbours)
    return _checked(laplacian, mass.diagonal())


@contextmanager
def _degenerate_if_refused() -> Iterator[None]:
    try:
        yield
    except RuntimeError:  # an assertion of the library's, of no use to anyone
        raise ShapeError(
            "the Laplacian cannot be made: points coincide or lie on a line, or faces repeat a corner; "
            "use homolog.repair first, or remesh the shape"
        ) from None


def _cotangent_laplacian(
    points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> tuple[sparse.csr_matrix, Float[np.ndarray, " n"]]:
    n = len(points)
    corners = points[faces]
    doubled_area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    # The cotangents of slivers are bounded, so that they stay finite.
    doubled_area = np.maximum(doubled_area, _SMALLEST_AREA * doubled_area.mean())
    weights = sparse.csr_matrix((n, n))
    for corner in range(3):
        a, b = (corner + 1) % 3, (corner + 2) % 3
        towards_a, towards_b = corners[:, a] - corners[:, corner], corners[:, b] - corners[:, corner]
        half_cotangent = 0.5 * np.einsum("ij,ij->i", towards_a, towards_b) / doubled_area
        weights += sparse.csr_matrix((half_cotangent, (faces[:, a], faces[:, b])), shape=(n, n))
    weights = weights + weights.T
    laplacian = sparse.diags(np.asarray(weights.sum(axis=1)).ravel()) - weights
    mass = np.bincount(faces.ravel(), np.repeat(doubled_area / 6, 3), minlength=n)
    return laplacian.tocsr(), mass


def _checked(
    laplacian: sparse.spmatrix, mass: Float[np.ndarray, " n"]
) -> tuple[sparse.csr_matrix, Float[np.ndarray, " n"]]:
    laplacian = sparse.csr_matrix(laplacian)
    if not (np.isfinite(laplacian.data).all() and np.isfinite(mass).all() and mass.sum() > 0):
        raise ShapeError(
            "the Laplacian is not finite: the faces or the spacing of the points are too degenerate; "
            "remesh the shape, or leave the faces out"
        )
    laplacian = (laplacian + laplacian.T) / 2
    return laplacian.tocsr(), np.maximum(mass, _SMALLEST_MASS * mass.mean())
