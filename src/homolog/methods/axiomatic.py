"""The method ``axiomatic``: wave kernel signatures and smoothed positions, without learning."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.core.errors import ShapeError, UndeterminedError
from homolog.features import FeatureInfo
from homolog.geometry import Basis, Operators, some_points
from homolog.maps import (
    coarse_fit,
    most_similar,
    nearest_neighbour,
    smoothed_positions,
    wave_kernel_signature,
    zoomout,
)
from homolog.methods.functional_map import MapProblem, point_maps_of
from homolog.methods.protocol import FunctionMethod
from homolog.pairs import AxiomaticSettings, Pair, PointMaps

# What a signature's channel must vary by, as a share of its size, to be of unit norm.
_LEAST_VARIATION = 1e-4
# What the coarse map by features must fit better by, to be taken.
_CLEARLY = 0.15


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
        by_functional_map = point_maps_of(problem.c_xy(), problem.c_yx(), pair)
    except UndeterminedError:
        raise ShapeError(f"{x.name} or {y.name} {_why_undetermined(x.operators, y.operators)}") from None
    if pair.is_partial or not pair.near_isometric or pair.settings.refinement is None:
        return by_functional_map
    unit = x.unit_features(), y.unit_features()
    by_features = PointMaps(most_similar(*unit).index, most_similar(*reversed(unit)).index)
    first, other = _coarse_misfits(pair, (by_functional_map, by_features))
    return by_features if first - other > _CLEARLY else by_functional_map


def _coarse_misfits(pair: Pair, candidates: Iterable[PointMaps]) -> Iterator[float]:
    """What speaks against point maps, each refined among the same samples of both shapes.

    Signatures of near-isometric shapes agree, and a functional map evens their errors out. Those of two species do not,
    and mislead it: there counterparts by features, which are mostly positions, are better.
    """
    settings = pair.settings.orientation
    operators = pair.x.operators, pair.y.operators
    kept = [some_points(one.n_points, settings.samples, seed=seed) for seed, one in enumerate(operators)]
    x, y = (one.basis.sampled(some.to(one.points.device)) for one, some in zip(operators, kept, strict=True))
    unit = pair.x.unit_features()[kept[0]], pair.y.unit_features()[kept[1]]
    phi_x, phi_y = (basis.eigenvectors[:, : settings.map_eigenpairs].contiguous() for basis in (x, y))
    for maps in candidates:
        y_to_x = nearest_neighbour(operators[0].points[maps.y_to_x[kept[1]]], x.points).index
        x_to_y = nearest_neighbour(operators[1].points[maps.x_to_y[kept[0]]], y.points).index
        y_to_x, x_to_y = zoomout(y_to_x, x_to_y, phi_x, phi_y, *unit, settings=settings.refinement)
        yield coarse_fit(x, y, x_to_y, y_to_x, have_outsides=pair.have_outsides, settings=settings.turned).misfit


def _why_undetermined(*both: Operators) -> str:
    if any(operators.n_pieces > 1 for operators in both):
        return (
            "falls into too many pieces for the axiomatic method; keep the largest piece, use it as a cloud, "
            "or give weights"
        )
    return "is too small or too symmetric for the axiomatic method; use one with more points, or give weights"


METHOD = FunctionMethod("axiomatic", _point_maps, features=lambda settings: AxiomaticFeatures(settings.axiomatic))
