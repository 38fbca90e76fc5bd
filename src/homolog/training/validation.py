"""Validation during a training: the losses of held-out pairs, and their geodesic errors."""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from homolog.core.errors import DataError
from homolog.core.files import atomic_path, open_text
from homolog.datasets import Pair, ShapeFolder
from homolog.evaluation import Modalities, Protocol, evaluate
from homolog.features import DiffusionNet, NetworkInput
from homolog.matching import Matcher
from homolog.shapes import Shape
from homolog.training.losses import Loss
from homolog.training.objective import pair_losses
from homolog.training.pairs import TrainingPair
from homolog.training.settings import LossSettings, PartialSettings

_log = logging.getLogger(__name__)

_SCORED: tuple[Modalities, ...] = ("mesh", "cloud")


@dataclass(frozen=True)
class _Turned(ShapeFolder):
    """A dataset whose shapes are turned as they are read."""

    rotations: Mapping[str, Float[np.ndarray, "3 3"]] = field(default_factory=dict)

    def shape(self, name: str) -> Shape:
        shape, rotation = super().shape(name), self.rotations.get(name)
        return shape if rotation is None else replace(shape, points=shape.points @ rotation.T)


@torch.no_grad()
def validation_losses(
    network: DiffusionNet,
    pairs: Sequence[TrainingPair],
    settings: LossSettings,
    losses: Sequence[Loss],
    *,
    partial: bool,
    features_from: NetworkInput = "xyz",
) -> dict[str, float]:
    """Mean of each loss over pairs, and of their total, for a network in evaluation mode, without augmentation."""
    sums: dict[str, float] = defaultdict(float)
    for pair in pairs:
        values = pair_losses(
            network,
            pair.x,
            pair.y,
            settings=settings,
            losses=losses,
            partial=partial,
            registration_targets=pair.registration_targets,
            features_from=features_from,
        )
        for name, value in values.items():
            sums[name] += float(value) / len(pairs)
    return dict(sums)


def scores(
    matcher: Matcher,
    folder: ShapeFolder,
    pairs: Sequence[Pair],
    listed: Path,
    *,
    partial: PartialSettings | None = None,
    rotations: Mapping[str, Float[np.ndarray, "3 3"]] | None = None,
) -> dict[str, float]:
    """Mean geodesic errors x100 of a few pairs at full resolution, as meshes and as clouds.

    Args:
        matcher: with the network to score.
        folder: with ground truth; if that is faulty there are no scores, and the log says why.
        pairs: to match.
        listed: file to write the pairs to.
        partial: of the recipe; the second shape of each pair is partial then.
        rotations: by which shapes are turned first, each (3, 3), by name, as those are that were trained on.
    """
    folder = _Turned(**vars(folder), rotations=rotations) if rotations else folder
    with atomic_path(listed) as temporary, open_text(temporary) as file:
        file.writelines(f"{source},{target}\n" for source, target in pairs)
    pre_aligned = partial is not None and bool(partial.pre_aligned)
    protocol = Protocol(pairs_file=str(listed), partial=partial is not None, pre_aligned=pre_aligned)
    try:
        found = {way: evaluate(matcher, folder, replace(protocol, modality=way)) for way in _SCORED}
    except DataError as error:
        _log.warning("no scores: %s", error)
        return {}
    return {way: evaluation.to_dict()["mean_geodesic_error"] for way, evaluation in found.items()}
