"""The method ``axiomatic``: wave kernel signatures and smoothed positions, without learning."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.core.errors import ShapeError, UndeterminedError
from homolog.features import FeatureInfo
from homolog.geometry import Basis, Operators
from homolog.maps import smoothed_positions, wave_kernel_signature
from homolog.methods.functional_map import MapProblem, point_maps_of
from homolog.methods.protocol import FunctionMethod
from homolog.pairs import AxiomaticSettings, Pair, PointMaps

# What a signature's channel must vary by, as a share of its size, to be of unit norm.
_LEAST_VARIATION = 1e-4


@dataclass(frozen=True)
class AxiomaticFeatures:
    """Wave kernel signatures, and the smoothed position, which tells left from right where two shapes stand alike."""

    settings: AxiomaticSettings = field(default_factory=AxiomaticSettings)
    info: ClassVar[FeatureInfo] = FeatureInfo(name="axiomatic", licence="none", input="xyz", upright=False)

    def __call__(self, operators: Operators | Basis, /) -> Float[Tensor, "n d"]:
        """Descriptors of all points (n, d)."""
        positions = self.settings.position_weight * smoothed_positions(operators)
        return torch.cat([_signatures(operators), positions], dim=1)


def axiomatic_problem(
    x: Operators,
    y: Operators,
    features: tuple[Float[Tensor, "n_x d"], Float[Tensor, "n_y d"]],
    settings: AxiomaticSettings | None = None,
) -> MapProblem:
    """The first functional map, from the descriptors of both shapes."""
    settings = settings or AxiomaticSettings()
    return MapProblem.between(x, y, features, size=settings.n_eigenpairs, regularisation=settings.regularisation)


def _signatures(operators: Operators | Basis) -> Float[Tensor, "n e"]:
    """Wave kernel signatures about their mean, each channel of unit norm."""
    signature = wave_kernel_signature(operators.eigenvalues, operators.eigenvectors)
    share = operators.mass[:, None] / operators.mass.sum()
    deviation = signature - (share * signature).sum(dim=0)
    both = deviation, signature
    size, whole = ((operators.mass[:, None] * channels.square()).sum(dim=0).sqrt() for channels in both)
    # On a symmetric shape a channel may be the same everywhere, but for rounding.
    return deviation / size.clamp(min=_LEAST_VARIATION * whole)


def _point_maps(pair: Pair) -> PointMaps:
    x, y = pair.x, pair.y
    features = x.needed_features(), y.needed_features()
    try:
        problem = axiomatic_problem(x.operators, y.operators, features, pair.settings.axiomatic)
        return point_maps_of(problem.c_xy(), problem.c_yx(), pair)
    except UndeterminedError:
        raise ShapeError(f"{x.name} or {y.name} {_why_undetermined(x.operators, y.operators)}") from None


def _why_undetermined(*both: Operators) -> str:
    if any(operators.n_pieces > 1 for operators in both):
        return (
            "falls into too many pieces for the axiomatic method; keep the largest piece, use it as a cloud, "
            "or give weights"
        )
    return "is too small or too symmetric for the axiomatic method; use one with more points, or give weights"


METHOD = FunctionMethod("axiomatic", _point_maps, features=lambda settings: AxiomaticFeatures(settings.axiomatic))
