"""Landmarks of two shapes that are known to correspond: they guide a match."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from homolog.core.arguments import is_real
from homolog.core.choices import Side, System
from homolog.core.errors import ArgumentError, bad_value

Place: TypeAlias = int | tuple[float, float, float]
"""A landmark: the index of a point of the shape as given, or a position in the coordinates of its file."""

MOST_LANDMARKS = 50
"""More pairs than these are refused: guiding is for few points that are known well."""


@dataclass(frozen=True)
class LandmarkPairs:
    """Landmarks of the source and of the target, pair by pair.

    A landmark that one shape lacks has the index -1, or a position of NaN. Its pair is left out.

    Args:
        source: indices of points (p,), or positions in the coordinates of the file (p, 3).
        target: likewise.
        names: of the pairs; by default their numbers, from 1.
        weights: how much each counts, above 0; by default 1.
        uncertainties: how far from the target's landmark the source's may end, in the target's units, from 0; by
            default 0, which is met exactly.
        left_out: the names of landmarks that are on one shape alone.
        axes: the anatomical axes of the positions on the source and on the target, where their files state them;
            positions are then brought to those of the shapes, LPS if these state none.

    Raises:
        ArgumentError: if they are neither indices nor positions, of another number on either shape, or not 1 to 50,
            or if a point of the source belongs to two of the target.

    Examples:
        >>> from homolog.pairs import LandmarkPairs
        >>> pairs = LandmarkPairs([7, 12, -1], [[0, 1, 0], [2, 1.5, 0], [0, 0, 0]], names=["nose", "tail", "ear"])
        >>> pairs.names, pairs.left_out
        (('nose', 'tail'), ('ear',))
    """

    source: tuple[Place, ...]
    target: tuple[Place, ...]
    names: tuple[str, ...] = ()
    weights: tuple[float, ...] = ()
    uncertainties: tuple[float, ...] = ()
    left_out: tuple[str, ...] = ()
    axes: tuple[System | None, System | None] = (None, None)

    def __post_init__(self) -> None:
        source, target = (_places(side, getattr(self, side)) for side in ("source", "target"))
        if len(source) != len(target):
            raise ArgumentError(
                f"landmarks are {len(source)} on the source and {len(target)} on the target, but must be pairs; "
                "give as many of both, with -1 or NaN for those that a shape lacks"
            )
        known = [_is_there(source[i]) and _is_there(target[i]) for i in range(len(source))]
        names = _per_pair("names", self.names or [str(number + 1) for number in range(len(source))], len(source))
        columns: dict[str, Sequence[Any]] = {
            "source": source,
            "target": target,
            "names": [str(name) for name in names],
            "weights": _numbers("weights", self.weights, 1.0, len(source)),
            "uncertainties": _numbers("uncertainties", self.uncertainties, 0.0, len(source)),
        }
        absent = [name for name, there in zip(columns["names"], known, strict=True) if not there]
        for column, values in columns.items():
            kept = tuple(value for value, there in zip(values, known, strict=True) if there)
            object.__setattr__(self, column, kept)
        object.__setattr__(self, "left_out", (*self.left_out, *absent))
        self._check_ends()
        if not 1 <= len(self) <= MOST_LANDMARKS:
            raise ArgumentError(
                f"landmarks hold {len(self)} pairs of points that are on both shapes, but must hold 1 to "
                f"{MOST_LANDMARKS}; " + ("name the same points on both" if not len(self) else "give the surest of them")
            )

    def _check_ends(self) -> None:
        """Refuse a point of the source that belongs to two points of the target."""
        ends: dict[Place, tuple[str, Place]] = {}
        for name, place, end in zip(self.names, self.source, self.target, strict=True):
            other, first = ends.setdefault(place, (name, end))
            if first != end:
                raise ArgumentError(
                    f"the landmarks {other!r} and {name!r} are one point of the source, but two of the target; "
                    "leave one of them out"
                )

    @classmethod
    def by_name(cls, source: Mapping[str, Place], target: Mapping[str, Place]) -> LandmarkPairs:
        """Pairs of the landmarks whose names are on both shapes; the others are left out.

        Examples:
            >>> from homolog.pairs import LandmarkPairs
            >>> LandmarkPairs.by_name({"nose": 3, "ear": 8}, {"tail": 1, "nose": 5}).left_out
            ('ear', 'tail')
        """
        names = [name for name in source if name in target]
        alone = [*(name for name in source if name not in target), *(name for name in target if name not in source)]
        if not names:
            raise ArgumentError(
                f"no landmark has one name on both shapes: {', '.join([*source][:3])} and {', '.join([*target][:3])} "
                "are among them; name them alike, or leave the names out to pair them by their order"
            )
        return cls(
            source=tuple(source[name] for name in names),
            target=tuple(target[name] for name in names),
            names=tuple(names),
            left_out=tuple(alone),
        )

    def __len__(self) -> int:
        return len(self.source)

    def on(self, side: Side, axes: System = "LPS") -> tuple[Place, ...]:
        """The landmarks of a shape that is in these anatomical axes."""
        places, own = (self.source, self.axes[0]) if side == "source" else (self.target, self.axes[1])
        if own in (None, axes):
            return places
        return tuple(place if isinstance(place, int) else (-place[0], -place[1], place[2]) for place in places)


def _places(side: str, given: Any) -> list[Place]:
    """Landmarks of a shape as plain numbers."""
    try:
        values = np.asarray(given.tolist() if hasattr(given, "tolist") else given)
    except ValueError:
        values = np.empty(0, dtype=object)
    if values.ndim == 1 and values.dtype.kind in "iu":
        if len(values) and values.min() < -1:
            raise ArgumentError(f"landmarks of the {side} hold {values.min()}, but must hold indices of points from 0")
        return [int(value) for value in values]
    if values.ndim == 2 and values.shape[1] == 3 and values.dtype.kind in "iuf":
        return [(float(x), float(y), float(z)) for x, y, z in values]
    raise ArgumentError(
        f"landmarks of the {side} have shape {values.shape}, but must be indices of points, whole numbers (p,), or "
        "positions (p, 3)"
    )


def _is_there(place: Place) -> bool:
    return place >= 0 if isinstance(place, int) else bool(np.isfinite(place).all())


def _per_pair(name: str, given: Any, count: int) -> list[Any]:
    values = given.tolist() if hasattr(given, "tolist") else list(given)
    if len(values) != count:
        raise ArgumentError(f"{name} of landmarks are {len(values)}, but must be one for each of the {count} pairs")
    return values


def _numbers(name: str, given: Any, usual: float, count: int) -> list[float]:
    """A number for each pair, above 0, or from 0 where that is usual."""
    values = _per_pair(name, given, count) if len(given) else [usual] * count
    for value in values:
        if not (is_real(value) and (value > 0 or value == usual)):
            raise bad_value(f"{name} of landmarks", value, "finite numbers " + ("above 0" if usual else "from 0"))
    return [float(value) for value in values]
