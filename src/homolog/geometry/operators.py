"""Operators: all that the network and the maps need of one shape, computed once."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
import scipy.sparse as sparse
import torch
from annotated_types import Ge
from jaxtyping import Bool, Float, Int
from torch import Tensor

from homolog.core.arguments import given_or_default
from homolog.core.errors import ShapeError
from homolog.core.settings import Count, Settings
from homolog.geometry.basis import Basis, turned_signs
from homolog.geometry.components import main_component, main_points, require_usable
from homolog.geometry.laplacian import (
    CLOUD_NEIGHBOURS,
    FEWEST_NEIGHBOURS,
    LaplacianKind,
    cloud_laplacian,
    mesh_laplacian,
)
from homolog.geometry.scale import Frame, frame_of
from homolog.geometry.spectrum import lowest_eigenpairs
from homolog.geometry.tangent import (
    gradient_matrices,
    mesh_edges,
    mesh_normals,
    nearest_neighbours,
    normals_of,
    scatter_of,
    tangent_frames,
)
from homolog.shapes import Shape

# Mass of a point in a small component, as a share of the mean: not zero, as mass is divided by.
_SMALL_COMPONENT_MASS = 1e-6

# A sparse matrix of shape (n, n) in torch's compressed-row layout.
SparseMatrix = Tensor


@dataclass(frozen=True, eq=False)
class Operators:
    """Discrete operators of one shape in normalised coordinates (centred, unit area), as float32 tensors.

    Small components take no part, see ``in_main_component``: their rows are zero and they have next to no mass. Their
    constant functions, at eigenvalue zero, would crowd out the eigenfunctions of the shape itself.

    Args:
        points: centred and scaled positions (n, 3), the network's input.
        mass: lumped mass (n,).
        eigenvalues: the k lowest (k,), of L phi = lambda M phi.
        eigenvectors: (n, k), with Phi^T M Phi = I.
        laplacian: positive semidefinite L (n, n), sparse.
        gradient_x: first component of the gradient in each point's tangent frame (n, n), sparse.
        gradient_y: second component, of the same sparsity.
        centre: origin of the normalised coordinates in the file's (3,), float64.
        scale: one normalised unit in the file's units.
        method: how the eigenpairs were found.
        scatter: of a cloud, how each point's neighbours spread around it (n, 3, 3), float64; None of a mesh. It tells
            the signs of its normals, and so the gradients, in another pose.

    Examples:
        >>> import trimesh
        >>> from homolog import Shape, compute_operators
        >>> mesh = trimesh.creation.icosphere(subdivisions=3)
        >>> sphere = Shape(mesh.vertices, mesh.faces)
        >>> operators = compute_operators(sphere)
        >>> operators.n_points, operators.n_eigenpairs, round(float(operators.mass.sum()), 3)
        (642, 128, 1.0)
        >>> operators.coefficients(operators.points).shape
        torch.Size([128, 3])

    See Also:
        ``compute_operators`` and ``OperatorCache.operators`` make them.
    """

    points: Float[Tensor, "n 3"]
    mass: Float[Tensor, " n"]
    eigenvalues: Float[Tensor, " k"]
    eigenvectors: Float[Tensor, "n k"]
    laplacian: SparseMatrix
    gradient_x: SparseMatrix
    gradient_y: SparseMatrix
    centre: Float[Tensor, " 3"]
    scale: float
    method: str
    scatter: Float[Tensor, "n 3 3"] | None = None

    def __repr__(self) -> str:
        """Sizes, scale, and how the eigenpairs were found."""
        sizes = (
            f"{self.n_points} points, {self.n_eigenpairs} eigenpairs, {self.laplacian.values().numel()} entries in L"
        )
        return f"Operators({sizes}, scale={self.scale:.4g}, method={self.method!r}, {self.points.device})"

    @property
    def n_points(self) -> int:
        """Number of points n."""
        return len(self.mass)

    @property
    def n_eigenpairs(self) -> int:
        """Number of eigenpairs k."""
        return len(self.eigenvalues)

    @cached_property
    def basis(self) -> Basis:
        """The eigenbasis with its gradients, at all points; made once."""
        # A tensor made in inference mode could never be trained with.
        with torch.inference_mode(False):
            gradients = (self.gradient_x @ self.eigenvectors, self.gradient_y @ self.eigenvectors)
            return Basis(
                self.points.clone(),
                self.mass.clone(),
                self.eigenvalues.clone(),
                self.eigenvectors.clone(),
                torch.stack(gradients, dim=1),
                (self.mass[:, None] * self.eigenvectors).T.contiguous(),
                None if self.scatter is None else self.scatter.clone(),
            )

    def to(self, device: torch.device | str) -> Operators:
        """The same operators on another device."""
        moved: dict[str, Any] = {name: tensor.to(device) for name, tensor in self.tensors().items()}
        return replace(self, **moved)

    def tensors(self) -> dict[str, Tensor]:
        """All tensors by their names."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if isinstance(value, Tensor)}

    def truncated(self, n_eigenpairs: int) -> Operators:
        """The same operators with only the lowest eigenpairs."""
        return replace(
            self,
            eigenvalues=self.eigenvalues[:n_eigenpairs],
            eigenvectors=self.eigenvectors[:, :n_eigenpairs].contiguous(),
        )

    def scaled(self, factor: float) -> Operators:
        """The operators of the same shape with all lengths multiplied by a factor."""
        # Eigenvectors of unit norm shrink as the root of the mass grows. L, of areas over squared lengths, stays.
        return replace(
            self,
            points=self.points * factor,
            mass=self.mass * factor**2,
            eigenvalues=self.eigenvalues / factor**2,
            eigenvectors=self.eigenvectors / factor,
            gradient_x=self.gradient_x * (1 / factor),
            gradient_y=self.gradient_y * (1 / factor),
            scale=self.scale / factor,
        )

    def turned(self, rotation: Float[Tensor, "3 3"]) -> Operators:
        """The operators of the same shape, rotated about the origin of its normalised coordinates."""
        turned = replace(self, points=self.points @ rotation.to(self.points).T)
        if self.scatter is None:
            return turned
        scatter, signs = turned_signs(self.scatter, rotation)
        rows, columns, values = self.gradient_x.crow_indices(), self.gradient_x.col_indices(), self.gradient_x.values()
        signed = compressed_rows(rows, columns, values * signs.to(values).repeat_interleave(rows.diff()))
        return replace(turned, gradient_x=signed, scatter=scatter)

    def around(self, centre: Float[Tensor, " 3"]) -> Operators:
        """The same operators with positions around another point of the file, such as the centre of a full shape."""
        away = (self.centre - centre.to(self.centre)) / self.scale
        return replace(self, points=self.points + away.to(self.points), centre=centre.to(self.centre))

    def sparse_laplacian(self) -> sparse.csr_array:
        """The Laplacian in SciPy's form and double precision (n, n)."""
        own = self.laplacian.cpu()
        entries = own.values().double().numpy(), own.col_indices().numpy(), own.crow_indices().numpy()
        return sparse.csr_array(entries, shape=(self.n_points, self.n_points))  # the last point may have no entry

    @property
    def n_pieces(self) -> int:
        """Number of connected components: of eigenvalues that are zero, as far as there are eigenpairs."""
        return int((self.eigenvalues <= 1e-6 * self.eigenvalues[-1]).sum())

    @cached_property
    def in_main_component(self) -> Bool[Tensor, " n"]:
        """The points where not every eigenfunction is zero, as it is on small components."""
        return (self.eigenvectors != 0).any(dim=1)

    def coefficients(self, functions: Float[Tensor, "n c"]) -> Float[Tensor, "k c"]:
        """Spectral coefficients Phi^T M f of functions on the shape."""
        return self.eigenvectors.T @ (self.mass[:, None] * functions)


@dataclass(frozen=True)
class OperatorSettings(Settings):
    """What operators to compute.

    Args:
        n_eigenpairs: at least 1; 30 to 200 are sensible. 128 is what the network was published with. Fewer where the
            shape has fewer points.
        laplacian: ``"robust"`` or ``"cotangent"`` for meshes; clouds have but one.
        n_neighbours: neighbours per point of a cloud's Laplacian and gradient, at least 3; 10 to 30 are sensible.

    Examples:
        >>> from homolog.geometry import OperatorSettings
        >>> OperatorSettings(n_eigenpairs=60)
        OperatorSettings(n_eigenpairs=60, laplacian='robust', n_neighbours=14)
    """

    n_eigenpairs: Count = 128
    laplacian: LaplacianKind = "robust"
    n_neighbours: Annotated[int, Ge(FEWEST_NEIGHBOURS)] = CLOUD_NEIGHBOURS


def compute_operators(
    shape: Shape, *, settings: OperatorSettings | None = None, scale: float | None = None
) -> Operators:
    """Compute the operators of a clean shape: Laplacian, mass, gradients and eigenpairs.

    The robust Laplacian of Sharp and Crane (2020), tangent gradients as in DiffusionNet (Sharp et al. 2022), eigenpairs
    by ``lowest_eigenpairs``.

    Args:
        shape: a mesh or a point cloud without invalid, duplicate or unreferenced points, see ``homolog.repair``.
        settings: what to compute.
        scale: one normalised unit in the file's units; by default sqrt(surface area). A partial shape takes that of
            its full partner.

    Raises:
        ArgumentError: if the shape or the settings are something else.
        ShapeError: if the shape is not clean, or too degenerate for operators.

    Examples:
        >>> import trimesh
        >>> from homolog import Shape, compute_operators
        >>> mesh = trimesh.creation.icosphere(subdivisions=3)
        >>> sphere = Shape(mesh.vertices, mesh.faces)
        >>> compute_operators(sphere).eigenvectors.shape
        torch.Size([642, 128])
        >>> compute_operators(sphere.as_cloud()).eigenvectors.shape
        torch.Size([642, 128])

    See Also:
        ``OperatorCache`` keeps them on disk.
    """
    require_usable(shape)
    settings = given_or_default("settings", settings, OperatorSettings)
    neighbours = nearest_neighbours(shape.points, settings.n_neighbours) if shape.faces is None else None
    main = main_points(shape, neighbours)
    component = main_component(shape, main)
    frame = frame_of(component, scale=scale)
    with _named(shape.name):
        operators = _operators(component, frame, settings, neighbours if main.all() else None)
    return (
        operators
        if main.all()
        else _with_small_components(operators, torch.from_numpy(main), frame.to_unit(shape.points))
    )


@contextmanager
def _named(name: str) -> Iterator[None]:
    try:
        yield
    except ShapeError as error:
        raise ShapeError(f"{name}: {error}") from None


def _operators(
    shape: Shape, frame: Frame, settings: OperatorSettings, neighbours: Int[np.ndarray, "n j"] | None
) -> Operators:
    points = frame.to_unit(shape.points)
    if shape.faces is None:
        laplacian, mass = cloud_laplacian(points, n_neighbours=settings.n_neighbours)
        if neighbours is None:
            neighbours = nearest_neighbours(points, settings.n_neighbours)
        scatter = scatter_of(points, neighbours)
        frames = tangent_frames(normals_of(scatter))
        starts = np.repeat(np.arange(len(points)), neighbours.shape[1])
        gradient = gradient_matrices(points, frames, starts, neighbours.ravel())
    else:
        scatter = None
        laplacian, mass = mesh_laplacian(points, shape.faces, kind=settings.laplacian)
        frames = tangent_frames(mesh_normals(points, shape.faces))
        gradient = gradient_matrices(points, frames, *mesh_edges(shape.faces))
    spectrum = lowest_eigenpairs(laplacian, mass, settings.n_eigenpairs)
    return Operators(
        points=_single(points),
        mass=_single(mass),
        eigenvalues=_single(spectrum.eigenvalues),
        eigenvectors=_single(spectrum.eigenvectors),
        laplacian=_sparse_tensor(laplacian),
        gradient_x=_sparse_tensor(gradient[0]),
        gradient_y=_sparse_tensor(gradient[1]),
        centre=torch.from_numpy(frame.centre),
        scale=frame.scale,
        method=spectrum.method,
        scatter=None if scatter is None else torch.from_numpy(scatter),
    )


def _with_small_components(
    operators: Operators, main: Bool[Tensor, " n"], points: Float[np.ndarray, "n 3"]
) -> Operators:
    """Operators of a shape from those of its main component."""
    mass = torch.full((len(main),), _SMALL_COMPONENT_MASS * float(operators.mass.mean()))
    mass[main] = operators.mass
    eigenvectors = torch.zeros(len(main), operators.n_eigenpairs)
    eigenvectors[main] = operators.eigenvectors
    scatter = operators.scatter
    if scatter is not None:
        scatter = torch.zeros(len(main), 3, 3, dtype=scatter.dtype).index_copy_(0, torch.nonzero(main)[:, 0], scatter)
    return replace(
        operators,
        points=_single(points),
        mass=mass,
        eigenvectors=eigenvectors,
        laplacian=_spread(operators.laplacian, main),
        gradient_x=_spread(operators.gradient_x, main),
        gradient_y=_spread(operators.gradient_y, main),
        scatter=scatter,
    )


def _spread(matrix: SparseMatrix, main: Bool[Tensor, " n"]) -> SparseMatrix:
    """A matrix between some of the points as one between all of them, zero elsewhere."""
    rows = matrix.crow_indices()[torch.cat([torch.zeros(1, dtype=torch.long), main.cumsum(0)])]
    columns = torch.nonzero(main)[:, 0].to(rows)[matrix.col_indices()]
    return compressed_rows(rows, columns, matrix.values())


def _single(array: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))


def _sparse_tensor(matrix: sparse.csr_matrix) -> SparseMatrix:
    matrix = matrix.tocsr()
    matrix.sort_indices()
    rows, columns = torch.from_numpy(matrix.indptr.astype(np.int32)), torch.from_numpy(matrix.indices.astype(np.int32))
    return compressed_rows(rows, columns, _single(matrix.data))


def compressed_rows(rows: Int[Tensor, " n+1"], columns: Int[Tensor, " e"], values: Float[Tensor, " e"]) -> SparseMatrix:
    """A sparse square matrix from its row pointers, column indices and values."""
    n = len(rows) - 1
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
        return torch.sparse_csr_tensor(rows, columns, values, size=(n, n), check_invariants=False)
