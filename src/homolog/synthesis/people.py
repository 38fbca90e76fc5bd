"""Synthetic people: builds and poses of the body model, until no limbs pass through each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float

from homolog.core.choices import Poses
from homolog.core.versions import version_of
from homolog.geometry.surface import Surface
from homolog.synthesis.bodies import POSE_SHARES, Character
from homolog.synthesis.body_model import ASSETS
from homolog.synthesis.builds import draw_build, toward_mean
from homolog.synthesis.joints import Rotations, Skeleton, bone_rotations
from homolog.synthesis.poses import POSE_SETS, draw_pose, scaled_pose
from homolog.synthesis.template import Template

# A version, increased whenever the same settings give other people.
_MAKING = 1
# After this many poses the build moves towards the mean with every further pose.
_POSES_PER_BUILD = 6
_LESS_EXTREME = 0.85


class PosedBodies(Protocol):
    """A model of the human body: ``BodyModel``, or a stand-in in tests."""

    @property
    def template(self) -> Template:
        """The closed surface that all bodies share."""

    @property
    def skeleton(self) -> Skeleton:
        """The origin of each bone in the rest pose."""

    def vertices(self, build: Mapping[str, float], rotations: Rotations) -> Float[np.ndarray, "v 3"]:
        """All vertices of the model for a body."""


class People:
    """People of any age, sex and build, in any pose.

    Args:
        model: of the human body.
        poses: ``"natural"``, or ``"wide"`` for those of gymnasts and of people who lie, crawl or fall.
    """

    name = "people"
    stem = "person"
    assets = ASSETS

    def __init__(self, model: PosedBodies, poses: Poses = "natural") -> None:
        self._model, self._poses = model, poses

    @property
    def making(self) -> Mapping[str, Any]:
        """The version of the body model, and poses that are not the usual ones."""
        poses = {} if self._poses == "natural" else {"poses": self._poses}
        return {"way": _MAKING, "anny": version_of("anny"), **poses}

    @property
    def template(self) -> Template:
        """The closed surface that all people share."""
        return self._model.template

    def surface(self, character: Character) -> Surface:
        """The template in the shape and pose of a person."""
        rotations = bone_rotations(character.angles, self._model.skeleton)
        return self.template.surface(self._model.vertices(character.build, rotations))

    def characters(self, seed: int, index: int, generator: np.random.Generator) -> Iterator[Character]:
        """Ever smaller poses of ever new samples, with a build that in the end moves towards the mean."""
        families = tuple(POSE_SETS[self._poses].families)
        build, family = draw_build(seed, index), families[(seed + index) % len(families)]
        draws = 0
        while True:
            pose = draw_pose(family, generator, self._poses)
            for share in POSE_SHARES:
                yield Character(build, family, scaled_pose(pose, share), share)
            draws += 1
            if draws >= _POSES_PER_BUILD:
                build = toward_mean(build, _LESS_EXTREME)
