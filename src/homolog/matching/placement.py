"""Placing a part on its whole.

Features follow from positions, and a scan seldom lies and stands as the same part of its whole does: one sits where
the other stands. The map itself, good enough here and there, says where the part belongs; from there on features, and
so the map, are better.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog.maps import most_similar, normalised, rigid_motion

# How often the part is moved, and how many points say where to; the whole's are what they are compared with.
_ROUNDS = 4
_PART_SAMPLES = 1000
_WHOLE_SAMPLES = 2500

# The network's features of a shape, with its points at these positions.
FeaturesAt = Callable[[Float[Tensor, "n 3"]], Float[Tensor, "n d"]]


def placed(
    part: Float[Tensor, "n 3"],
    features_at: FeaturesAt,
    whole: Float[Tensor, "m 3"],
    whole_features: Float[Tensor, "m d"],
) -> Float[Tensor, "n 3"]:
    """A part's positions, turned and shifted to where its features resemble its whole's the most.

    Begins where the part is given and where both have their middles in one place; each round, the part follows the
    rigid motion towards the points of the whole with the most similar features. The best place on the way is kept.

    Args:
        part: positions, in the whole's scale.
        features_at: the features of the part at given positions.
        whole: positions of the whole.
        whole_features: there.
    """
    some = _samples(len(part), _PART_SAMPLES).to(part.device)
    among = _samples(len(whole), _WHOLE_SAMPLES).to(part.device)
    candidates = normalised(whole_features[among])
    best, best_likeness = part, -torch.inf
    for start in (part, part - part.mean(dim=0)):
        for _ in range(_ROUNDS):
            found = most_similar(normalised(features_at(start)[some]), candidates)
            likeness = float(found.value.mean())
            if likeness > best_likeness:
                best, best_likeness = start, likeness
            rotation, shift = rigid_motion(start[some], whole[among][found.index])
            start = start @ rotation.T + shift
    return best


def _samples(n_points: int, wanted: int) -> Int[Tensor, " s"]:
    """Some of the points, at random but always the same ones: files list points region by region."""
    return torch.randperm(n_points, generator=torch.Generator().manual_seed(0))[:wanted]
