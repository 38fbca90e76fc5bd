"""Noticing shapes that do not stand as the weights expect: a z-up scan must not fail silently."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from homolog.geometry import Operators, compute_operators
from homolog.maps import most_similar, normalised
from homolog.matching.axiomatic import axiomatic_descriptors, axiomatic_problem, axis_agreement
from homolog.shapes import Shape, rotation_about

# A coarse cloud shows the pose well enough, at a fraction of the cost of the whole shape.
_SAMPLES = 1000
# By how much a turn must raise the mean similarity of matched features to be worth a warning. Over training pairs of
# two benchmarks of upright people, turning one of two shapes never raised it by more than 0.013, and undoing a wrong
# up-axis of one always did by more than 0.06. Turning both tells less: only the usual mistake, z up, can be told.
_CLEARLY_BETTER = 0.02
_BETTER_FOR_BOTH = 0.01
# Features of sparse clouds vary more: of fewer points than above, more is asked for. Between upright training clouds of
# 100 to 700 points, turning one raised the mean by up to 0.11 at 100, 0.07 at 300, 0.04 at 500 and 0.02 at 700.
_SPARSE_POWER = 1.25
# The axiomatic route. By how much another up-axis must agree better with the target's, as maps of signatures alone see
# it, and to what share that turn must lower the misfit. Either sign misleads at times: agreement where a map stands on
# its head, misfit because height changed for width costs it little. Both together never did on 314 pairs of upright
# training meshes, and named every shape whose x or z was up, of 420.
_CLEARLY_MORE_ALIKE = 0.25
_CLEARLY_LOWER = 0.85

_VERTICAL = 1

Features = Callable[[Float[Tensor, "n 3"], Operators], Float[Tensor, "n d"]]


@dataclass(frozen=True)
class Turn:
    """A turn to try: degrees about an axis, what to advise if it helps, and whether to try it on both shapes too."""

    axis: int
    degrees: float
    advice: str
    try_on_both: bool = False

    @property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """The turn as a matrix."""
        return rotation_about(self.axis, self.degrees)

    def __str__(self) -> str:
        return f"{self.degrees:g} degrees about {'xyz'[self.axis]}"


_TURNS = (
    Turn(0, -90, "as a shape with z up needs: give z as {whose} up axis", try_on_both=True),
    Turn(0, 90, "so its -z seems to be up: turn the file", try_on_both=True),
    Turn(2, 90, "as a shape with x up needs: give x as {whose} up axis"),
    Turn(2, -90, "so its -x seems to be up: turn the file"),
    Turn(0, 180, "so it seems to be upside down: turn the file"),
    Turn(1, 90, "so that it faces +z: turn the file"),
    Turn(1, -90, "so that it faces +z: turn the file"),
    Turn(1, 180, "so that it faces +z: turn the file"),
)


def orientation_warnings(
    features: Features,
    source: Shape,
    target: Shape,
    *,
    lengths: tuple[float, float],
    device: torch.device | str = "cpu",
) -> list[str]:
    """Say if the features of two shapes fit better when one of them, or both, are turned by quarters.

    Args:
        features: the network, as a function of positions and operators.
        source: a clean shape.
        target: another.
        lengths: the inner units of both.
        device: where the network is.

    Returns:
        At most one line, that names the shape and the turn that would help most.
    """
    fits = _Fits(
        features,
        *(
            _sampled(shape, length, torch.device(device))
            for shape, length in zip((source, target), lengths, strict=True)
        ),
    )
    (who, turn), gain = max(fits.gains().items(), key=lambda item: item[1])
    if gain < 0:
        return []
    return [_message(who, turn)]


def axiomatic_warnings(source: Operators, target: Operators) -> list[str]:
    """Say if another up-axis of one shape would fit the other much better, as the axiomatic route sees it.

    It only needs the two shapes to stand alike; whether they face the same way this cannot tell.
    """
    agreement = axis_agreement(source, target).double().cpu().numpy()
    heights = dict(_heights(agreement))
    who, turn = max(heights, key=lambda key: heights[key])
    if heights[who, turn] - agreement[_VERTICAL, _VERTICAL] < _CLEARLY_MORE_ALIKE:
        return []
    turned = (_turned(source, turn), target) if who == "source" else (source, _turned(target, turn))
    return [_message(who, turn)] if _misfit(*turned) < _CLEARLY_LOWER * _misfit(source, target) else []


def _heights(agreement: Float[np.ndarray, "3 3"]) -> Iterator[tuple[tuple[str, Turn], float]]:
    """How well the heights of both shapes agree once one is turned."""
    for turn in _TURNS:
        if turn.axis != _VERTICAL:
            yield ("source", turn), float((agreement @ turn.rotation.T)[_VERTICAL, _VERTICAL])
            yield ("target", turn), float((turn.rotation @ agreement)[_VERTICAL, _VERTICAL])


def _misfit(source: Operators, target: Operators) -> float:
    return axiomatic_problem(source, target, (axiomatic_descriptors(source), axiomatic_descriptors(target))).misfit()


def _message(who: str, turn: Turn) -> str:
    subject, verb = {
        "source": ("the source seems turned against the target", "it is"),
        "target": ("the target seems turned against the source", "it is"),
        "both": ("the shapes do not look upright", "both are"),
    }[who]
    whose = "their" if who == "both" else f"the {who}'s"
    return f"{subject}: they fit better when {verb} turned by {turn}, {turn.advice.format(whose=whose)}"


def _turned(operators: Operators, turn: Turn) -> Operators:
    rotation = torch.from_numpy(turn.rotation).to(operators.points)
    return replace(operators, points=operators.points @ rotation.T)


class _Fits:
    """How well features match, as given and turned."""

    def __init__(self, features: Features, source: Operators, target: Operators) -> None:
        self._source = _turned_features(features, source)
        self._target = _turned_features(features, target)
        self._as_given = self._similarity(None, None)
        self._strictness = (_SAMPLES / min(source.n_points, target.n_points)) ** _SPARSE_POWER

    def gains(self) -> Mapping[tuple[str, Turn], float]:
        """By how much each turn raises the similarity beyond what is needed for a warning."""
        gains: dict[tuple[str, Turn], float] = {}
        for_one, for_both = self._strictness * _CLEARLY_BETTER, self._strictness * _BETTER_FOR_BOTH
        for turn in _TURNS:
            gains["source", turn] = self._similarity(turn, None) - self._as_given - for_one
            gains["target", turn] = self._similarity(None, turn) - self._as_given - for_one
            if turn.try_on_both:
                gains["both", turn] = self._similarity(turn, turn) - self._as_given - for_both
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


def _sampled(shape: Shape, length: float, device: torch.device) -> Operators:
    chosen = np.sort(np.random.default_rng(0).permutation(shape.n_points)[:_SAMPLES])
    return compute_operators(Shape(shape.points[chosen], name=shape.name), length=length).to(device)
