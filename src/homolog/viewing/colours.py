"""Numbers and features as colours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

# What nothing is known of is grey, as in the files of a result.
UNKNOWN = (160, 160, 160)

# From dark to light, so that they can be told apart without hues, too.
LOW_TO_HIGH = ((58, 32, 98), (45, 104, 152), (64, 172, 138), (244, 220, 92))
GOOD_TO_BAD = ((236, 238, 214), (246, 196, 92), (222, 98, 48), (112, 16, 52))

# Shares of all points whose features span the colours; the few beyond would leave the rest alike.
_SPAN = (0.02, 0.98)


@dataclass(frozen=True)
class Ramp:
    """Colours of numbers: evenly spaced stops from ``low`` to ``high``, linear in between; beyond them the ends.

    Args:
        stops: at least two colours, of red, green and blue from 0 to 255.
        low: the number of the first stop.
        high: the number of the last stop, above ``low``.
        unit: what the numbers are, for a legend.
    """

    stops: tuple[tuple[int, int, int], ...]
    low: float
    high: float
    unit: str = ""

    def colours(self, values: Float[np.ndarray, " n"]) -> UInt8[np.ndarray, "n 3"]:
        """The colours of numbers; grey where they are NaN."""
        known = np.isfinite(values)
        colours = np.tile(np.array(UNKNOWN, dtype=np.uint8), (len(values), 1))
        places = np.linspace(self.low, self.high, len(self.stops))
        channels = [np.interp(values[known], places, channel) for channel in np.transpose(self.stops)]
        colours[known] = np.round(np.stack(channels, axis=1))
        return colours


def principal_colours(
    source: Float[np.ndarray, "n_source d"], target: Float[np.ndarray, "n_target d"]
) -> tuple[UInt8[np.ndarray, "n_source 3"], UInt8[np.ndarray, "n_target 3"]]:
    """Features as colours: their three principal components, of both shapes together, as red, green and blue.

    Like features have like colours on both shapes. Rows are brought to length one first, as only their directions are
    compared in a match; rows with a NaN are grey. The largest entry of each principal direction is positive.
    """
    features = np.concatenate([source, target]).astype(np.float64)
    known = np.isfinite(features).all(axis=1)
    colours = np.tile(np.array(UNKNOWN, dtype=np.uint8), (len(features), 1))
    if known.any():
        colours[known] = _spread(_principal_components(features[known]))
    return colours[: len(source)], colours[len(source) :]


def _principal_components(features: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n 3"]:
    lengths = np.linalg.norm(features, axis=1, keepdims=True)
    rows = features / np.where(lengths > 0, lengths, 1.0)
    rows = rows - rows.mean(axis=0)
    directions = np.linalg.eigh(rows.T @ rows)[1][:, ::-1][:, :3]
    largest = np.take_along_axis(directions, np.abs(directions).argmax(axis=0)[None], axis=0)
    components = rows @ (directions * np.where(largest < 0, -1.0, 1.0))
    # Features of fewer than three numbers leave the other colours at their middle.
    return np.pad(components, ((0, 0), (0, 3 - components.shape[1])))


def _spread(components: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    low, high = np.quantile(components, _SPAN, axis=0)
    share = np.where(high > low, (components - low) / np.where(high > low, high - low, 1.0), 0.5)
    spread: np.ndarray = np.round(40 + 215 * share.clip(0, 1))
    return spread
