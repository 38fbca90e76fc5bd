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

# A coarse cloud shows the pose well enough, at a tenth of the cost of the whole shape.
_SAMPLES = 2000
# By how much turning must raise the mean similarity of matched features. On the training pairs of two benchmarks with
# upright people turning raised it by less, save once in fifty; undoing a wrong up-axis raised it by more than 0.05.
_CLEARLY_BETTER = 0.02

Features = Callable[[Float[Tensor, "n 3"], Operators], Float[Tensor, "n d"]]


@dataclass(frozen=True)
class Turn:
    """A turn to try: degrees about an axis, and what to advise if it helps."""

    axis: int
    degrees: float
    advice: str

    def __str__(self) -> str:
        return f"{self.degrees:g} degrees about {'xyz'[self.axis]}"


_TURNS = (
    Turn(0, -90, "as a file with z up needs: use {up} z"),
    Turn(0, 90, "so its -z seems to be up: turn the file"),
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
    best, better = max(fits.by_turn().items(), key=lambda item: item[1])
    gain = better - fits.as_given
    if gain < _CLEARLY_BETTER:
        return []
    who, turn = best
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
        self.as_given = self._similarity(None, None)

    def by_turn(self) -> Mapping[tuple[str, Turn], float]:
        fits: dict[tuple[str, Turn], float] = {}
        for turn in _TURNS:
            fits["source", turn] = self._similarity(turn, None)
            fits["target", turn] = self._similarity(None, turn)
            fits["both", turn] = self._similarity(turn, turn)
        return fits

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
