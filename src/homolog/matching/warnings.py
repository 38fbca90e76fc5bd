"""What a user should know of a match: parts that were not named, low confidence, maps that tear."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from homolog.core.errors import HomologError, ShapeError
from homolog.matching.extra_parts import extra_part_warnings
from homolog.matching.guidance import guidance_warnings
from homolog.matching.mirror import mirror_warnings
from homolog.matching.misfit import map_misfit
from homolog.matching.result import Match
from homolog.pairs import SIDES, Candidate, ChoiceSettings, Pair, WarningSettings
from homolog.shapes import Shape, face_vectors, half_edges, mesh_components

# Of 13 cuts of a body all but one have openings of 5 to 37 % of their area, and 13 views of 58 to 64 %; bodies with
# holes have 1 to 3 %. The 120 full shapes of FAUST, SCAPE and SMAL that were looked at are closed.
_LEAST_OPENNESS = 0.05
_OPENER = 3.0
# Maps of 14 cuts that were matched as full shapes had mean confidences up to 0.79; of heads with an open neck, 0.91.
_WHOLE_CONFIDENCE = 0.85
# A mesh is in pieces if there are many, of which the largest is less than half of it; crumbs do not count.
_MANY_PIECES = 5
_SMALL_PIECE = 0.01
_MOST_OF_IT = 0.5


def part_warnings(pair: Pair) -> tuple[str, ...]:
    """Say if one of two meshes that are matched as full shapes looks like a part of the other.

    Returns:
        At most one line, whatever the map. It is about surfaces that are open where the other one is closed, as a view
        or a cut is. Of clouds it cannot be told.
    """
    if pair.options.partial is not None:
        return ()
    openness = [_openness(side.repaired.shape) for side in (pair.source, pair.target)]
    for side, other, own, others in zip(SIDES, SIDES[::-1], openness, openness[::-1], strict=True):
        if own is not None and others is not None and own > _LEAST_OPENNESS and others < own / _OPENER:
            return (
                f"the {side} looks like a part of the {other}: its surface is open on one side, which the {other}'s is "
                f"not; if it is a part, give partial='{side}'",
            )
    return ()


def _openness(shape: Shape) -> float | None:
    """The area of the opening of a mesh, seen from where it is widest, over its surface's; 0 if it is closed.

    None for a cloud, for faces that do not run alike, and for loose pieces, which may each be open.
    """
    if shape.faces is None or _pieces(shape) >= _MANY_PIECES:
        return None
    sides = half_edges(shape.faces)
    if len(np.unique(sides, axis=0)) < len(sides):
        return None
    vectors = face_vectors(shape.points[shape.faces])
    return float(np.linalg.norm(vectors.sum(axis=0)) / np.linalg.norm(vectors, axis=1).sum())


def _pieces(shape: Shape) -> int:
    """How many loose pieces a mesh has, if the largest is less than most of it; 1 otherwise."""
    if shape.faces is None:
        return 1
    areas = mesh_components(shape.points, shape.faces)[1]
    largest = areas.max()
    return int((areas > _SMALL_PIECE * largest).sum()) if largest < _MOST_OF_IT * areas.sum() else 1


def _in_pieces(pair: Pair) -> str:
    """What to say of meshes of many loose pieces, between which neither features nor maps know any way."""
    counts = {side: _pieces(one.repaired.shape) for side, one in zip(SIDES, (pair.source, pair.target), strict=True)}
    many = {side: count for side, count in counts.items() if count >= _MANY_PIECES}
    if not many:
        return ""
    described = " and ".join(f"the {side} has {count} loose pieces" for side, count in many.items())
    which = "both" if len(many) == 2 else next(iter(many))
    return f"{described}; join them, or match their points alone: as_cloud='{which}'"


def match_warnings(pair: Pair, match: Match) -> tuple[str, ...]:
    """All that there is to warn of in a match, but for units that differ, which are told before.

    Args:
        pair: what was matched, turned as it was matched.
        match: of the two.
    """
    # Points of a whole find no counterparts on a part: where nearly all do, an opening is no cut.
    parts = part_warnings(pair) if _mean_confidence(match) < _WHOLE_CONFIDENCE else ()
    checks = (*guidance_warnings(pair), *parts, *orientation_warnings(match), *mirror_warnings(pair))
    checks = (*checks, *extra_part_warnings(match), *unknown_shape_warnings(pair, match))
    return (*checks, *low_confidence_warnings(match, pair.settings.warnings, pair=pair))


def orientation_warnings(match: Match) -> tuple[str, ...]:
    """Say if another way round of the shapes fits nearly as well as the one that was taken."""
    found = match.report.get("orientation") or {}
    if not found.get("ambiguous"):
        return ()
    return (
        "which way round the shapes are is ambiguous: another rotation leads to another map, and fits nearly as well; "
        "look at both (Matcher.alternatives), or trust the files (orient='given')",
    )


def unknown_shape_warnings(pair: Pair, match: Match) -> tuple[str, ...]:
    """Say if the features that were chosen know one of the shapes badly, or none do, and the best map is no good.

    Maps may be smooth and confident all the same.
    """
    best = next(iter(pair.choice), None)
    if best is None:
        return ()
    if pair.extractor is None or best.name != pair.extractor.info.name:
        return _bad_map_warnings(best, match, pair.settings.choice)
    return _little_known_warnings(best, pair.extractor.info.limit(pair.settings.choice.known_best))


def _bad_map_warnings(best: Candidate, match: Match, settings: ChoiceSettings) -> tuple[str, ...]:
    """Of a method without features. Where it was chosen without a look at maps, the match itself tells."""
    misfit = map_misfit(match, settings) if best.map_misfit is None else best.map_misfit
    if misfit <= settings.doubtful:
        return ()
    return (
        f"the match is doubtful: no weights know both shapes, and the best map, by {best.name!r}, has a misfit of "
        f"{misfit:.1f}, but hardly any right one above {settings.doubtful:g}; look at the map",
    )


def _little_known_warnings(best: Candidate, most: float) -> tuple[str, ...]:
    """Of features that know shapes up to a misfit."""
    if (best.misfit or 0.0) <= most:
        return ()
    return (
        f"no weights know both shapes: those that were chosen, {best.name!r}, have a misfit of {best.misfit:.2f}, "
        f"but at most {most:g} of shapes that they know; look at the map, and see whether both are of that kind",
    )


def low_confidence_warnings(
    match: Match, settings: WarningSettings | None = None, *, pair: Pair | None = None
) -> tuple[str, ...]:
    """A warning if the maps contradict themselves nearly everywhere, or tear the shapes to pieces.

    Points without a counterpart do not count.

    Args:
        match: of two shapes.
        settings: when it is doubtful.
        pair: what was matched, where the cause may be found.
    """
    cause = "" if pair is None else _in_pieces(pair)
    settings = settings or WarningSettings()
    mean = _mean_confidence(match)
    if mean < settings.least_confidence:
        return (
            f"the match is doubtful: its mean confidence is {mean:.2f}; "
            + (cause or "are the shapes of one kind, and dense enough?"),
        )
    energy = None if match.quality is None else match.quality.mean.dirichlet_energy_99
    if energy is not None and energy > settings.most_dirichlet_energy:
        return (
            f"the match is doubtful: it tears the shapes (Dirichlet energy of 99 % of the edges {energy:.1f}, "
            f"of good maps up to {settings.most_dirichlet_energy:g}); " + (cause or "are they of one kind?"),
        )
    return ()


def _mean_confidence(match: Match) -> float:
    """Of the map that has less; points without a counterpart do not count."""
    sides = (match.source_to_target, match.source_confidence), (match.target_to_source, match.target_confidence)
    means = [float(confidence[indices >= 0].mean()) for indices, confidence in sides if (indices >= 0).any()]
    return min(means, default=0.0)


@contextmanager
def blaming(warnings: Sequence[str]) -> Iterator[None]:
    """Give what there is a warning of as the reason of a failure: of units that differ, other errors would mislead."""
    try:
        yield
    except HomologError:
        if warnings:
            raise ShapeError(warnings[0]) from None
        raise
