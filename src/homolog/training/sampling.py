"""Which pairs each step trains on, by the recipe's seed and the step alone: a resumed run sees the same ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homolog.datasets import Pair
from homolog.training.clouds import cloud_variants
from homolog.training.data import TrainingSet
from homolog.training.settings import Recipe

# What tells the choices at random from one another that are made with the recipe's seed.
_ORDER, _CHOICE, _HELD_OUT = 2, 3, 4


@dataclass(frozen=True)
class SampledShape:
    """A shape as one step uses it: its name, and the numbers of its cloud variant and of its subset of points."""

    name: str
    variant: int
    subset: int


@dataclass(frozen=True)
class SampledPair:
    """A pair of shapes, and the seed of its augmentation and dropout."""

    x: SampledShape
    y: SampledShape
    seed: int

    def __str__(self) -> str:
        return f"{self.x.name} - {self.y.name}"


class PairSampler:
    """The pairs of every step.

    Shapes come in rounds, each in a new order: in a round every shape is once the first and once the second of a pair,
    or, where pairs are listed, every pair comes once.
    """

    def __init__(self, shapes: TrainingSet, recipe: Recipe) -> None:
        self._shapes, self._seed, self._pairs_per_step = shapes, recipe.seed, recipe.training.pairs_per_step
        self._choices = len(cloud_variants(recipe.clouds)), recipe.samples.choices

    def of_step(self, step: int) -> tuple[SampledPair, ...]:
        """The pairs of a step; steps count from 0."""
        numbers = range(step * self._pairs_per_step, (step + 1) * self._pairs_per_step)
        return tuple(self._sampled(self._pair(number), _CHOICE, number) for number in numbers)

    def held_out(self) -> tuple[SampledPair, ...]:
        """The pairs to validate on, always with the same variants and subsets."""
        return tuple(self._sampled(pair, _HELD_OUT, number) for number, pair in enumerate(self._shapes.held_out))

    def _pair(self, number: int) -> Pair:
        names, pairs = self._shapes.names, self._shapes.pairs
        n = len(pairs) or len(names)
        turn, place = divmod(number, n)
        random = np.random.default_rng([self._seed, _ORDER, turn])
        order = random.permutation(n)
        if pairs:
            return pairs[order[place]]
        shift = int(random.integers(1, n))
        return names[order[place]], names[order[(place + shift) % n]]

    def _sampled(self, pair: Pair, purpose: int, number: int) -> SampledPair:
        random = np.random.default_rng([self._seed, purpose, number])
        x, y = (SampledShape(name, *map(int, random.integers(self._choices))) for name in pair)
        return SampledPair(x, y, int(random.integers(2**63)))
