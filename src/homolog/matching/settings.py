"""What one can choose about a match."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, get_args

import torch

from homolog.core.arguments import is_count, is_real
from homolog.core.choices import NEED_NO_WEIGHTS as NEED_NO_WEIGHTS
from homolog.core.choices import AsCloud as AsCloud
from homolog.core.choices import Device as Device
from homolog.core.choices import Method as Method
from homolog.core.choices import Side as Side
from homolog.core.errors import ArgumentError, bad_choice, bad_value
from homolog.geometry import OperatorSettings

_Rule = tuple[Callable[[Any], bool], str]
_COUNT_OR_NONE: _Rule = (lambda value: value is None or is_count(value), "a whole number of at least 1, or None")

# For each setting but the method what it may be, as a test and in words.
_ALLOWED: dict[str, _Rule] = {
    "map_eigenpairs": _COUNT_OR_NONE,
    "partial_eigenpairs": _COUNT_OR_NONE,
    "regularisation": (lambda value: is_real(value) and value >= 0, "a finite number of at least 0"),
    "temperature": (lambda value: is_real(value) and value > 0, "a finite number above 0"),
    "iterations": (is_count, "a whole number of at least 1"),
    "refine": (lambda value: isinstance(value, bool), "True or False"),
    "place": (lambda value: isinstance(value, bool), "True or False"),
    "raw_products": (lambda value: isinstance(value, bool), "True or False"),
    "operators": (lambda value: value is None or isinstance(value, OperatorSettings), "OperatorSettings, or None"),
}


@dataclass(frozen=True)
class MatcherSettings:
    """How maps are made from features.

    Args:
        method: the route; ``"auto"`` takes functional maps between meshes and features wherever a cloud takes part
            or the weights are for shapes that are not nearly isometric, and the axiomatic route if there are no
            weights. ``"registration"`` goes by positions alone, see ``homolog.maps.registered_positions``.
        map_eigenpairs: eigenpairs of the functional map; by default what the weights were trained with.
        partial_eigenpairs: the same where one shape is partial; 50 for weights that were not trained on parts.
        regularisation: weight of the resolvent mask.
        temperature: of the soft map between features.
        iterations: of Sinkhorn's algorithm.
        refine: refine the point maps that the network gives, see ``zoomout``; never with weights for shapes
            that are not nearly isometric.
        place: turn and shift a part to where its features fit its whole's best, see ``placed``.
        raw_products: compare features as they come instead of normalised ones; only safe between two clouds, and
            here to reproduce the published code.
        operators: what operators to compute; by default those that the weights were trained with.

    Raises:
        ArgumentError: if one of them is of another kind or size.
    """

    method: Method = "auto"
    map_eigenpairs: int | None = None
    partial_eigenpairs: int | None = None
    regularisation: float = 100.0
    temperature: float = 0.1
    iterations: int = 10
    refine: bool = True
    place: bool = True
    raw_products: bool = False
    operators: OperatorSettings | None = None

    def __post_init__(self) -> None:
        if self.method not in get_args(Method):
            raise bad_choice("method", str(self.method), get_args(Method))
        for name, (holds, allowed) in _ALLOWED.items():
            value = getattr(self, name)
            if not holds(value):
                raise bad_value(name, value, allowed)


def choose_device(device: Device | torch.device) -> torch.device:
    """The torch device for ``"auto"``, ``"cpu"`` or ``"cuda"``; a torch device of these types is taken as it is.

    Raises:
        ArgumentError: if there is no such device.
    """
    kind = device.type if isinstance(device, torch.device) else device
    if kind not in get_args(Device):
        raise bad_choice("device", str(device), get_args(Device))
    if kind == "cuda" and not torch.cuda.is_available():
        raise ArgumentError(f"device is '{device}', but PyTorch finds no CUDA device; use 'cpu' or 'auto'")
    if device == "auto":
        device = "cuda" if torch.cuda.is_available() else "cpu"
    return torch.device(device)
