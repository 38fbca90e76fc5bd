"""A network of a collection's own: weights that are fine-tuned on the template with all shapes at once. New here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch

from homolog.core.progress import Progress, ignore
from homolog.features import NetworkFeatures, save_weights
from homolog.matching import Matcher
from homolog.shape_models.choice import pairs_with
from homolog.shape_models.folder import ShapeModelFolder
from homolog.shape_models.settings import ShapeModelSettings
from homolog.shape_models.subjects import Subject
from homolog.shapes import Shape
from homolog.training import AdaptationSettings, adapt_to_pairs

# More shapes of one kind tell little more, and take memory.
_MOST = 50


def not_adapted_warnings(folder: ShapeModelFolder, settings: ShapeModelSettings) -> tuple[str, ...]:
    """Say if weights were to be adapted to a collection that is matched best without any."""
    if not settings.adapt or not folder.choice() or folder.weights() is not None:
        return ()
    return ("nothing was adapted: these shapes are matched best by a method without weights",)


def adapted_weights(
    template: Shape,
    subjects: Sequence[Subject],
    folder: ShapeModelFolder,
    matcher: Matcher,
    settings: ShapeModelSettings,
    *,
    progress: Progress = ignore,
) -> Path | None:
    """The file of the weights that were adapted to a collection; they are made once, and kept in its folder.

    Args:
        template: as it was read.
        subjects: the shapes, of which up to fifty are trained on, spread over their list.
        folder: of the collection.
        matcher: with the features that were chosen for all shapes.
        settings: with the number of steps.
        progress: called with the number of steps, their total and what is done.

    Returns:
        None where a method without a network was chosen for all shapes, or no shape can be used.

    Raises:
        ArgumentError: if there is no network, and nothing was chosen.
        TrainingError: if a loss is not finite.
    """
    file = folder.weights()
    if file is not None:
        return file
    if folder.choice() and not isinstance(matcher.extractor, NetworkFeatures):
        return None
    pairs = [
        matcher.paired(*both, settings.pair_options())
        for both in pairs_with(template, subjects, matcher, settings, most=_MOST, progress=progress)
    ]
    if not pairs:
        return None
    steps = iter(range(settings.adapt))
    adapted = adapt_to_pairs(
        matcher,
        pairs,
        AdaptationSettings(steps=settings.adapt),
        listener=lambda what: progress(next(steps), settings.adapt, what),
    ).to(torch.device("cpu"))
    info = replace(adapted.info, name=f"{adapted.info.name}, adapted", sha256="")
    return folder.keep_weights(lambda path: save_weights(path, adapted.network, info, orienter=adapted.orienter))
