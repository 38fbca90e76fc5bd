"""The linear systems that functional maps between two shapes solve, from their features."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from homolog.geometry import Operators
from homolog.maps import functional_map, resolvent_mask


@dataclass(frozen=True)
class MapProblem:
    """Spectral coefficients of two shapes' features, and how entries far from the diagonal are penalised.

    Args:
        coefficients_x: A, of the source (k_x, d).
        coefficients_y: B, of the target (k_y, d).
        mask: of the map from source to target (k_y, k_x).
        regularisation: weight of the mask.
    """

    coefficients_x: Float[Tensor, "k_x d"]
    coefficients_y: Float[Tensor, "k_y d"]
    mask: Float[Tensor, "k_y k_x"]
    regularisation: float

    @classmethod
    def between(
        cls,
        source: Operators,
        target: Operators,
        features: tuple[Float[Tensor, "n_x d"], Float[Tensor, "n_y d"]],
        *,
        size: int,
        regularisation: float,
    ) -> MapProblem:
        """The problem in the lowest ``size`` eigenpairs of both shapes."""
        x, y = source.truncated(size), target.truncated(size)
        mask = resolvent_mask(x.eigenvalues, y.eigenvalues)
        return cls(x.coefficients(features[0]), y.coefficients(features[1]), mask, regularisation)

    def forth(self) -> Float[Tensor, "k_y k_x"]:
        """The functional map from source to target; see ``functional_map`` for what it raises."""
        a, b = self.coefficients_x, self.coefficients_y
        return functional_map(a, b, self.mask, regularisation=self.regularisation)

    def back(self) -> Float[Tensor, "k_x k_y"]:
        """The one from target to source."""
        a, b = self.coefficients_x, self.coefficients_y
        return functional_map(b, a, self.mask.mT, regularisation=self.regularisation)

    def misfit(self) -> float:
        """What is left of |C A - B|^2 + regularisation * sum_ij C_ij^2 mask_ij at the map from source to target."""
        c_xy = self.forth()
        residual = (c_xy @ self.coefficients_x - self.coefficients_y).square().sum()
        return float(residual + self.regularisation * (c_xy.square() * self.mask).sum())
