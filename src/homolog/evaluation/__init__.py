"""How good maps are: metrics and the field's protocol."""

from homolog.core.choices import Modalities
from homolog.evaluation.metrics import PCK_THRESHOLD, Detection, area_under_pck, least_confident_share, pck_curve
from homolog.evaluation.protocol import Evaluation, MatchPair, Protocol, evaluate, geodesic_errors

__all__ = [
    "PCK_THRESHOLD",
    "Detection",
    "Evaluation",
    "MatchPair",
    "Modalities",
    "Protocol",
    "area_under_pck",
    "evaluate",
    "geodesic_errors",
    "least_confident_share",
    "pck_curve",
]
