"""What a user should know of a match: units that differ, low confidence, maps that tear."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from homolog.core.errors import HomologError, ShapeError
from homolog.geometry import surface_area
from homolog.matching.result import Match
from homolog.pairs import Pair, WarningSettings

# Shares of the full shape's area that a partial shape may have. One of more than all can only be an estimate that is
# off, by a few per cent between clouds; less than a hundredth shows nothing that could be recognised.
_LARGEST_SHARE = 1.2
_SMALLEST_SHARE = 0.01


def unit_warnings(pair: Pair) -> tuple[str, ...]:
    """Say if the area of a partial shape cannot be that of a part of the full one.

    Returns:
        At most one line, that names both areas and what to give.
    """
    if not pair.is_partial:
        return ()
    partial, full = pair.y, pair.x.operators.scale
    own = partial.repaired.report.area  # of the faces, also where they are not used otherwise
    area = (full / partial.operators.scale) ** 2 * (surface_area(partial.repaired.shape) if own is None else own)
    full_area = full**2
    if _SMALLEST_SHARE <= area / full_area <= _LARGEST_SHARE:
        return ()
    exchanged = ", or name the other shape as the partial one" if area > full_area else ""
    return (
        f"the partial shape's area is {area:.3g}, the full one's {full_area:.3g}: their units seem to differ; "
        "give partial_scale, by how much the partial shape's lengths are to be multiplied"
        f"{exchanged}",
    )


def orientation_warnings(match: Match) -> tuple[str, ...]:
    """Say if another way round of the shapes fits nearly as well as the one that was taken."""
    found = match.report.get("orientation") or {}
    if not found.get("ambiguous"):
        return ()
    return (
        "which way round the shapes are is ambiguous: another rotation leads to another map, and fits nearly as well; "
        "look at both (--alternatives 2), or trust the files (--orient given)",
    )


def low_confidence_warnings(match: Match, settings: WarningSettings | None = None) -> tuple[str, ...]:
    """A warning if the maps contradict themselves nearly everywhere, or tear the shapes to pieces.

    Points without a counterpart do not count.
    """
    settings = settings or WarningSettings()
    sides = (match.source_to_target, match.source_confidence), (match.target_to_source, match.target_confidence)
    means = [float(confidence[indices >= 0].mean()) for indices, confidence in sides if (indices >= 0).any()]
    mean = min(means, default=0.0)
    if mean < settings.least_confidence:
        return (
            f"the match is doubtful: its mean confidence is {mean:.2f}; are the shapes of one kind, and dense enough?",
        )
    energy = 0.0 if match.quality is None else match.quality.mean.dirichlet_energy
    if energy > settings.most_dirichlet_energy:
        return (
            f"the match is doubtful: it tears the shapes (Dirichlet energy {energy:.0f}, of good maps 1 to 3); are "
            "they of one kind, which any weights must know?",
        )
    return ()


@contextmanager
def blaming(warnings: Sequence[str]) -> Iterator[None]:
    """Give what there is a warning of as the reason of a failure: of units that differ, other errors would mislead."""
    try:
        yield
    except HomologError:
        if warnings:
            raise ShapeError(warnings[0]) from None
        raise
