"""Matching without learning: what the axiomatic route takes for features, and its first functional map."""

from __future__ import annotations

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.geometry import Operators
from homolog.maps import smoothed_positions, wave_kernel_signature
from homolog.matching.map_problem import MapProblem

# Size and regularisation of the functional map that the refinement starts from: small and stiff, as the descriptors are
# only roughly right; chosen on training pairs of upright people.
_EIGENPAIRS = 15
_REGULARISATION = 1000.0

# Weight of the three coordinates against each of the signature's channels, which have unit norm.
_POSITION_WEIGHT = 30.0

# Added to the mask where signatures stand alone: what is odd about a symmetry they leave undetermined.
_LEAST_PENALTY = 1e-4

# What a signature's channel must vary by, as a share of its size, to be of unit norm.
_LEAST_VARIATION = 1e-4


def axiomatic_descriptors(operators: Operators) -> Float[Tensor, "n d"]:
    """Wave-kernel signatures, and the smoothed position, which tells left from right.

    Needs the two shapes to stand alike: the same way up, facing the same way.
    """
    return torch.cat([_signatures(operators), _POSITION_WEIGHT * smoothed_positions(operators)], dim=1)


def axiomatic_problem(
    source: Operators, target: Operators, features: tuple[Float[Tensor, "n_s d"], Float[Tensor, "n_t d"]]
) -> MapProblem:
    """The axiomatic route's first functional map, from the descriptors of both shapes."""
    return MapProblem.between(source, target, features, size=_EIGENPAIRS, regularisation=_REGULARISATION)


def axis_agreement(source: Operators, target: Operators) -> Float[Tensor, "3 3"]:
    """How well each coordinate of the target (rows) agrees with each of the source (columns), between -1 and 1.

    The source's coordinates are carried over by a functional map of signatures alone, which do not know the pose. As
    they cannot tell left from right either, only the rows of what lies in the plane of symmetry mean much.
    """
    problem = axiomatic_problem(source, target, (_signatures(source), _signatures(target)))
    c_st = replace(problem, mask=problem.mask + _LEAST_PENALTY).forth()
    x, y = _coordinates(source), _coordinates(target)
    agreement: Tensor = y.T @ (c_st @ x) / (x.norm() * y.norm())
    return agreement


def _signatures(operators: Operators) -> Float[Tensor, "n e"]:
    """Wave-kernel signatures about their mean, each channel of unit norm."""
    signature = wave_kernel_signature(operators.eigenvalues, operators.eigenvectors)
    share = operators.mass[:, None] / operators.mass.sum()
    deviation = signature - (share * signature).sum(dim=0)
    size, whole = (_norms(operators, channels) for channels in (deviation, signature))
    # On a symmetric shape a channel may be the same everywhere, but for rounding.
    return deviation / size.clamp(min=_LEAST_VARIATION * whole)


def _norms(operators: Operators, functions: Float[Tensor, "n c"]) -> Float[Tensor, " c"]:
    squared: Tensor = (operators.mass[:, None] * functions.square()).sum(dim=0)
    return squared.sqrt()


def _coordinates(operators: Operators) -> Float[Tensor, "k 3"]:
    """Spectral coefficients of the positions about their mean."""
    share = operators.mass[:, None] / operators.mass.sum()
    centred = operators.points - (share * operators.points).sum(dim=0)
    return operators.truncated(_EIGENPAIRS).coefficients(centred)
