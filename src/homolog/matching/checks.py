"""Arguments that cannot be, and what to tell the user of a match."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from homolog.core.arguments import is_real
from homolog.core.errors import ArgumentError, HomologError, ShapeError, bad_choice, bad_value
from homolog.matching.correspondence import Correspondence
from homolog.matching.part_units import unit_warnings
from homolog.matching.prepared import Prepared
from homolog.matching.settings import Method, Side
from homolog.shapes import Repaired

# Mean confidence below which the user is warned. Good matches of bodies have 0.7 to 0.9, hopeless ones under 0.2.
_DOUBTFUL = 0.35
# Mean Dirichlet energy of the maps above which the user is warned. Of 72 maps of people and animals, all above it were
# off by more than 6 % of sqrt(area), and all but one of those below it by less than 8 %; see docs/results.md.
_TORN = 8.0


def check_word(name: str, found: str | None, allowed: Sequence[str]) -> None:
    """Refuse a word that is none of those allowed."""
    if found is not None and found not in allowed:
        raise bad_choice(name, str(found), allowed)


def check_method(method: Method, partial: Side | None) -> None:
    """Refuse a part where the method knows whole shapes alone."""
    if partial is not None and method == "registration":
        raise ArgumentError(
            f"partial is {partial!r}, but the method 'registration' registers full shapes; partial ones take 'auto'"
        )


def check_part(partial: Side | None, *, partial_scale: float, pre_aligned: bool) -> None:
    """Refuse what says how a part lies if there is none, or is no such thing."""
    if not (is_real(partial_scale) and partial_scale > 0):
        raise bad_value("partial_scale", partial_scale, "a positive finite number")
    if partial_scale != 1 and partial is None:
        raise ArgumentError(
            f"partial_scale is {partial_scale!r}, but neither shape is partial; say which one is, by partial"
        )
    if not isinstance(pre_aligned, bool):
        raise bad_value("pre_aligned", pre_aligned, "True or False")
    if pre_aligned and partial is None:
        raise ArgumentError("pre_aligned is True, but neither shape is partial; say which one is, by partial")


def units_that_differ(source: Prepared, target: Prepared, partial: Side | None) -> list[str]:
    """What to tell the user if a part's area cannot be that of a part."""
    if partial is None:
        return []
    part, complete = (source, target) if partial == "source" else (target, source)
    unit = complete.operators.scale
    return unit_warnings(part.repaired, factor=unit / part.operators.scale, complete_area=unit**2)


@contextmanager
def blaming(warnings: Sequence[str]) -> Iterator[None]:
    """Give what there is a warning of as the reason of a failure: of units that differ, other errors would mislead."""
    try:
        yield
    except HomologError:
        if warnings:
            raise ShapeError(warnings[0]) from None
        raise


def refuse_repairs(repaired: Repaired) -> None:
    """Refuse a shape of which anything had to be repaired."""
    for finding in repaired.report.findings:
        if finding.severity != "note":
            raise ShapeError(f"{repaired.shape.name}: {finding} (refused as strict)")


def doubts(found: Correspondence) -> tuple[str, ...]:
    """A warning if the maps contradict themselves nearly everywhere, or tear the shapes to pieces.

    Points without a counterpart do not count.
    """
    sides = (found.source_to_target, found.source_confidence), (found.target_to_source, found.target_confidence)
    means = [float(confidence[indices >= 0].mean()) for indices, confidence in sides if (indices >= 0).any()]
    mean = min(means, default=0.0)
    if mean < _DOUBTFUL:
        return (
            f"the match is doubtful: its mean confidence is {mean:.2f}; are the shapes of one kind, and dense enough?",
        )
    energy = 0.0 if found.quality is None else found.quality.mean.dirichlet_energy
    if energy > _TORN:
        return (
            f"the match is doubtful: it tears the shapes (Dirichlet energy {energy:.0f}, of good maps 1 to 3); are "
            "they of one kind, which any weights must know, and do both stand upright and face one way?",
        )
    return ()
