"""Noticing shapes that do not stand as the weights expect: a z-up scan must not fail silently."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import get_args

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from homolog.geometry import Operators, compute_operators
from homolog.maps import most_similar, normalised
from homolog.methods.axiomatic import AxiomaticFeatures, axiomatic_problem, axis_agreement
from homolog.pairs import Pair
from homolog.shapes import Shape, Up, rotation_about, upright_rotation

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
# The axiomatic method. By how much another up-axis must agree better with the target's, as maps of signatures alone see
# it, and to what share that turn must lower the misfit. Either sign misleads at times: agreement where a map stands on
# its head, misfit because height changed for width costs it little. Both together never did on 314 pairs of upright
# training meshes, and named every shape whose x or z was up, of 420.
_CLEARLY_MORE_ALIKE = 0.25
_CLEARLY_LOWER = 0.85

_VERTICAL, _FORWARD = 1, 2

# Axis and degrees of the turns to try, beside those that another up axis means.
_QUARTERS = ((0, -90), (0, 90), (2, 90), (2, -90), (0, 180), (1, 90), (1, -90), (1, 180))

Ups = tuple[Up, Up]
Features = Callable[[Float[Tensor, "n 3"], Operators], Float[Tensor, "n d"]]


@dataclass(frozen=True, eq=False)
class Turn:
    """A turn to try on a shape that was stood upright, and what to advise for the shape as it was given.

    Args:
        rotation: the turn as a matrix.
        advice: what seems to be wrong and what to do, with places for ``{whose}``, ``{its}``,
            ``{option}`` and ``{file}``.
        tips: whether another axis comes to point up.
    """

    rotation: Float[np.ndarray, "3 3"]
    advice: str
    tips: bool

    @classmethod
    def of(cls, rotation: Float[np.ndarray, "3 3"], up: Up) -> Turn:
        """The turn of a shape whose ``up`` axis has been made +y."""
        return cls(rotation, _advice(rotation, up), tips=rotation[_VERTICAL, _VERTICAL] != 1)


def _advice(rotation: Float[np.ndarray, "3 3"], up: Up) -> str:
    """In terms of the shape as it was given, of which the user has but the up axis in hand."""
    stood = upright_rotation(up)
    points_up = _axis((rotation @ stood)[_VERTICAL])
    if points_up != up and not points_up.startswith("-"):
        return f"{{its}} {points_up} seems to be up; give {points_up} as {{whose}} up axis ({{option}})"
    turn = f"no option mends that: turn the {{file}} by {_in_words(stood.T @ rotation @ stood)}"
    if points_up == up:
        return f"it seems to face another way; {turn}, so that it faces {_axis(stood[_FORWARD], plus='+')}"
    return f"{{its}} {points_up} seems to be up; {turn}"


def _axis(direction: Float[np.ndarray, " 3"], plus: str = "") -> str:
    """A direction along an axis in words, such as "-z"."""
    number = int(np.abs(direction).argmax())
    return f"{'-' if direction[number] < 0 else plus}{'xyz'[number]}"


def _in_words(rotation: Float[np.ndarray, "3 3"]) -> str:
    """A quarter or half turn about a coordinate axis."""
    turns = product(range(3), (90, -90, 180))
    axis, degrees = next(turn for turn in turns if np.array_equal(rotation_about(*turn), rotation))
    return f"{degrees} degrees about {'xyz'[axis]}"


@cache
def _turns(up: Up) -> tuple[Turn, ...]:
    """What to try on one shape: first what the other up axes would do, then quarters and halves about each axis."""
    given = [upright_rotation(other) @ upright_rotation(up).T for other in get_args(Up) if other != up]
    quarters = [rotation_about(axis, degrees) for axis, degrees in _QUARTERS]
    others = [turn for turn in quarters if not any(np.array_equal(turn, known) for known in given)]
    return tuple(Turn.of(rotation, up) for rotation in (*given, *others))


def _turns_of_both(up: Up) -> tuple[Turn, ...]:
    """What to try on both shapes at once: for files said to be y-up only z and -z, else the other up axes."""
    turns = _turns(up)
    return turns[:2] if up != "y" else tuple(turn for turn in turns if turn.rotation[_VERTICAL, _FORWARD])


@torch.no_grad()
def pair_orientation_warnings(pair: Pair) -> tuple[str, ...]:
    """What to tell the user if the shapes of a pair do not stand alike, or not as their features expect.

    Args:
        pair: two preprocessed shapes. Features of a partial shape differ from those of the full one by more than a turn
            makes, so that nothing is said of them.
    """
    extractor, source, target = pair.extractor, pair.source, pair.target
    if pair.is_partial:
        return ()
    if extractor is None or pair.method.name == "axiomatic":
        return tuple(axiomatic_warnings(source.operators, target.operators, ups=(source.up, target.up)))
    if not (extractor.info.upright and extractor.info.follows_pose):
        return ()
    return tuple(
        orientation_warnings(
            lambda points, operators: extractor(replace(operators.basis, points=points)),
            source.repaired.shape,
            target.repaired.shape,
            scales=(source.operators.scale, target.operators.scale),
            ups=(source.up, target.up),
            device=source.operators.points.device,
        )
    )


def orientation_warnings(
    features: Features,
    source: Shape,
    target: Shape,
    *,
    scales: tuple[float, float],
    ups: Ups = ("y", "y"),
    device: torch.device | str = "cpu",
) -> list[str]:
    """Say if the features of two shapes fit better when one of them, or both, are turned by quarters.

    Args:
        features: the network, as a function of positions and operators.
        source: a clean shape.
        target: another.
        scales: the inner units of both.
        ups: the axes that pointed up in both as they were given, before they were stood upright.
        device: where the network is.

    Returns:
        At most one line, that names the shape and what to do about it as it was given.
    """
    clouds = [
        _sampled(shape, scale, torch.device(device)) for shape, scale in zip((source, target), scales, strict=True)
    ]
    fits = _Fits(features, clouds[0], clouds[1], ups)
    (who, turn), gain = max(fits.gains().items(), key=lambda item: item[1])
    if gain < 0:
        return []
    return [_message(who, turn)]


def axiomatic_warnings(source: Operators, target: Operators, *, ups: Ups = ("y", "y")) -> list[str]:
    """Say if another up-axis of one shape would fit the other much better, as the axiomatic method sees it.

    It only needs the two shapes to stand alike; whether they face the same way this cannot tell. For ``ups`` see
    ``orientation_warnings``.
    """
    agreement = axis_agreement(source, target).double().cpu().numpy()
    heights = dict(_heights(agreement, ups))
    who, turn = max(heights, key=lambda key: heights[key])
    if heights[who, turn] - agreement[_VERTICAL, _VERTICAL] < _CLEARLY_MORE_ALIKE:
        return []
    turned = (_turned(source, turn), target) if who == "source" else (source, _turned(target, turn))
    return [_message(who, turn)] if _misfit(*turned) < _CLEARLY_LOWER * _misfit(source, target) else []


def _heights(agreement: Float[np.ndarray, "3 3"], ups: Ups) -> Iterator[tuple[tuple[str, Turn], float]]:
    """How well the heights of both shapes agree once one is turned."""
    for who, up, seen in (("source", ups[0], agreement.T), ("target", ups[1], agreement)):
        for turn in _turns(up):
            if turn.tips:
                yield (who, turn), float((turn.rotation @ seen)[_VERTICAL, _VERTICAL])


def _misfit(source: Operators, target: Operators) -> float:
    features = AxiomaticFeatures()
    return axiomatic_problem(source, target, (features(source), features(target))).misfit()


def _message(who: str, turn: Turn) -> str:
    if who == "both":
        return "the shapes do not look upright: " + turn.advice.format(
            whose="their", its="their", option="source_up and target_up", file="files"
        )
    other = "target" if who == "source" else "source"
    advice = turn.advice.format(whose=f"the {who}'s", its="its", option=f"{who}_up", file="file")
    return f"the {who} seems turned against the {other}: {advice}"


def _turned(operators: Operators, turn: Turn) -> Operators:
    rotation = torch.from_numpy(turn.rotation).to(operators.points)
    return replace(operators, points=operators.points @ rotation.T)


class _Fits:
    """How well features match, as given and turned."""

    def __init__(self, features: Features, source: Operators, target: Operators, ups: Ups) -> None:
        self._source = _turned_features(features, source, ups[0])
        self._target = _turned_features(features, target, ups[1])
        self._for_both = _turns_of_both(ups[0]) if ups[0] == ups[1] else ()
        self._as_given = self._similarity(None, None)
        self._strictness = (_SAMPLES / min(source.n_points, target.n_points)) ** _SPARSE_POWER

    def gains(self) -> Mapping[tuple[str, Turn], float]:
        """By how much each turn raises the similarity beyond what is needed for a warning."""
        for_one, for_both = (self._as_given + self._strictness * more for more in (_CLEARLY_BETTER, _BETTER_FOR_BOTH))
        of_source = {("source", turn): self._similarity(turn, None) - for_one for turn in self._source if turn}
        of_target = {("target", turn): self._similarity(None, turn) - for_one for turn in self._target if turn}
        of_both = {("both", turn): self._similarity(turn, turn) - for_both for turn in self._for_both}
        return of_source | of_target | of_both

    def _similarity(self, source: Turn | None, target: Turn | None) -> float:
        x, y = self._source[source], self._target[target]
        return float(most_similar(x, y).value.mean() + most_similar(y, x).value.mean()) / 2


def _turned_features(features: Features, operators: Operators, up: Up) -> dict[Turn | None, Float[Tensor, "n d"]]:
    """Normalised features as given (None) and for each turn; the operators do not depend on the pose."""
    found: dict[Turn | None, Tensor] = {None: normalised(features(operators.points, operators))}
    for turn in _turns(up):
        turned = _turned(operators, turn)
        found[turn] = normalised(features(turned.points, turned))
    return found


def _sampled(shape: Shape, scale: float, device: torch.device) -> Operators:
    chosen = np.sort(np.random.default_rng(0).permutation(shape.n_points)[:_SAMPLES])
    return compute_operators(Shape(shape.points[chosen], name=shape.name), scale=scale).to(device)
