"""What a type checker infers of functions of tensors or numpy arrays is what they return. mypy reads this file."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from typing_extensions import assert_type

from homolog.core.errors import ArgumentError
from homolog.maps import (
    Nearest,
    SoftMatches,
    functional_map,
    nearest_neighbour,
    normalised,
    rigid_motion,
    sinkhorn_matches,
)

TENSOR = torch.eye(3)
ARRAY = np.eye(3)


def test_tensors_give_tensors() -> None:
    one = assert_type(normalised(TENSOR), Tensor)
    both = assert_type(rigid_motion(TENSOR, TENSOR, rounds=2), tuple[Tensor, Tensor])
    solved = assert_type(functional_map(TENSOR, coefficients_y=TENSOR, mask=TENSOR), Tensor)
    nearest = assert_type(nearest_neighbour(TENSOR, TENSOR), Nearest[Tensor])
    matches = assert_type(sinkhorn_matches(TENSOR, TENSOR), SoftMatches[Tensor])
    assert all(isinstance(found, Tensor) for found in (one, *both, solved, nearest.index, matches.y_to_x))


def test_numpy_arrays_give_numpy_arrays() -> None:
    one = assert_type(normalised(ARRAY), np.ndarray)
    both = assert_type(rigid_motion(ARRAY, ARRAY, rounds=2), tuple[np.ndarray, np.ndarray])
    solved = assert_type(functional_map(ARRAY, ARRAY, ARRAY, regularisation=1.0), np.ndarray)
    # What a dataclass of arrays becomes cannot be inferred: whoever wants to be told says so.
    nearest: Nearest[np.ndarray] = assert_type(nearest_neighbour(ARRAY, ARRAY), Any)
    index = assert_type(nearest.index, np.ndarray)
    assert all(isinstance(found, np.ndarray) for found in (one, *both, solved, index))


def test_what_a_type_checker_refuses() -> None:
    """Each of these would be an error of mypy's without its comment; an unneeded comment is one, too."""
    with pytest.raises(ArgumentError, match="features is a str"):
        normalised("features")  # type: ignore[call-overload]
    with pytest.raises(TypeError, match="power"):
        normalised(TENSOR, power=2)  # type: ignore[call-overload]
