"""A shape's eigenbasis, at all of its points or at some of them: what the network computes with."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from torch import Tensor

# Keeps the least-squares analysis of samples bounded where they cannot tell two eigenvectors apart.
_RIDGE = 1e-4


@dataclass(frozen=True, eq=False)
class Basis:
    """Eigenvectors, their gradients, and the way from functions to spectral coefficients.

    One made in torch's inference mode can be trained with all the same.

    Args:
        points: centred and scaled positions (n, 3), the network's input.
        mass: lumped mass (n,).
        eigenvalues: the k lowest (k,).
        eigenvectors: what takes coefficients to a function (n, k).
        gradients: what takes them to the two components of its gradient, in each point's tangent frame (n, 2, k).
        analysis: what takes a function's values to its coefficients (k, n).
    """

    points: Float[Tensor, "n 3"]
    mass: Float[Tensor, " n"]
    eigenvalues: Float[Tensor, " k"]
    eigenvectors: Float[Tensor, "n k"]
    gradients: Float[Tensor, "n 2 k"]
    pseudo_inverse: Float[Tensor, "k n"]

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
        """The same eigenvectors and gradients at some of the points only, in the given order.

        Coefficients of a function known there are those of its best fit, weighted by the mass around each sample; for
        what the eigenvectors span that is exact, however few the samples are, as long as they outnumber the
        eigenvectors and leave no part of the shape empty.
        """
        nearest = KDTree(self.points[kept].cpu().numpy()).query(self.points.cpu().numpy())[1]
        owner = torch.from_numpy(nearest).to(self.mass.device)
        mass = torch.zeros_like(self.mass[kept]).index_add_(0, owner, self.mass)
        eigenvectors, gradients = self.eigenvectors[kept], self.gradients[kept]
        pseudo_inverse = _least_squares(eigenvectors, mass)
        return Basis(self.points[kept], mass, self.eigenvalues, eigenvectors, gradients, pseudo_inverse)

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
        )

    def moved(self, away: Float[Tensor, " 3"]) -> Basis:
        """The basis of the same shape elsewhere."""
        return replace(self, points=self.points + away)

    def in_precision(self, dtype: torch.dtype) -> Basis:
        """The same basis with functions in another precision; eigenvalues, points and mass stay."""
        if self.eigenvectors.dtype == dtype:
            return self
        functions = self.eigenvectors.to(dtype), self.gradients.to(dtype), self.pseudo_inverse.to(dtype)
        return Basis(self.points, self.mass, self.eigenvalues, *functions)

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
        )


def _least_squares(eigenvectors: Float[Tensor, "s k"], mass: Float[Tensor, " s"]) -> Float[Tensor, "k s"]:
    """The matrix that takes values at samples to the coefficients of their weighted least-squares fit."""
    weighted = (mass[:, None] * eigenvectors).mT.double()
    gram = weighted @ eigenvectors.double()
    ridge = _RIDGE * gram.diagonal().mean() * torch.eye(len(gram), dtype=gram.dtype, device=gram.device)
    pseudo_inverse: Tensor = torch.linalg.solve(gram + ridge, weighted).to(eigenvectors)
    return pseudo_inverse
