"""Two shapes before they are matched: what is known of them, their operators and features, and how maps are made."""

from homolog.pairs.options import SIDES, AsCloud, PairOptions, Side
from homolog.pairs.pair import Pair, PointMaps
from homolog.pairs.preprocessing import OperatorSource, PreprocessedShape, Preprocessor
from homolog.pairs.settings import (
    AlignmentSettings,
    AxiomaticSettings,
    Device,
    FunctionalMapSettings,
    MatcherSettings,
    SoftMapSettings,
    WarningSettings,
    choose_device,
)

__all__ = [
    "SIDES",
    "AlignmentSettings",
    "AsCloud",
    "AxiomaticSettings",
    "Device",
    "FunctionalMapSettings",
    "MatcherSettings",
    "OperatorSource",
    "Pair",
    "PairOptions",
    "PointMaps",
    "PreprocessedShape",
    "Preprocessor",
    "Side",
    "SoftMapSettings",
    "WarningSettings",
    "choose_device",
]
