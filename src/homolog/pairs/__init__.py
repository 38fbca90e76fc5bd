"""Two shapes before they are matched: what is known of them, their operators and features, and how maps are made.

A name is imported when it is first used: options are checked without PyTorch.
"""

from typing import TYPE_CHECKING

from homolog.core.lazy import lazy_names

if TYPE_CHECKING:
    from homolog.core.choices import AsCloud, Device, Side
    from homolog.pairs.guidance import Guidance
    from homolog.pairs.landmarks import LandmarkPairs
    from homolog.pairs.masks import MASK_SUFFIXES, Mask, mask_of, read_mask
    from homolog.pairs.method import Method, Supports, check_supported
    from homolog.pairs.options import SIDES, PairOptions
    from homolog.pairs.pair import Candidate, Pair, PairAdaptation, PairOrientation, PartsFit, PointMaps
    from homolog.pairs.preprocessing import OperatorSource, PreprocessedShape, Preprocessor
    from homolog.pairs.proxy import PROXY_RULES
    from homolog.pairs.settings import (
        AlignmentSettings,
        AxiomaticSettings,
        ChoiceSettings,
        ExtraPartSettings,
        FunctionalMapSettings,
        GuidanceSettings,
        MatcherSettings,
        OrientationSettings,
        PartsSettings,
        PlacedMapSettings,
        PlacementSettings,
        ProxySettings,
        SmoothingSettings,
        SoftMapSettings,
        WarningSettings,
        choose_device,
    )

__all__ = [
    "MASK_SUFFIXES",
    "PROXY_RULES",
    "SIDES",
    "AlignmentSettings",
    "AsCloud",
    "AxiomaticSettings",
    "Candidate",
    "ChoiceSettings",
    "Device",
    "ExtraPartSettings",
    "FunctionalMapSettings",
    "Guidance",
    "GuidanceSettings",
    "LandmarkPairs",
    "Mask",
    "MatcherSettings",
    "Method",
    "OperatorSource",
    "OrientationSettings",
    "Pair",
    "PairAdaptation",
    "PairOptions",
    "PairOrientation",
    "PartsFit",
    "PartsSettings",
    "PlacedMapSettings",
    "PlacementSettings",
    "PointMaps",
    "PreprocessedShape",
    "Preprocessor",
    "ProxySettings",
    "Side",
    "SmoothingSettings",
    "SoftMapSettings",
    "Supports",
    "WarningSettings",
    "check_supported",
    "choose_device",
    "mask_of",
    "read_mask",
]

_MODULES = {
    "PROXY_RULES": "proxy",
    "MASK_SUFFIXES": "masks",
    "SIDES": "options",
    "AlignmentSettings": "settings",
    "AsCloud": "options",
    "AxiomaticSettings": "settings",
    "Candidate": "pair",
    "ChoiceSettings": "settings",
    "ExtraPartSettings": "settings",
    "Device": "settings",
    "FunctionalMapSettings": "settings",
    "Guidance": "guidance",
    "GuidanceSettings": "settings",
    "LandmarkPairs": "landmarks",
    "Mask": "masks",
    "MatcherSettings": "settings",
    "Method": "method",
    "OperatorSource": "preprocessing",
    "OrientationSettings": "settings",
    "Pair": "pair",
    "PairAdaptation": "pair",
    "PairOptions": "options",
    "PairOrientation": "pair",
    "PartsFit": "pair",
    "PartsSettings": "settings",
    "PlacedMapSettings": "settings",
    "PlacementSettings": "settings",
    "PointMaps": "pair",
    "PreprocessedShape": "preprocessing",
    "Preprocessor": "preprocessing",
    "ProxySettings": "settings",
    "Side": "options",
    "SmoothingSettings": "settings",
    "SoftMapSettings": "settings",
    "Supports": "method",
    "WarningSettings": "settings",
    "check_supported": "method",
    "choose_device": "settings",
    "mask_of": "masks",
    "read_mask": "masks",
}
__getattr__ = lazy_names(__name__, _MODULES)
