"""Noticing shapes that do not stand as the weights expect: a z-up scan must not fail silently."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from homolog.geometry import Operators, compute_operators
from homolog.maps import most_similar, normalised
from homolog.shapes import Shape, rotation_about

# A coarse cloud shows the pose well enough, at a fraction of the cost of the whole shape.
_SAMPLES = 1000
# By how much a turn must raise the mean similarity of matched features to be worth a warning. Over training pairs of
# two benchmarks of upright people, turning one of two shapes never raised it by more than 0.013, and undoing a wrong
# up-axis of one always did by more than 0.06. Turning both tells less: only the usual mistake, z up, can be told.
_CLEARLY_BETTER = 0.02
_BETTER_FOR_BOTH = 0.01

Features = Callable[[Float[Tensor, "n 3"], Operators], Float[Tensor, "n d"]]


@dataclass(frozen=True)
class Turn:
    """A turn to try: degrees about an axis, what to advise if it helps, and whether to try it on both shapes too."""

    axis: int
    degrees: float
    advice: str
    try_on_both: bool = False

    def __str__(self) -> str:
        return f"{self.degrees:g} degrees about {'xyz'[self.axis]}"


_TURNS = (
    Turn(0, -90, "as a file with z up needs: use {up} z", try_on_both=True),
    Turn(0, 90, "so its -z seems to be up: turn the file", try_on_both=True),
    Turn(2, 90, "as a file with x up needs: use {up} x"),
    Turn(2, -90, "so its -x seems to be up: turn the file"),
    Turn(0, 180, "so it seems to be upside down: turn the file"),
    Turn(1, 90, "so that it faces +z: turn the file"),
    Turn(1, -90, "so that it faces +z: turn the file"),
    Turn(1, 180, "so that it faces +z: turn the file"),
)


def orientation_warnings(
    features: Features, source: Shape, target: Shape, *, lengths: tuple[float, float]
) -> list[str]:
    """Say if the features of two shapes fit better when one of them, or both, are turned by quarters.

    Args:
        features: the network, as a function of positions and operators.
        source: a clean shape.
        target: another.
        lengths: the inner units of both.

    Returns:
        At most one line, that names the shape and the turn that would help most.
    """
    fits = _Fits(features, _sampled(source, lengths[0]), _sampled(target, lengths[1]))
    (who, turn), gain = max(fits.gains().items(), key=lambda item: item[1])
    if gain < 0:
        return []
    subject, verb = {
        "source": ("the source seems turned against the target", "it is"),
        "target": ("the target seems turned against the source", "it is"),
        "both": ("the shapes do not look upright", "both are"),
    }[who]
    option = "--up" if who == "both" else f"--{who}-up"
    return [f"{subject}: features fit better when {verb} turned by {turn}, {turn.advice.format(up=option)}"]


class _Fits:
    """How well features match, as given and turned."""

    def __init__(self, features: Features, source: Operators, target: Operators) -> None:
        self._source = _turned_features(features, source)
        self._target = _turned_features(features, target)
        self._as_given = self._similarity(None, None)

    def gains(self) -> Mapping[tuple[str, Turn], float]:
        """By how much each turn raises the similarity beyond what is needed for a warning."""
        gains: dict[tuple[str, Turn], float] = {}
        for turn in _TURNS:
            gains["source", turn] = self._similarity(turn, None) - self._as_given - _CLEARLY_BETTER
            gains["target", turn] = self._similarity(None, turn) - self._as_given - _CLEARLY_BETTER
            if turn.try_on_both:
                gains["both", turn] = self._similarity(turn, turn) - self._as_given - _BETTER_FOR_BOTH
        return gains

    def _similarity(self, source: Turn | None, target: Turn | None) -> float:
        x, y = self._source[source], self._target[target]
        return float(most_similar(x, y).value.mean() + most_similar(y, x).value.mean()) / 2


def _turned_features(features: Features, operators: Operators) -> dict[Turn | None, Float[Tensor, "n d"]]:
    """Normalised features as given (None) and for each turn; the operators do not depend on the pose."""
    found: dict[Turn | None, Tensor] = {None: normalised(features(operators.points, operators))}
    for turn in _TURNS:
        rotation = torch.from_numpy(rotation_about(turn.axis, turn.degrees)).to(operators.points)
        found[turn] = normalised(features(operators.points @ rotation.T, operators))
    return found


def _sampled(shape: Shape, length: float) -> Operators:
    chosen = np.sort(np.random.default_rng(0).permutation(shape.n_points)[:_SAMPLES])
    return compute_operators(Shape(shape.points[chosen], name=shape.name), length=length)
