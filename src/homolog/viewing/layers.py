"""What colours can mean: correspondence, confidence, error, features; a page shows one layer at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from homolog.matching import Match, matched_colours
from homolog.pairs import Side
from homolog.viewing.colours import GOOD_TO_BAD, LOW_TO_HIGH, Ramp, principal_colours

_ERROR_SHARE = 0.95


@dataclass(frozen=True, eq=False)
class Layer:
    """Colours of both shapes, and what they mean.

    Args:
        name: a word or two, for a choice among layers.
        note: a sentence for the legend.
        colours: per point of each shape (n, 3).
        ramp: how numbers became colours; None where there are no numbers.
        values: those numbers, per point of each shape (n,); NaN where there is none.
    """

    name: str
    note: str
    colours: dict[Side, UInt8[np.ndarray, "n 3"]]
    ramp: Ramp | None = None
    values: dict[Side, Float[np.ndarray, " n"]] | None = None


def matched_layer(result: Match) -> Layer:
    """The colours of the result's files: corresponding points have the same one."""
    source, target = matched_colours(result)
    note = "The same colour marks the same point. Grey: no counterpart."
    return Layer("Match", note, {"source": source, "target": target})


def confidence_layer(result: Match) -> Layer:
    """The confidence of each point's match; grey where it has none."""
    found = result
    values: dict[Side, np.ndarray] = {
        "source": np.where(found.source_to_target >= 0, found.source_confidence, np.nan),
        "target": np.where(found.target_to_source >= 0, found.target_confidence, np.nan),
    }
    note = "How far each point's match can be trusted. Grey: no counterpart."
    return _of_values("Confidence", note, values, Ramp(LOW_TO_HIGH, 0.0, 1.0))


def error_layer(errors: dict[Side, Float[np.ndarray, " n"]], unit: str) -> Layer:
    """The error of each point's match; see ``map_errors``."""
    note = "How far from the truth each point is matched. Grey: not matched, or not known."
    return heat_layer("Error", note, errors, unit)


def heat_layer(name: str, note: str, values: dict[Side, Float[np.ndarray, " n"]], unit: str) -> Layer:
    """Numbers of which 0 is best, as a heat map.

    The ramp ends at the 95th percentile.

    Args:
        name: a word or two, for a choice among layers.
        note: a sentence for the legend.
        values: per point of each shape (n,); NaN where there is none.
        unit: what they are.
    """
    known = np.concatenate([numbers[np.isfinite(numbers)] for numbers in values.values()])
    high = float(np.quantile(known, _ERROR_SHARE)) if len(known) else 0.0
    return _of_values(name, note, values, Ramp(GOOD_TO_BAD, 0.0, high or 1.0, unit))


def feature_layer(source: Float[np.ndarray, "n_source d"], target: Float[np.ndarray, "n_target d"]) -> Layer:
    """The features that points were compared by, as colours; see ``principal_colours``."""
    colours = principal_colours(source, target)
    note = "Like colours mark like features: their three principal components. Grey: left out of the match."
    return Layer("Features", note, {"source": colours[0], "target": colours[1]})


def _of_values(name: str, note: str, values: dict[Side, Float[np.ndarray, " n"]], ramp: Ramp) -> Layer:
    return Layer(name, note, {side: ramp.colours(numbers) for side, numbers in values.items()}, ramp, values)
