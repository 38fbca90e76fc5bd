"""Synthetic hands: left or right ones, cut from the body model at the wrist, each individual in several poses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from homolog.core.choices import HandSides
from homolog.core.versions import version_of
from homolog.geometry.surface import Surface
from homolog.synthesis.bodies import POSE_SHARES, POSES_OF_ONE, Character
from homolog.synthesis.body_model import ASSETS, BodyModel
from homolog.synthesis.builds import draw_build
from homolog.synthesis.creases import without_creases
from homolog.synthesis.hand_joints import AT_REST, FAMILIES, FINGERS, bone_rotations, draw_pose, hand_frame
from homolog.synthesis.joints import about
from homolog.synthesis.poses import scaled_pose
from homolog.synthesis.template import Template

# A version, increased whenever the same settings give other hands.
_MAKING = 1
# The streams of random numbers of individuals, apart from those of bodies.
_STREAM = 1
# Standard deviations and limits of the amounts of anny's local changes.
_CHANGES = {
    "l-hand-fingers-length-incr": 0.5,
    "l-hand-fingers-diameter-incr": 0.45,
    "l-hand-fingers-distance-incr": 0.4,
    "measure-wrist-circ-incr": 0.4,
}
# Of the logarithm of a finger's size, and of the angle in degrees by which the palm's bones fan out.
_FINGER_SPREAD, _FAN_SPREAD, _FAN_LIMIT = 0.06, 1.5, 3.0
# By how much each of the palm's bones takes part in that, and the thumb.
_FAN = {"metacarpal1": 1.0, "metacarpal2": 0.3, "metacarpal3": -0.4, "metacarpal4": -1.0, "finger1-1": 1.5}


class Hands:
    """Hands of people of any age and build, in many poses: fingers point to +y, the thumb to +x.

    Palms of left hands look to -z. Right hands are reflected left ones, whose palms look to +z.

    Args:
        model: of the human body, with the details of hands.
        sides: whose hands: ``"left"``, ``"right"``, or ``"both"`` for individuals of which each is one side.
    """

    name = "hands"
    stem = "hand"
    assets = ASSETS

    def __init__(self, model: BodyModel, sides: HandSides = "both") -> None:
        self._model, self._sides = model, sides

    @property
    def making(self) -> Mapping[str, Any]:
        """The versions of the way in which hands are made and of the body model, and the sides."""
        return {"kind": self.name, "way": _MAKING, "anny": version_of("anny"), "sides": self._sides}

    @cached_property
    def template(self) -> Template:
        """The closed surface that all hands share: a left hand at rest."""
        part = self._model.part("hand.L")
        return replace(part, rest=self._framed(part, part.rest))

    def surface(self, character: Character) -> Surface:
        """The template in the shape and pose of a left hand."""
        build = character.build
        turns = bone_rotations(character.angles, self._model.skeleton)
        for bone, matrix in self._of_individual(build).items():
            turns[bone] = turns.get(bone, np.eye(3)) @ matrix
        vertices = self._model.vertices(build["body"], turns, build["changes"])
        hand = without_creases(self.template.surface(vertices), self._at_joints)
        return self._framed(self.template, hand)

    def characters(self, seed: int, index: int, generator: np.random.Generator) -> Iterator[Character]:
        """Ever smaller poses of ever new samples of the individual's next family of poses."""
        number, families = index // POSES_OF_ONE, tuple(FAMILIES)
        build = _draw_individual(seed, number, self._sides)
        family = families[(seed + 5 * index + number // len(families)) % len(families)]
        while True:
            pose = draw_pose(family, generator)
            for share in POSE_SHARES:
                angles = scaled_pose(pose, share, AT_REST)
                yield Character(build, family, angles, share, index % 2 == 1, build["side"] == "right")

    @cached_property
    def _at_joints(self) -> Bool[np.ndarray, " n"]:
        """Which vertices of the template may move to open a crease; tips of fingers do not."""
        return np.append(self._model.at_joints[self.template.kept], np.zeros(len(self.template.rims), dtype=bool))

    def _of_individual(self, build: Mapping[str, Any]) -> dict[str, Float[np.ndarray, "3 3"]]:
        """How the bones of an individual differ from the body model's: turned in the palm, and scaled."""
        out_of_back = hand_frame(self._model.skeleton)[2]
        bones = {bone: about(out_of_back, -share * build["fan"]).as_matrix() for bone, share in _FAN.items()}
        for finger, size in build["fingers"].items():
            bone = f"finger{finger}-1"
            bones[bone] = size * bones.get(bone, np.eye(3))
        return {f"{bone}.L": matrix for bone, matrix in bones.items()}

    def _framed(self, template: Template, surface: Surface) -> Surface:
        """The surface with the middle of its cut in the origin, and fingers upwards."""
        middle = surface.vertices[np.unique(template.faces[template.lid])].mean(axis=0)
        return Surface((surface.vertices - middle) @ hand_frame(self._model.skeleton).T, surface.faces)


def _draw_individual(seed: int, number: int, sides: HandSides) -> dict[str, Any]:
    """The parameters of an individual's hand."""
    generator = np.random.default_rng([seed, number, _STREAM])
    sizes = np.exp(generator.normal(0, _FINGER_SPREAD, len(FINGERS) + 1)).clip(0.85, 1.15)
    changes = {name: float(np.clip(generator.normal(0, spread), -1, 1)) for name, spread in _CHANGES.items()}
    fan = float(np.clip(generator.normal(0, _FAN_SPREAD), -_FAN_LIMIT, _FAN_LIMIT))
    return {
        "seed": seed,
        "individual": number,
        "side": sides if sides != "both" else ("left", "right")[number % 2],
        "body": draw_build(seed, number),
        "changes": {name: round(amount, 4) for name, amount in changes.items()},
        "fingers": {str(finger): round(float(size), 4) for finger, size in enumerate(sizes, 1)},
        "fan": round(fan, 3),
    }
