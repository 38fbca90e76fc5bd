"""The curves of a training, for TensorBoard."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

# Steps whose mean makes a point of a curve.
_STEPS_PER_POINT = 10


class TrainingLog:
    """Writes curves below a run's folder. On resuming, points after the last checkpoint are removed.

    Args:
        folder: of the run.
        terms: names of the losses.
        step: after which points are removed.
    """

    def __init__(self, folder: Path, terms: Sequence[str], step: int) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self.terms = tuple(terms)
        self._writer = SummaryWriter(str(folder), purge_step=step + 1)
        self._sums: Tensor | None = None
        self._count = 0

    def step(self, step: int, losses: Tensor, gradient_norm: Tensor, learning_rate: float) -> None:
        """Add one step: losses (p, terms) of its pairs, the norm of their mean gradient, and the learning rate."""
        values = torch.cat([losses.mean(dim=0), gradient_norm[None]])
        self._sums = values if self._sums is None else self._sums + values
        self._count += 1
        if self._count == _STEPS_PER_POINT:
            means = (self._sums / self._count).tolist()
            names = (*(f"loss/{term}" for term in self.terms), "gradient norm")
            self.scalars(step, {**dict(zip(names, means, strict=True)), "learning rate": learning_rate})
            self._sums, self._count = None, 0

    def scalars(self, step: int, values: dict[str, float]) -> None:
        """Add one point to each of several curves."""
        for name, value in values.items():
            self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        """Write what is still waiting."""
        self._writer.close()
