"""Placing a part on its whole.

Features follow from positions, and a scan seldom lies and stands as the same part of its whole does: one sits where
the other stands. The map itself, good enough here and there, says where the part belongs; from there on features, and
so the map, are better.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog.geometry import Basis
from homolog.maps import most_similar, normalised, rigid_motion
from homolog.shapes import rotation_about

# How many places are looked at from each beginning, that one included.
_PLACES = 4
# How many points of both are compared. A basis at samples needs some twice as many as it has eigenvectors.
_PART_SAMPLES = 1000
_WHOLE_SAMPLES = 2500
# Mean cosine between features from which on the part is at its place, and no other beginning is tried.
_ALIKE = 0.94
# So many beginnings are followed.
_FOLLOWED = 2
# Another size or turn than the given one must be better by this: what nearly is as alike may be a mirrored place.
_CLEARLY = 0.01
# Beginnings: sizes,
_SIZES = (0.8, 1.25, 0.63, 1.6, 0.5, 2.0, 0.4, 2.5, 0.32, 3.2)
# and turns about this axis, by so many degrees.
_TURNS = ((1, 0), (1, 180), (1, 270), (1, 90), (0, 60), (0, -60), (2, 60), (2, -60))

# Middles this near to one another are at one place.
_SAME_PLACE = 1e-3

# The network's features of a shape, given its points' positions and its basis there.
Features = Callable[[Float[Tensor, "s 3"], Basis], Float[Tensor, "s d"]]


@dataclass(frozen=True, eq=False)
class Place:
    """Where a part comes to lie.

    Args:
        points: its positions there, in the whole's units (n, 3).
        size: what its lengths were multiplied by.
        likeness: mean cosine between its features there and the most similar ones of its whole.
    """

    points: Float[Tensor, "n 3"]
    size: float = 1.0
    likeness: float = -math.inf


def placed(
    part: Basis,
    features_of: Features,
    whole: Float[Tensor, "m 3"],
    whole_features: Float[Tensor, "m d"],
    *,
    searched: bool,
) -> Place:
    """A part turned and shifted to where its features resemble its whole's the most.

    Each round, the part follows the rigid motion towards the points of the whole with the most similar features. It
    begins as it is given and with both middles in one place.

    Args:
        part: in the whole's scale.
        features_of: the part's features, of some of its points.
        whole: positions of the whole.
        whole_features: there.
        searched: where the part does not come to resemble its whole, begin anew with it larger or smaller, as it may
            be of another individual, and then with it turned. That is for networks that know parts: to others, a wrong
            place is often as good as the right one.
    """
    ground = _Ground(part, features_of, whole, whole_features)
    best = ground.followed([ground.given(part.points)])
    if searched and best.likeness < _ALIKE:
        others = [ground.given(_turned(part.points, *_TURNS[0], size), size) for size in _SIZES]
        best = _clearly_better(ground.followed(others), best)
    if searched and best.likeness < _ALIKE:
        sizes = dict.fromkeys((1.0, best.size))
        others = [ground.given(_turned(part.points, *turn, size), size) for size in sizes for turn in _TURNS[1:]]
        best = _clearly_better(ground.followed(others), best)
    return best


def _clearly_better(other: Place, best: Place) -> Place:
    return other if other.likeness > best.likeness + _CLEARLY else best


@dataclass(frozen=True, eq=False)
class _Look:
    """A place that was looked at, and the motion towards where the part seems to belong from there."""

    place: Place
    rotation: Float[Tensor, "3 3"]
    shift: Float[Tensor, " 3"]


class _Ground:
    """Samples of a part and of its whole, and how well places of the one fit the other."""

    def __init__(
        self, part: Basis, features_of: Features, whole: Float[Tensor, "m 3"], whole_features: Float[Tensor, "m d"]
    ) -> None:
        self._some = _samples(part.n_points, _PART_SAMPLES).to(part.points.device)
        among = _samples(len(whole), _WHOLE_SAMPLES).to(part.points.device)
        self._basis, self._features_of = part.sampled(self._some), features_of
        self._places, self._candidates = whole[among], normalised(whole_features[among])
        self._middle = whole.mean(dim=0)

    def given(self, points: Float[Tensor, "n 3"], size: float = 1.0) -> list[_Look]:
        """A beginning, and the same with both middles in one place, as they are."""
        away = self._middle - points.mean(dim=0)
        starts = (points, points + away) if away.norm() > _SAME_PLACE else (points,)
        return [self._look(start, size) for start in starts]

    def followed(self, beginnings: Sequence[Sequence[_Look]]) -> Place:
        """The best place on the ways from those beginnings that are the most promising."""
        best = sorted(beginnings, key=lambda looks: -max(look.place.likeness for look in looks))[:_FOLLOWED]
        ways = (place for look in itertools.chain.from_iterable(best) for place in self._way(look))
        return max(ways, key=lambda place: place.likeness)

    def _way(self, look: _Look) -> Iterator[Place]:
        """A place, and those that each lie where the one before it seems to belong."""
        yield look.place
        for _ in range(_PLACES - 1):
            look = self._look(look.place.points @ look.rotation.T + look.shift, look.place.size)
            yield look.place

    def _look(self, points: Float[Tensor, "n 3"], size: float) -> _Look:
        some = points[self._some]
        found = most_similar(normalised(self._features_of(some, self._basis.scaled(size))), self._candidates)
        return _Look(Place(points, size, float(found.value.mean())), *rigid_motion(some, self._places[found.index]))


def _turned(points: Float[Tensor, "n 3"], axis: int, degrees: float, size: float) -> Float[Tensor, "n 3"]:
    """Positions turned and stretched about their middle."""
    middle = points.mean(dim=0)
    return size * (points - middle) @ torch.from_numpy(rotation_about(axis, degrees).T).to(points) + middle


def _samples(n_points: int, wanted: int) -> Int[Tensor, " s"]:
    """Some of the points, at random but always the same ones: files list points region by region."""
    return torch.randperm(n_points, generator=torch.Generator().manual_seed(0))[:wanted]
