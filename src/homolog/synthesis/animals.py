"""Synthetic animals with four legs: species and mixtures of species, each individual in several poses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float

from homolog.geometry.surface import Surface
from homolog.synthesis.animal_forms import Individual, individual
from homolog.synthesis.animal_joints import bone_turns
from homolog.synthesis.animal_parameters import FACTORS, mixed
from homolog.synthesis.animal_poses import FAMILIES, STANDING, draw_pose
from homolog.synthesis.bodies import MOST_CROSSING, POSE_SHARES, POSES_OF_ONE, Character
from homolog.synthesis.poses import scaled_pose
from homolog.synthesis.quadruped import Quadruped
from homolog.synthesis.self_intersections import self_intersection_share
from homolog.synthesis.species import SPECIES
from homolog.synthesis.template import Template

ASSETS = (
    {
        "asset": "skin, bones and joint ranges of the dog of dm_control, adapted",
        "package": "dm_control",
        "version": "1.0.50",
        "licence": "Apache-2.0",
        "source": "https://github.com/google-deepmind/dm_control",
    },
    {
        "asset": "control grids of bodies and heads of infinigen's animals",
        "package": "infinigen",
        "version": "1.15.5",
        "licence": "BSD-3-Clause",
        "source": "https://github.com/princeton-vl/infinigen",
    },
)
"""All assets of the animals, with their licences."""

# A version, increased whenever the same settings give other animals.
_MAKING = 1
# The streams of random numbers of individuals, apart from those of bodies.
_STREAM = 1
# The share of mixtures of two species, and the range of the lesser share in them.
_MIXTURES, _LESSER = 0.5, (0.15, 0.5)
# Standard deviations of the logarithms of factors: of each one alone, of all legs' lengths, of all girths.
_SPREAD, _LEGS_SPREAD, _GIRTH_SPREAD = 0.06, 0.08, 0.09
_LEG_LENGTHS = tuple(f"{bone}_length" for bone in ("lower_arm", "hand", "lower_leg", "foot", "upper_arm", "upper_leg"))
_STANCE_SPREAD, _EAR_SPREAD = 2.5, 8.0
# One in so many is young: a large head with a short snout, on a small body.
_YOUNG = 6
_YOUNG_FACTORS = {
    "size": 0.5,
    "head": 1.25,
    "snout_length": 0.85,
    "paw": 1.15,
    "neck_length": 0.9,
    "chest_length": 0.92,
}
# Bumps of the skin: their number, standard deviation and range of widths in metres of the dog.
_BUMPS, _BUMP_HEIGHT, _BUMP_WIDTHS = 14, 0.006, (0.04, 0.12)
_BUMP_RANGE = (-0.012, 0.016)
# Parts without bumps, which would tie them off; thighs and upper arms have half of them.
_SLENDER = ("lower_arm", "hand", "finger", "lower_leg", "foot", "toe", "ear", "skull", "Ca_")
# An individual that passes through itself while it stands by more than this share is drawn anew, and nearer to the dog,
# which does not; by this factor each time.
_MOST_CROSSING = MOST_CROSSING / 2
_TAMER = 0.9


class Animals:
    """Animals with four legs, of two dozen species and of mixtures of them, in many poses."""

    name = "animals"
    stem = "animal"
    assets = ASSETS

    @property
    def making(self) -> Mapping[str, Any]:
        """The version of the way in which animals are made; a folder of people has another ``kind``, none."""
        return {"kind": self.name, "way": _MAKING}

    @cached_property
    def template(self) -> Template:
        """The closed surface that all animals share: a dog that stands."""
        animal = Quadruped.load()
        rest = animal.surface
        return Template(np.arange(len(rest.vertices)), (), rest.faces, animal.detail(), rest)

    def surface(self, character: Character) -> Surface:
        """The template in the shape and pose of an animal."""
        build = character.build
        one = _individual(build["seed"], build["individual"])[1]
        animal = Quadruped.load()
        vertices, _, _ = animal.followed(one.vertices, one.pivots, turns=bone_turns(character.angles))
        vertices[:, 1] -= vertices[:, 1].min()
        return Surface(vertices, animal.surface.faces)

    def characters(self, seed: int, index: int, generator: np.random.Generator) -> Iterator[Character]:
        """Ever smaller poses of ever new samples of the individual's next family of poses."""
        number, families = index // POSES_OF_ONE, tuple(FAMILIES)
        form, _ = _individual(seed, number)
        family = families[(seed + 5 * index + number // len(families)) % len(families)]
        while True:
            pose = draw_pose(family, generator)
            for share in POSE_SHARES:
                yield Character(form, family, scaled_pose(pose, share, STANDING), share)


@lru_cache(maxsize=4)
def _individual(seed: int, number: int) -> tuple[dict[str, Any], Individual]:
    """The description of an individual and its shape, without limbs that pass through each other."""
    generator = np.random.default_rng([seed, number, _STREAM])
    shares, wild = _draw_species(seed, number, generator), 1.0
    while True:
        drawn = _varied(mixed([SPECIES[name] for name in shares], list(shares.values())), generator)
        form = {name: round(value, 4) for name, value in mixed([drawn, {}], [wild, 1.0 - wild]).items()}
        one = individual(form, wild * _draw_bumps(generator))
        surface = Surface(one.vertices, Quadruped.load().surface.faces)
        if self_intersection_share(surface, by_area=True) < _MOST_CROSSING:
            return {"seed": seed, "individual": number, "species": shares, "form": form}, one
        wild *= _TAMER


def _draw_species(seed: int, number: int, generator: np.random.Generator) -> dict[str, float]:
    """The shares of species; each is the first one of as many individuals as the others."""
    names = tuple(SPECIES)
    turn, place = divmod(number, len(names))
    first = names[int(np.random.default_rng([seed, turn]).permutation(len(names))[place])]
    if generator.random() >= _MIXTURES:
        return {first: 1.0}
    second = names[int(generator.integers(len(names)))]
    lesser = round(float(generator.uniform(*_LESSER)), 3)
    return {first: 1.0} if second == first else {first: round(1.0 - lesser, 3), second: lesser}


def _varied(form: Mapping[str, float], generator: np.random.Generator) -> dict[str, float]:
    """A form with the variation of individuals."""
    found = dict(form)
    legs, girth = generator.normal(0, [_LEGS_SPREAD, _GIRTH_SPREAD])
    for name in FACTORS:
        of_all = girth if name.endswith(("girth", "width", "depth")) else 0.0
        of_all += legs if name in _LEG_LENGTHS else 0.0
        found[name] *= float(np.exp(of_all + generator.normal(0, _SPREAD)))
    for name in found:
        if name.startswith("stance"):
            found[name] += float(generator.normal(0, _STANCE_SPREAD))
    found["ear_droop"] += float(generator.normal(0, _EAR_SPREAD))
    if generator.integers(_YOUNG) == 0:
        found = {name: value * _YOUNG_FACTORS.get(name, 1.0) for name, value in found.items()}
    return found


def _draw_bumps(generator: np.random.Generator) -> Float[np.ndarray, " n"]:
    """Smooth and symmetric bumps of the skin: fat, muscles and bones that individuals have."""
    rest = Quadruped.load().surface.vertices
    folded = np.column_stack([np.abs(rest[:, 0]), rest[:, 1:]])
    middles = folded[generator.integers(len(rest), size=_BUMPS)]
    widths = generator.uniform(*_BUMP_WIDTHS, size=_BUMPS)
    heights = generator.normal(0, _BUMP_HEIGHT, size=_BUMPS)
    bumps = np.zeros(len(rest))
    for middle, width, height in zip(middles, widths, heights, strict=True):
        bumps += height * np.exp(-(np.linalg.norm(folded - middle, axis=1) ** 2) / width**2)
    slender, limbs = Quadruped.load().share(*_SLENDER), Quadruped.load().share("upper_arm", "upper_leg")
    return np.asarray(bumps.clip(*_BUMP_RANGE) * (1 - slender - limbs / 2).clip(0, 1))
