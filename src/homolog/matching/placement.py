"""Placing a part on its whole.

Features follow from positions, and a scan seldom lies and stands as the same part of its whole does: one sits where
the other stands. The map itself, good enough here and there, says where the part belongs; from there on features, and
so the map, are better.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

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
# Beginnings: turns about this axis, by so many degrees.
_TURNS = ((1, 0), (1, 180), (1, 270), (1, 90), (0, 60), (0, -60), (2, 60), (2, -60))

# Middles this near to one another are at one place.
_SAME_PLACE = 1e-3

# The network's features of a shape, given its points' positions and its basis there.
Features = Callable[[Float[Tensor, "s 3"], Basis], Float[Tensor, "s d"]]


def placed(
    part: Basis,
    features_of: Features,
    whole: Float[Tensor, "m 3"],
    whole_features: Float[Tensor, "m d"],
    *,
    turned: bool,
) -> Float[Tensor, "n 3"]:
    """A part's positions, turned and shifted to where its features resemble its whole's the most.

    Each round, the part follows the rigid motion towards the points of the whole with the most similar features. It
    begins as it is given and with both middles in one place.

    Args:
        part: in the whole's scale.
        features_of: the part's features, of some of its points.
        whole: positions of the whole.
        whole_features: there.
        turned: where the part does not come to resemble its whole, begin anew with it turned. That is for networks that
            know parts: to others, a wrong place is often as good as the right one.
    """
    some = _samples(part.n_points, _PART_SAMPLES).to(part.points.device)
    among = _samples(len(whole), _WHOLE_SAMPLES).to(part.points.device)
    basis, places, candidates = part.sampled(some), whole[among], normalised(whole_features[among])
    best, best_likeness = part.points, -torch.inf
    for start in _beginnings(part.points, whole.mean(dim=0), _TURNS if turned else _TURNS[:1]):
        for _ in range(_PLACES):
            found = most_similar(normalised(features_of(start[some], basis)), candidates)
            likeness = float(found.value.mean())
            if likeness > best_likeness:
                best, best_likeness = start, likeness
            rotation, shift = rigid_motion(start[some], places[found.index])
            start = start @ rotation.T + shift
        if best_likeness >= _ALIKE:
            break
    return best


def _beginnings(
    points: Float[Tensor, "n 3"], goal: Float[Tensor, " 3"], turns: Sequence[tuple[int, float]]
) -> Iterator[Float[Tensor, "n 3"]]:
    middle = points.mean(dim=0)
    for axis, degrees in turns:
        turned = (points - middle) @ torch.from_numpy(rotation_about(axis, degrees).T).to(points)
        yield turned + middle if degrees else points
        if (middle - goal).norm() > _SAME_PLACE:
            yield turned + goal


def _samples(n_points: int, wanted: int) -> Int[Tensor, " s"]:
    """Some of the points, at random but always the same ones: files list points region by region."""
    return torch.randperm(n_points, generator=torch.Generator().manual_seed(0))[:wanted]
