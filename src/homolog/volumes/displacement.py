"""Displacement fields: what takes a volume around one shape to that around another, from displacements of points.

The interpolant is exact at the points. A biharmonic spline, the thin plate in three dimensions (J. Duchon, 1977), of
some evenly spread points is smooth everywhere; what it leaves at the others, functions of compact support take up (H.
Wendland, "Piecewise polynomial, positive definite and compactly supported radial functions", 1995), by a sparse system.
So memory and time do not grow with the square of the number of points. Both in one is new here.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse
from jaxtyping import Float
from scipy.ndimage import map_coordinates
from scipy.sparse.linalg import cg
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from homolog.core.arguments import is_real
from homolog.core.errors import ArgumentError, bad_value, needs_extra
from homolog.core.files import atomic_path, expanded
from homolog.core.memory import row_tiles
from homolog.core.progress import Progress, ignore
from homolog.shapes import farthest_points

FIELD_SUFFIXES = (".nrrd", ".mha", ".h5")
"""The suffixes of the files that displacement fields are written to."""

# Points of the smooth spline, neighbours within the reach of the compact functions, and the part of the residual that
# may be left.
_CENTRES, _NEIGHBOURS, _TOLERANCE = 1500, 16, 1e-10
_ITERATIONS = 2000
# Nodes along the longest side by default, and as many in all at most.
_NODES, _MOST_NODES = 64, 20_000_000


class ScatteredInterpolant:
    """A smooth function of space with given values at given points.

    Args:
        points: where values are known, at least four; of several at one place the mean counts (n, 3).
        values: there (n, d).

    Raises:
        ArgumentError: if there are fewer points, not as many values, or one is not finite.

    Examples:
        >>> points = np.random.default_rng(0).random((50, 3))
        >>> smooth = ScatteredInterpolant(points, 2 * points)
        >>> smooth(np.array([[0.5, 0.25, 3.0]])).round(6).tolist()  # linear functions are kept
        [[1.0, 0.5, 6.0]]
    """

    def __init__(self, points: Float[np.ndarray, "n 3"], values: Float[np.ndarray, "n d"]) -> None:
        if points.ndim != 2 or points.shape[1] != 3 or values.ndim != 2 or len(points) != len(values):
            raise ArgumentError(
                f"points and values have shapes {points.shape} and {values.shape}, but must have shapes (n, 3), (n, d)"
            )
        if not (np.isfinite(points).all() and np.isfinite(values).all()):
            raise ArgumentError("points or values hold NaN or infinite numbers, but must be finite")
        points, place = np.unique(points, axis=0, return_inverse=True)
        if len(points) < 4:
            raise ArgumentError(f"{len(points)} different points are given, but four or more are needed")
        place = place.ravel()
        counts = np.bincount(place)
        values = np.stack([np.bincount(place, column) / counts for column in values.T], axis=1)
        self._middle, self._unit = points.mean(axis=0), float(np.ptp(points, axis=0).max())
        at = self._normalised(points)
        self._centres = at[farthest_points(at, min(_CENTRES, len(at)), seed=0)]
        self._fit_smooth(at, values)
        self._fit_local(at, values - self._smooth(at))

    def __call__(self, places: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p d"]:
        """The values at any places."""
        at = self._normalised(places)
        found = self._smooth(at)
        if self._local is not None:
            for rows in row_tiles(len(at), 100 * _NEIGHBOURS):
                found[rows] += self._bumps(at[rows]) @ self._local
        return found

    def _normalised(self, places: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
        return np.asarray((places - self._middle) / self._unit)

    def _fit_smooth(self, at: Float[np.ndarray, "n 3"], values: Float[np.ndarray, "n d"]) -> None:
        """The biharmonic spline of the centres: distances and linear functions, of points in one plane constants."""
        kept = KDTree(at).query(self._centres)[1]
        flat = np.linalg.matrix_rank(self._centres - self._centres.mean(axis=0), tol=1e-9) < 3
        self._linear = not flat
        linear = self._polynomials(self._centres)
        count, extra = linear.shape
        system = np.zeros((count + extra, count + extra))
        system[:count, :count] = -cdist(self._centres, self._centres)
        system[:count, count:], system[count:, :count] = linear, linear.T
        right = np.concatenate([values[kept], np.zeros((extra, values.shape[1]))])
        self._weights = np.linalg.solve(system, right)

    def _polynomials(self, at: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p q"]:
        ones = np.ones((len(at), 1))
        return np.concatenate([ones, at], axis=1) if self._linear else ones

    def _smooth(self, at: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p d"]:
        found = np.empty((len(at), self._weights.shape[1]))
        count = len(self._centres)
        for rows in row_tiles(len(at), 8 * count):
            found[rows] = -cdist(at[rows], self._centres) @ self._weights[:count]
            found[rows] += self._polynomials(at[rows]) @ self._weights[count:]
        return found

    def _fit_local(self, at: Float[np.ndarray, "n 3"], left: Float[np.ndarray, "n d"]) -> None:
        """Compact functions around all points that take up what is left."""
        self._local = None
        if len(at) == len(self._centres):
            return
        self._tree = KDTree(at)
        away = self._tree.query(at[:: max(1, len(at) // 2000)], k=min(_NEIGHBOURS, len(at)))[0]
        self._reach = float(np.median(away[:, -1]))
        matrix = self._bumps(at)
        solutions = [
            cg(matrix, column, rtol=_TOLERANCE, atol=0.0, maxiter=_ITERATIONS)[0] if column.any() else column
            for column in left.T
        ]
        self._local = np.stack(solutions, axis=1)

    def _bumps(self, at: Float[np.ndarray, "p 3"]) -> sparse.csr_array:
        """The value of each point's function (n) at places (p)."""
        near = KDTree(at).sparse_distance_matrix(self._tree, self._reach, output_type="coo_matrix")
        share = near.data / self._reach
        return sparse.csr_array(((1 - share) ** 4 * (4 * share + 1), (near.row, near.col)), shape=near.shape)


@dataclass(frozen=True, eq=False)
class DisplacementField:
    """Displacements on a grid whose axes are those of the coordinates.

    Args:
        values: at each node, along x, y and z (i, j, k, 3).
        origin: of the first node (3,).
        spacing: between nodes.
    """

    values: Float[np.ndarray, "i j k 3"]
    origin: Float[np.ndarray, " 3"]
    spacing: float

    def at(self, places: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
        """Displacements between the nodes by trilinear interpolation, as other programs do; zero beyond the grid."""
        nodes = ((places - self.origin) / self.spacing).T
        columns = [map_coordinates(self.values[..., axis], nodes, order=1, mode="constant") for axis in range(3)]
        return np.stack(columns, axis=1)

    @property
    def folded(self) -> float:
        """The share of nodes where space is turned inside out, so that the field has no inverse there."""
        turned = 0
        for start in range(0, len(self.values), 16):  # slabs, with a slice on either side
            low, high = max(start - 1, 0), min(start + 17, len(self.values))
            slabs = [np.gradient(self.values[low:high, ..., axis], self.spacing, axis=(0, 1, 2)) for axis in range(3)]
            jacobian = np.stack([np.stack(parts, axis=-1) for parts in slabs], axis=-2) + np.eye(3)
            own = slice(start - low, start - low + min(16, len(self.values) - start))
            turned += int((np.linalg.det(jacobian[own]) <= 0).sum())
        return turned / float(np.prod(self.values.shape[:3]))


def displacement_field(
    points: Float[np.ndarray, "n 3"],
    displacements: Float[np.ndarray, "n 3"],
    *,
    spacing: float | None = None,
    margin: float = 0.1,
    progress: Progress = ignore,
) -> DisplacementField:
    """The displacement field on a grid around points that are displaced.

    Args:
        points: (n, 3).
        displacements: of each (n, 3).
        spacing: between nodes, in the points' unit; by default such that 64 lie along the longest side.
        margin: around the bounding box, as a share of its longest side.
        progress: called with the number of slices that are done, their total and what is done.

    Raises:
        ArgumentError: if a number is out of range, or the grid would have more than 20 million nodes.

    Examples:
        >>> points = np.random.default_rng(0).random((100, 3))
        >>> field = displacement_field(points, 0.1 * points, spacing=0.1)
        >>> bool(np.allclose(field.at(points), 0.1 * points, atol=1e-6))
        True
    """
    if not is_real(margin) or margin < 0:
        raise bad_value("margin", margin, "a finite number of at least 0")
    low, high = points.min(axis=0), points.max(axis=0)
    longest = float((high - low).max())
    spacing = longest / _NODES if spacing is None else spacing
    if not is_real(spacing) or not spacing > 0:
        raise bad_value("spacing", spacing, "a positive finite number")
    low, high = low - margin * longest, high + margin * longest
    counts = np.ceil((high - low) / spacing).astype(int) + 1
    if (nodes := float(np.prod(counts.astype(float)))) > _MOST_NODES:
        least = spacing * (nodes / _MOST_NODES) ** (1 / 3)
        raise ArgumentError(
            f"spacing is {spacing:g}, which makes {nodes:.3g} nodes, but {_MOST_NODES:.0e} are the most; give "
            f"{1.05 * least:.3g} or more"
        )
    smooth = ScatteredInterpolant(points, displacements)
    values = np.empty((*counts, 3))
    axes = [start + spacing * np.arange(count) for start, count in zip(low, counts, strict=True)]
    for number, x in enumerate(axes[0]):
        progress(number, len(axes[0]), "displacement field")
        y, z = np.meshgrid(axes[1], axes[2], indexing="ij")
        places = np.stack([np.full(y.size, x), y.ravel(), z.ravel()], axis=1)
        values[number] = smooth(places).reshape(*y.shape, 3)
    return DisplacementField(values, low, spacing)


def check_field_file(path: str | Path) -> None:
    """Refuse a file that no displacement field is written to.

    Raises:
        ArgumentError: if its suffix is another one.
        MissingExtraError: without the extra ``volumes``.
    """
    if not expanded(path).name.lower().endswith(FIELD_SUFFIXES):
        raise ArgumentError(f"{path} is no displacement field; its suffix must be one of {', '.join(FIELD_SUFFIXES)}")
    with needs_extra("displacement fields", "volumes"):
        import SimpleITK  # noqa: F401


def write_displacement_field(path: str | Path, field: DisplacementField) -> None:
    """Write a field as ITK reads it: an image of vectors, or with ``.h5`` a DisplacementFieldTransform.

    Args:
        path: a file with one of ``FIELD_SUFFIXES``.
        field: in LPS coordinates.

    Raises:
        ArgumentError: if the file cannot be written.
        MissingExtraError: without the extra ``volumes``.
    """
    check_field_file(path)
    import SimpleITK

    itk: Any = SimpleITK
    is_transform = expanded(path).name.lower().endswith(".h5")
    values = field.values.transpose(2, 1, 0, 3).astype(np.float64 if is_transform else np.float32)
    image = itk.GetImageFromArray(values, isVector=True)
    image.SetOrigin(field.origin.tolist())
    image.SetSpacing([field.spacing] * 3)
    with atomic_path(path) as temporary:
        if is_transform:
            itk.WriteTransform(itk.DisplacementFieldTransform(image), str(temporary))
        else:
            itk.WriteImage(image, str(temporary), useCompression=True)
