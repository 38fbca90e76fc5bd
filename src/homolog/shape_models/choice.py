"""One choice of features, or of a method without any, for all shapes of a collection. New here."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from homolog.core.errors import HomologError
from homolog.core.progress import Progress, ignore
from homolog.matching import Matcher
from homolog.pairs import Candidate, PreprocessedShape
from homolog.shape_models.settings import ShapeModelSettings
from homolog.shape_models.subjects import Subject
from homolog.shapes import Shape, read_shape

# So many shapes tell what all of them are.
_MOST = 8


def choice_for_all(
    template: Shape,
    subjects: Sequence[Subject],
    matcher: Matcher,
    settings: ShapeModelSettings | None = None,
    *,
    progress: Progress = ignore,
) -> tuple[Candidate, ...]:
    """Which features, or method without any, explain a collection best: what came into question, the best first.

    Asked are the pairs of the template with up to eight of the shapes, spread over their list; the median over these
    decides. Shapes that cannot be used are passed over.

    Args:
        template: as it was read.
        subjects: the shapes.
        matcher: that has a choice.
        settings: of the registration.
        progress: called with the number of shapes that were looked at, their total and the current one's name.

    Returns:
        The candidates; empty where the matcher has no choice, or no shape can be used.
    """
    settings = settings or ShapeModelSettings()
    if not matcher.feature_choice.is_open:
        return ()
    pairs = pairs_with(template, subjects, matcher, settings, most=_MOST, progress=progress)
    return matcher.feature_choice.candidates(pairs, settings.pair_options()) if pairs else ()


def pairs_with(
    template: Shape,
    subjects: Sequence[Subject],
    matcher: Matcher,
    settings: ShapeModelSettings,
    *,
    most: int,
    progress: Progress = ignore,
) -> list[tuple[PreprocessedShape, PreprocessedShape]]:
    """The template with up to so many of the shapes, spread over their list; those that cannot be used are left out."""
    base = matcher.preprocess(
        template,
        up=settings.template_up,
        as_cloud=settings.template_as_cloud,
        orient=settings.orient,
        clutter="keep",
        proxy=settings.proxy,
        mask=settings.template_mask,
        label="template",
    )
    asked = [subjects[number] for number in np.unique(np.linspace(0, len(subjects) - 1, most).astype(int))]
    shapes: list[PreprocessedShape] = []
    for number, subject in enumerate(asked):
        progress(number, len(asked), f"looking at {subject.name}")
        with suppress(HomologError):  # it is reported once the shape is registered
            shapes.append(
                matcher.preprocess(
                    read_shape(subject.file),
                    up=settings.shapes_up,
                    as_cloud=settings.shapes_as_cloud,
                    orient=settings.orient,
                    clutter=settings.clutter,
                    proxy=settings.proxy,
                    mask=subject.mask(),
                )
            )
    return [(base, shape) for shape in shapes]
