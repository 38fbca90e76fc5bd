"""A shape made ready to be matched, and the point maps between two of them."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float, Int
from torch import Tensor

from homolog.geometry import Operators
from homolog.shapes import Modality, Repaired, Up


@dataclass(frozen=True, eq=False)
class Prepared:
    """A shape made ready to be matched any number of times.

    Args:
        repaired: the clean shape and the way back to the one given.
        operators: of the clean shape.
        features: per clean point (n, d): the network's, or descriptors for the axiomatic route.
        up: the axis of the shape as given that was turned to +y.
    """

    repaired: Repaired
    operators: Operators
    features: Float[Tensor, "n d"]
    up: Up = "y"

    @property
    def n_left_out(self) -> int:
        """How many points of the shape as given repair left out, so that nothing was asked of them."""
        return int((self.repaired.clean_index < 0).sum())

    @property
    def modality(self) -> Modality:
        """``"mesh"`` or ``"cloud"``."""
        return self.repaired.shape.modality


@dataclass(frozen=True)
class PointMaps:
    """Point maps between clean shapes; -1 = no counterpart."""

    source_to_target: Int[Tensor, " n_source"]
    target_to_source: Int[Tensor, " n_target"]
