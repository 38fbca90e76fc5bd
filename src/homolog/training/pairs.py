"""Pairs of shapes as steps train on them: partial ones at one scale, and with what losses ask for."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.datasets import Pair
from homolog.geometry import Basis
from homolog.maps import registered_positions
from homolog.training.losses import Loss
from homolog.training.quantities import TrainingShape
from homolog.training.sampling import SampledPair, SampledShape
from homolog.training.settings import PartialSettings
from homolog.training.store import ShapeStore

# Pairs of which the registration is kept: of 6,000 points they take 150 MB.
_MOST_REGISTRATIONS = 1000


@dataclass(frozen=True, eq=False)
class TrainingPair:
    """A pair as a step trains on it.

    Args:
        sampled: what was drawn.
        x: one shape.
        y: the other.
        registration_targets: where y's samples lie once its cloud is registered to x's, both with all of their points
            (n_y, 3); None where no loss asks for it.
    """

    sampled: SampledPair
    x: TrainingShape
    y: TrainingShape
    registration_targets: Float[Tensor, "n_y 3"] | None = None


class PairLoader:
    """Makes pairs of shapes from a store. Safe to use from several threads.

    Args:
        store: of the shapes.
        partial: of the recipe, where one shape of each pair is partial.
        losses: which the pairs are for.
    """

    def __init__(self, store: ShapeStore, partial: PartialSettings | None, losses: Iterable[Loss]) -> None:
        self._store, self._partial = store, partial
        self._pre_aligned = partial is not None and bool(partial.pre_aligned)
        self._registers = partial is None and any("registration_targets" in loss.requires for loss in losses)
        self._registered = lru_cache(maxsize=_MOST_REGISTRATIONS)(self._register)

    def pairs(self, sampled: Sequence[SampledPair]) -> list[TrainingPair]:
        """The pairs that were drawn; partial ones with the full shape first, and both at its scale."""
        return [self._full_first(pair) if self._partial else self._any(pair) for pair in sampled]

    def full_first(self, pair: Pair) -> Pair:
        """A pair of shapes in the order that a step takes them in: where one may be partial, the larger one first."""
        if self._partial is None:
            return pair
        first, second = (self._store.frame(name).scale for name in pair)
        return pair if first >= second else (pair[1], pair[0])

    def _any(self, sampled: SampledPair) -> TrainingPair:
        x, y = self._store.shape(sampled.x), self._store.shape(sampled.y)
        targets = None
        if self._registers and not (x.cloud_is_partial or y.cloud_is_partial):
            targets = self._registration_targets(sampled.x, sampled.y)
        return TrainingPair(sampled, x, y, targets)

    def _full_first(self, sampled: SampledPair) -> TrainingPair:
        if self.full_first((sampled.x.name, sampled.y.name))[0] != sampled.x.name:
            sampled = replace(sampled, x=sampled.y, y=sampled.x)
        x, y = (self._store.shape(shape, cloud_on_mesh=self._pre_aligned) for shape in (sampled.x, sampled.y))
        full, partial = self._store.frame(sampled.x.name), self._store.frame(sampled.y.name)
        offset = torch.from_numpy(full.to_unit(partial.centre)).float().to(self._store.device)

        def at_full_scale(basis: Basis) -> Basis:
            basis = basis.scaled(partial.scale / full.scale)
            return basis.moved(offset) if self._pre_aligned else basis

        y = replace(y, mesh=at_full_scale(y.mesh), cloud=at_full_scale(y.cloud))
        if y.template_eigenvectors is not None:
            y = replace(y, template_eigenvectors=y.template_eigenvectors * (full.scale / partial.scale))
        return TrainingPair(sampled, x, y)

    def _registration_targets(self, x: SampledShape, y: SampledShape) -> Float[Tensor, "n_y 3"]:
        first, second = sorted([(x.name, x.variant), (y.name, y.variant)])
        on_second, on_first = self._registered(first, second)
        on_x = on_first if first == (x.name, x.variant) else on_second
        indices = self._store.samples(y.name, y.variant).indices[y.subset]
        return on_x[torch.from_numpy(indices).to(on_x.device)]

    def _register(
        self, first: tuple[str, int], second: tuple[str, int]
    ) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "m 3"]]:
        return registered_positions(self._store.samples(*first).points, self._store.samples(*second).points)
