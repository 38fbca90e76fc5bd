"""Noticing shapes that do not stand as the weights expect: a z-up scan must not fail silently."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from homolog.geometry import Operators, compute_operators
from homolog.maps import most_similar, normalised
from homolog.matching.axiomatic import misfit
from homolog.shapes import Shape, rotation_about

# A coarse cloud shows the pose well enough, at a fraction of the cost of the whole shape.
_SAMPLES = 1000
# By how much a turn must raise the mean similarity of matched features to be worth a warning. Over training pairs of
# two benchmarks of upright people, turning one of two shapes never raised it by more than 0.013, and undoing a wrong
# up-axis of one always did by more than 0.06. Turning both tells less: only the usual mistake, z up, can be told.
_CLEARLY_BETTER = 0.02
_BETTER_FOR_BOTH = 0.01
# To what share turning the source must lower the misfit of the axiomatic route. On the same pairs, turning the up-axis
# of an upright shape never lowered it at all, and undoing such a turn lowered it ninefold on average.
_CLEARLY_LOWER = 0.6

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


_VERTICAL = 1
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

# Turns that no option makes, each with the one that undoes it and that an option does make.
_BACK = {_TURNS[1]: _TURNS[0], _TURNS[3]: _TURNS[2]}


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
    return [_message(who, turn)]


def axiomatic_warnings(source: Operators, target: Operators) -> list[str]:
    """Say if another up-axis of the source would fit the target much better, as the axiomatic route sees it.

    It only needs the two shapes to stand alike; whether they face the same way its misfit cannot tell.
    """
    allowed = _CLEARLY_LOWER * misfit(source, target)
    misfits = {turn: misfit(_turned(source, turn), target) for turn in _TURNS if turn.axis != _VERTICAL}
    turn = min(misfits, key=lambda turn: misfits[turn])
    if misfits[turn] > allowed:
        return []
    # Turning the target back is the same to this route; of the two the user is told the one that an option can mend.
    return [_message("target", _BACK[turn]) if turn in _BACK else _message("source", turn)]


def _message(who: str, turn: Turn) -> str:
    subject, verb = {
        "source": ("the source seems turned against the target", "it is"),
        "target": ("the target seems turned against the source", "it is"),
        "both": ("the shapes do not look upright", "both are"),
    }[who]
    option = "--up" if who == "both" else f"--{who}-up"
    return f"{subject}: they fit better when {verb} turned by {turn}, {turn.advice.format(up=option)}"


def _turned(operators: Operators, turn: Turn) -> Operators:
    rotation = torch.from_numpy(rotation_about(turn.axis, turn.degrees)).to(operators.points)
    return replace(operators, points=operators.points @ rotation.T)


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
        turned = _turned(operators, turn)
        found[turn] = normalised(features(turned.points, turned))
    return found


def _sampled(shape: Shape, length: float) -> Operators:
    chosen = np.sort(np.random.default_rng(0).permutation(shape.n_points)[:_SAMPLES])
    return compute_operators(Shape(shape.points[chosen], name=shape.name), length=length)
