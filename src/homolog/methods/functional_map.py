"""The method ``functional-map``: features compared in the lowest eigenfunctions of both shapes."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from homolog.geometry import Operators
from homolog.maps import functional_map, nearest_neighbour, point_map_from_functional_map, resolvent_mask
from homolog.methods.protocol import FunctionMethod
from homolog.pairs import Pair, PointMaps


@dataclass(frozen=True)
class MapProblem:
    """The linear systems that functional maps between two shapes solve, from their features.

    Ren, Panine, Wonka and Ovsjanikov, "Structured regularization of functional map computations", SGP 2019.

    Args:
        coefficients_x: A, of the features of x (k_x, d).
        coefficients_y: B, of those of y (k_y, d).
        mask: of the map from x to y (k_y, k_x).
        regularisation: weight of the mask.
    """

    coefficients_x: Float[Tensor, "k_x d"]
    coefficients_y: Float[Tensor, "k_y d"]
    mask: Float[Tensor, "k_y k_x"]
    regularisation: float

    @classmethod
    def between(
        cls,
        x: Operators,
        y: Operators,
        features: tuple[Float[Tensor, "n_x d"], Float[Tensor, "n_y d"]],
        *,
        size: int,
        regularisation: float,
    ) -> MapProblem:
        """The problem in the lowest ``size`` eigenpairs of both shapes."""
        x, y = x.truncated(size), y.truncated(size)
        mask = resolvent_mask(x.eigenvalues, y.eigenvalues)
        return cls(x.coefficients(features[0]), y.coefficients(features[1]), mask, regularisation)

    def c_xy(self) -> Float[Tensor, "k_y k_x"]:
        """The functional map from x to y; see ``functional_map`` for what it raises."""
        a, b = self.coefficients_x, self.coefficients_y
        return functional_map(a, b, self.mask, regularisation=self.regularisation)

    def c_yx(self) -> Float[Tensor, "k_x k_y"]:
        """The functional map from y to x."""
        a, b = self.coefficients_x, self.coefficients_y
        return functional_map(b, a, self.mask.mT, regularisation=self.regularisation)

    def misfit(self) -> float:
        """What is left of |C A - B|^2 + regularisation * sum_ij C_ij^2 mask_ij at the map from x to y."""
        c_xy = self.c_xy()
        residual = (c_xy @ self.coefficients_x - self.coefficients_y).square().sum()
        return float(residual + self.regularisation * (c_xy.square() * self.mask).sum())


def functional_maps(pair: Pair) -> tuple[Float[Tensor, "k_y k_x"], Float[Tensor, "k_x k_y"]]:
    """The functional maps C_xy and C_yx that fit the features of a pair."""
    x, y = pair.x, pair.y
    problem = MapProblem.between(
        x.operators,
        y.operators,
        (x.needed_features(), y.needed_features()),
        size=pair.map_size,
        regularisation=pair.settings.functional_map.regularisation,
    )
    return problem.c_xy(), problem.c_yx()


def point_maps_of(c_xy: Float[Tensor, "k_y k_x"], c_yx: Float[Tensor, "k_x k_y"], pair: Pair) -> PointMaps:
    """The point maps of two functional maps: nearest neighbours in the spectral embedding."""
    phi_x, phi_y = pair.x.operators.eigenvectors, pair.y.operators.eigenvectors
    y_to_x = point_map_from_functional_map(c_xy, phi_x, phi_y)
    if not pair.is_partial:
        return PointMaps(point_map_from_functional_map(c_yx, phi_y, phi_x), y_to_x)
    # The way back lies in the same embedding: the map from the partial shape to the full one has too few rows to trust.
    k_y, k_x = c_xy.shape
    return PointMaps(nearest_neighbour(phi_x[:, :k_x] @ c_xy.T, phi_y[:, :k_y]).index, y_to_x)


def _point_maps(pair: Pair) -> PointMaps:
    return point_maps_of(*functional_maps(pair), pair)


METHOD = FunctionMethod("functional-map", _point_maps)
