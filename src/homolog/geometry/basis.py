"""Basis: a shape's Laplacian eigenvectors and their gradients, at all of its points or at a sample of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from homolog.geometry.tangent import turned_scatter

# Keeps the pseudo-inverse bounded where samples cannot tell two eigenvectors apart.
_RIDGE = 1e-4


@dataclass(frozen=True, eq=False)
class Basis:
    """Truncated Laplacian eigenbasis: eigenvectors, their gradients, and the way from functions to coefficients.

    What DiffusionNet computes with. Its tensors can be trained through even if it was made in torch's inference mode.

    Args:
        points: centred and scaled positions (n, 3), the network's input.
        mass: lumped mass (n,).
        eigenvalues: the k lowest (k,).
        eigenvectors: takes coefficients to a function (n, k).
        gradients: takes coefficients to the two components of the gradient, in each point's tangent frame (n, 2, k).
        pseudo_inverse: takes a function's values to its coefficients (k, n).
        scatter: of a cloud, how each point's neighbours spread around it (n, 3, 3), float64; None of a mesh. See
            ``turned_scatter``.

    Examples:
        >>> import torch, trimesh
        >>> from homolog import Shape, compute_operators
        >>> mesh = trimesh.creation.icosphere(subdivisions=3)
        >>> sphere = Shape(mesh.vertices, mesh.faces)
        >>> basis = compute_operators(sphere).basis
        >>> basis.pseudo_inverse.shape, basis.sampled(torch.arange(0, 642, 2)).n_points
        (torch.Size([128, 642]), 321)
    """

    points: Float[Tensor, "n 3"]
    mass: Float[Tensor, " n"]
    eigenvalues: Float[Tensor, " k"]
    eigenvectors: Float[Tensor, "n k"]
    gradients: Float[Tensor, "n 2 k"]
    pseudo_inverse: Float[Tensor, "k n"]
    scatter: Float[Tensor, "n 3 3"] | None = None

    def __repr__(self) -> str:
        """Sizes alone."""
        k, precision = len(self.eigenvalues), str(self.eigenvectors.dtype).removeprefix("torch.")
        return f"Basis({self.n_points} points, {k} eigenpairs, {precision}, {self.points.device})"

    @property
    def n_points(self) -> int:
        """Number of points n."""
        return len(self.points)

    @torch.inference_mode(False)
    def sampled(self, kept: Int[Tensor, " s"]) -> Basis:
        """The same eigenvectors and gradients at a sample of the points, in the given order. New here.

        Coefficients are then those of a function's least-squares fit at the samples, weighted by the mass around each.
        For functions in the span of the eigenvectors that is exact, as long as there are more samples than eigenvectors
        and every region of the shape has some.

        Args:
            kept: indices of the samples (s,).
        """
        nearest = KDTree(self.points[kept].cpu().numpy()).query(self.points.cpu().numpy())[1]
        owner = torch.from_numpy(nearest).to(self.mass.device)
        mass = torch.zeros_like(self.mass[kept]).index_add_(0, owner, self.mass)
        eigenvectors, gradients = self.eigenvectors[kept], self.gradients[kept]
        pseudo_inverse = _least_squares(eigenvectors, mass)
        scatter = None if self.scatter is None else self.scatter[kept]
        return Basis(self.points[kept], mass, self.eigenvalues, eigenvectors, gradients, pseudo_inverse, scatter)

    def truncated(self, n_eigenpairs: int) -> Basis:
        """The same basis with only the lowest eigenpairs."""
        return replace(
            self,
            eigenvalues=self.eigenvalues[:n_eigenpairs],
            eigenvectors=self.eigenvectors[:, :n_eigenpairs],
            gradients=self.gradients[:, :, :n_eigenpairs],
            pseudo_inverse=self.pseudo_inverse[:n_eigenpairs],
        )

    def coefficients(self, functions: Float[Tensor, "n c"]) -> Float[Tensor, "k c"]:
        """Spectral coefficients of functions (n, c)."""
        return self.pseudo_inverse @ functions

    def turned(self, rotation: Float[Tensor, "3 3"]) -> Basis:
        """The basis of the same shape, rotated about the origin."""
        turned = replace(self, points=self.points @ rotation.T)
        if self.scatter is None:
            return turned
        scatter, signs = turned_signs(self.scatter, rotation)
        gradients = self.gradients.clone()
        gradients[:, 0] *= signs.to(gradients)[:, None]
        return replace(turned, gradients=gradients, scatter=scatter)

    def scaled(self, factor: float) -> Basis:
        """The basis of the same shape with all lengths multiplied by a factor."""
        # Eigenvectors of unit norm shrink as the root of the mass grows; their gradients by one factor more.
        return Basis(
            self.points * factor,
            self.mass * factor**2,
            self.eigenvalues / factor**2,
            self.eigenvectors / factor,
            self.gradients / factor**2,
            self.pseudo_inverse * factor,
            self.scatter,
        )

    def moved(self, away: Float[Tensor, " 3"]) -> Basis:
        """The basis of the same shape, shifted."""
        return replace(self, points=self.points + away)

    def in_precision(self, dtype: torch.dtype) -> Basis:
        """The same basis with eigenvectors, gradients and pseudo-inverse in another precision; the rest stays."""
        if self.eigenvectors.dtype == dtype:
            return self
        eigenvectors, gradients, pseudo_inverse = (
            functions.to(dtype) for functions in (self.eigenvectors, self.gradients, self.pseudo_inverse)
        )
        return replace(self, eigenvectors=eigenvectors, gradients=gradients, pseudo_inverse=pseudo_inverse)

    @torch.inference_mode(False)
    def to(self, device: torch.device | str) -> Basis:
        """The same basis on another device."""
        return Basis(
            self.points.to(device),
            self.mass.to(device),
            self.eigenvalues.to(device),
            self.eigenvectors.to(device),
            self.gradients.to(device),
            self.pseudo_inverse.to(device),
            None if self.scatter is None else self.scatter.to(device),
        )


def turned_signs(
    scatter: Float[Tensor, "n 3 3"], rotation: Float[Tensor, "3 3"]
) -> tuple[Float[Tensor, "n 3 3"], Float[Tensor, " n"]]:
    """``turned_scatter`` of tensors."""
    there, signs = turned_scatter(scatter.cpu().numpy(), rotation.detach().double().cpu().numpy())
    return torch.from_numpy(there).to(scatter), torch.from_numpy(signs).to(scatter)


def some_points(n_points: int, count: int, *, seed: int = 0) -> Int[Tensor, " s"]:
    """Some of a shape's points, at random but always the same ones: files list points region by region.

    Examples:
        >>> from homolog.geometry import some_points
        >>> len(some_points(100, 10)), len(some_points(5, 10))
        (10, 5)
    """
    return torch.randperm(n_points, generator=torch.Generator().manual_seed(seed))[:count]


def _least_squares(eigenvectors: Float[Tensor, "s k"], mass: Float[Tensor, " s"]) -> Float[Tensor, "k s"]:
    """The pseudo-inverse: takes values at samples to the coefficients of their weighted least-squares fit."""
    weighted = (mass[:, None] * eigenvectors).mT.double()
    gram = weighted @ eigenvectors.double()
    ridge = _RIDGE * gram.diagonal().mean() * torch.eye(len(gram), dtype=gram.dtype, device=gram.device)
    pseudo_inverse: Tensor = torch.linalg.solve(gram + ridge, weighted).to(eigenvectors)
    return pseudo_inverse
