"""Which pairs each step trains on, by the recipe's seed and the step alone: a resumed run sees the same ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homolog.datasets import Pair
from homolog.training.clouds import cloud_variants
from homolog.training.data import TrainingSet
from homolog.training.recipe import Recipe

# What tells the choices at random from one another that are made with the recipe's seed.
_ORDER, _CHOICE, _WATCHED = 2, 3, 4


@dataclass(frozen=True)
class Member:
    """A shape as one step uses it: its name, and the numbers of its cloud variant and of its subset of points."""

    name: str
    variant: int
    subset: int


@dataclass(frozen=True)
class Draw:
    """A pair of shapes, and the seed of its augmentation and dropout."""

    x: Member
    y: Member
    seed: int

    def __str__(self) -> str:
        return f"{self.x.name} - {self.y.name}"


class Plan:
    """The pairs of every step.

    Shapes come in rounds, each in a new order: in a round every shape is once the first and once the second of a pair,
    or, where pairs are listed, every pair comes once.
    """

    def __init__(self, shapes: TrainingSet, recipe: Recipe) -> None:
        self._shapes, self._recipe = shapes, recipe
        self._n_variants = len(cloud_variants(recipe.clouds))

    def draws(self, step: int) -> tuple[Draw, ...]:
        """The pairs of a step; steps count from 0."""
        number = self._recipe.training.pairs_per_step
        places = range(step * number, (step + 1) * number)
        return tuple(self._draw(self._pair(place), _CHOICE, place) for place in places)

    def held_out(self) -> tuple[Draw, ...]:
        """The pairs to validate on, always with the same variants and subsets."""
        return tuple(self._draw(pair, _WATCHED, place) for place, pair in enumerate(self._shapes.held_out))

    def _pair(self, place: int) -> Pair:
        names, pairs = self._shapes.names, self._shapes.pairs
        n = len(pairs) or len(names)
        number, place = divmod(place, n)
        random = np.random.default_rng([self._recipe.seed, _ORDER, number])
        order = random.permutation(n)
        if pairs:
            return pairs[order[place]]
        shift = int(random.integers(1, n))
        return names[order[place]], names[order[(place + shift) % n]]

    def _draw(self, pair: Pair, purpose: int, place: int) -> Draw:
        random = np.random.default_rng([self._recipe.seed, purpose, place])
        x, y = (self._member(name, random) for name in pair)
        return Draw(x, y, int(random.integers(2**63)))

    def _member(self, name: str, random: np.random.Generator) -> Member:
        variant, subset = random.integers([self._n_variants, self._recipe.samples.choices])
        return Member(name, int(variant), int(subset))
