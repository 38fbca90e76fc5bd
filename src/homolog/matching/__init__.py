"""Matcher (operators -> features -> map, the route per modality) and Correspondence (the result)."""

from homolog.matching.correspondence import Correspondence, Route
from homolog.matching.matcher import Matcher, OperatorSource
from homolog.matching.output import (
    RESULT_FILES,
    MatchResult,
    matched_colours,
    matched_name,
    position_colours,
    read_result,
    write_result,
)
from homolog.matching.prepared import PointMaps, Prepared
from homolog.matching.quality import MEASURES, MapQuality, Quality
from homolog.matching.settings import NEED_NO_WEIGHTS, AsCloud, Device, MatcherSettings, Method, Side, choose_device

__all__ = [
    "MEASURES",
    "NEED_NO_WEIGHTS",
    "RESULT_FILES",
    "AsCloud",
    "Correspondence",
    "Device",
    "MapQuality",
    "MatchResult",
    "Matcher",
    "MatcherSettings",
    "Method",
    "OperatorSource",
    "PointMaps",
    "Prepared",
    "Quality",
    "Route",
    "Side",
    "choose_device",
    "matched_colours",
    "matched_name",
    "position_colours",
    "read_result",
    "write_result",
]
