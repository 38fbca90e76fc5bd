"""Synthetic heads, cut from the body model at the neck: faces of any age, each with several expressions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from homolog.core.versions import version_of
from homolog.geometry.surface import Surface
from homolog.synthesis.bodies import POSE_SHARES, POSES_OF_ONE, Character
from homolog.synthesis.body_model import ASSETS, FACE_ASSET, BodyModel
from homolog.synthesis.builds import draw_build
from homolog.synthesis.expressions import ACTIONS, AT_REST, FAMILIES, draw_expression, turns
from homolog.synthesis.poses import scaled_pose
from homolog.synthesis.template import Template

# A version, increased whenever the same settings give other heads.
_MAKING = 1
# The streams of random numbers of individuals, apart from those of bodies.
_STREAM = 2
# With these words begin the names of anny's local changes of heads; "l-" and "r-" before them name a side.
_PLACES = ("cheek", "chin", "ear", "eyebrows", "eye", "forehead", "head", "mouth", "neck", "nose")
# Standard deviations of their amounts, and of the difference of the two sides.
_SPREAD, _UNEQUAL = 0.25, 0.04
# Those with a deviation of their own: these fold lids and lips, or move what the cut lies at.
_SPREADS = {"neck": 0.15, "eye": 0.2, "mouth": 0.25}


class Heads:
    """Heads and necks of people of any age and build, with many expressions: upright (+y), facing +z.

    Args:
        model: of the human body, with the details of faces.
    """

    name = "heads"
    stem = "head"
    assets = (*ASSETS, FACE_ASSET)

    def __init__(self, model: BodyModel) -> None:
        self._model = model

    @property
    def making(self) -> Mapping[str, Any]:
        """The versions of the way in which heads are made, and of the body model."""
        return {"kind": self.name, "way": _MAKING, "anny": version_of("anny")}

    @cached_property
    def template(self) -> Template:
        """The closed surface that all heads share: the mean head, without an expression."""
        part = self._model.part("head")
        return replace(part, rest=_centred(part, part.rest))

    def surface(self, character: Character) -> Surface:
        """The template in the shape and with the expression of a head."""
        build, angles = character.build, character.angles
        actions = {name: angles[name] for name in ACTIONS if angles[name]}
        vertices = self._model.vertices(build["body"], turns(angles), build["changes"], actions)
        return _centred(self.template, self.template.surface(vertices))

    def characters(self, seed: int, index: int, generator: np.random.Generator) -> Iterator[Character]:
        """Ever weaker expressions of ever new samples of the individual's next family of them."""
        number, families = index // POSES_OF_ONE, tuple(FAMILIES)
        build = self._draw_individual(seed, number)
        family = families[(seed + 5 * index + number // len(families)) % len(families)]
        while True:
            drawn = draw_expression(family, generator)
            for share in POSE_SHARES:
                yield Character(build, family, scaled_pose(drawn, share, AT_REST), share, index % 2 == 1)
            build = {**build, "changes": {name: round(0.85 * amount, 4) for name, amount in build["changes"].items()}}

    def _draw_individual(self, seed: int, number: int) -> dict[str, Any]:
        """The parameters of an individual's head; both sides are nearly alike."""
        generator = np.random.default_rng([seed, number, _STREAM])
        changes: dict[str, float] = {}
        for name in self._model.local_changes:
            whole = name.removeprefix("l-").removeprefix("r-").removeprefix("measure-")
            place = whole.partition("-")[0]
            if place not in _PLACES:
                continue
            if name.startswith("r-"):
                amount = changes[f"l-{whole}"] + generator.normal(0, _UNEQUAL)
            else:
                amount = generator.normal(0, _SPREADS.get(place, _SPREAD))
            changes[name] = round(float(np.clip(amount, -1, 1)), 4)
        return {"seed": seed, "individual": number, "body": draw_build(seed, number), "changes": changes}


def _centred(template: Template, surface: Surface) -> Surface:
    """The surface with the middle of its cut in the origin."""
    return Surface(
        surface.vertices - surface.vertices[np.unique(template.faces[template.lid])].mean(axis=0), surface.faces
    )
