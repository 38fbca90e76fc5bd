"""The body model of ``homolog synth people`` as a model that can be fitted."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from homolog.fitting.articulated import Pose
from homolog.shapes import Shape
from homolog.synthesis import BodyModel
from homolog.synthesis.builds import PARAMETERS
from homolog.synthesis.joints import RANGES, bone_rotations

# By the beginning of a bone's name.
_FIRM = {"finger": 30.0, "toe": 100.0}


class PeopleModel:
    """People of any age, sex and build, by six parameters, whose bones may turn in any way.

    The bones that turn are those that poses of ``homolog synth people`` turn. Faces stay as they are.

    Args:
        model: the body model; made anew by default, which takes minutes on its first use on a machine.

    Raises:
        MissingExtraError: if anny is not installed.
    """

    name = "people"
    parameters = PARAMETERS

    def __init__(self, model: BodyModel | None = None) -> None:
        self._model = BodyModel() if model is None else model
        self.bones, self.parents = self._model.bones, self._model.parents

    @cached_property
    def turning(self) -> Int[np.ndarray, " k"]:
        """The bones that are turned in fitting."""
        moving = bone_rotations(dict.fromkeys(RANGES, 0.0), self._model.skeleton)
        return np.array([number for number, bone in enumerate(self.bones) if bone in moving])

    @cached_property
    def firmness(self) -> Float[np.ndarray, " k"]:
        """How much stiffer than others each bone that turns is: maps confuse fingers, and toes."""
        names = [self.bones[number] for number in self.turning]
        return np.array([next((f for start, f in _FIRM.items() if name.startswith(start)), 1.0) for name in names])

    @cached_property
    def template(self) -> Shape:
        """The closed surface of all bodies: the mean one in the rest pose."""
        rest = self._model.template.rest
        return Shape(rest.vertices, rest.faces, name=self.name)

    @cached_property
    def shares(self) -> Float[np.ndarray, "n b"]:
        """The share of each bone in moving each point of the template."""
        return self._model.template.at_vertices(self._model.skinning_weights)

    def pose(
        self,
        build: Float[np.ndarray, " p"],
        rotations: Float[np.ndarray, "b 3 3"],
        rows: Int[np.ndarray, " r"] | None = None,
    ) -> Pose:
        """The template for body parameters and rotations of the bones, or some of its points.

        The centres of the template's closed holes are the means of their rims, as they are in synthetic bodies.
        """
        body = self._model.skinned(build[None], rotations)
        rest, shares, transforms = self._model.template.at_vertices(body.rest[0]), self.shares, body.transforms[0]
        if rows is not None:
            rest, shares = rest[rows], shares[rows]
        carried = (rest @ transforms[:, :3, :3].transpose(0, 2, 1)).transpose(1, 0, 2) + transforms[:, :3, 3]
        carried *= shares[:, :, None]
        return Pose(carried.sum(axis=1), carried, body.heads[0], body.turns[0])

    def points(
        self, builds: Float[np.ndarray, "q p"], rotations: Float[np.ndarray, "b 3 3"]
    ) -> Float[np.ndarray, "q n 3"]:
        """The template for several shapes in one pose."""
        bodies = self._model.skinned(builds, rotations).vertices
        return np.stack([self._model.template.at_vertices(vertices) for vertices in bodies])
