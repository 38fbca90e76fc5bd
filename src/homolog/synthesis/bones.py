"""Synthetic bones of one kind: samples of a statistical model of the bones of 26 people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy as np

from homolog.core.choices import Bone, Turn
from homolog.core.versions import version_of
from homolog.geometry.surface import Surface
from homolog.synthesis.bodies import POSE_SHARES, Character
from homolog.synthesis.bone_model import ASSETS, BoneModel
from homolog.synthesis.template import Template
from homolog.synthesis.turns import drawn_turn, turned

# A version, increased whenever the same settings give other bones.
_MAKING = 1
# No bone lies farther from the mean, in standard deviations along a mode.
_FARTHEST = 2.5


class Bones:
    """Bones of the left side, each of another person, in millimetres: +y up and facing +z before they are turned.

    Args:
        bone: which bone.
        turn: how they are turned: not at all, about the vertical, or any way round.
        model: of the bone; by default that of the package musculoskeletal-models.
    """

    name = "bones"
    assets = ASSETS

    def __init__(self, bone: Bone = "femur", turn: Turn = "any", *, model: BoneModel | None = None) -> None:
        self.stem, self._turn = str(bone), turn
        self._model = model or BoneModel.of(bone)

    @property
    def making(self) -> Mapping[str, Any]:
        """The versions of the way in which bones are made and of the model, the bone, and how they are turned."""
        model = version_of("musculoskeletal-models")
        return {"kind": self.name, "way": _MAKING, "model": model, "bone": self.stem, "turn": self._turn}

    @cached_property
    def template(self) -> Template:
        """The closed surface that all bones of the kind share: their mean."""
        return Template.of_closed(self._model.mean)

    def surface(self, character: Character) -> Surface:
        """The template in the shape of a bone, turned."""
        vertices = self._model.vertices(np.array(list(character.angles.values())))
        return Surface(turned(vertices, character.build["turn"]), self._model.mean.faces)

    def characters(self, seed: int, index: int, generator: np.random.Generator) -> Iterator[Character]:
        """Ever new samples of the model, each scaled towards the mean until it does not pass through itself."""
        build = {"seed": seed, "individual": index, "turn": drawn_turn(self._turn, generator)}
        while True:
            drawn = generator.normal(size=len(self._model.modes)).clip(-_FARTHEST, _FARTHEST)
            for share in POSE_SHARES:
                amounts = {f"mode {i}": round(float(share * amount), 4) for i, amount in enumerate(drawn, 1)}
                yield Character(build, self.stem, amounts, share)
