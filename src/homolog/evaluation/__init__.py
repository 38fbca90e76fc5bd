"""How good maps are: metrics and the field's protocol."""

from homolog.core.choices import Modalities
from homolog.evaluation.exchanges import (
    Exchange,
    ExchangeFinder,
    Partners,
    exchange_of,
    mean_shape,
    mirror_plane,
    partners,
)
from homolog.evaluation.maps_folder import MapsFolder
from homolog.evaluation.metrics import (
    PCK_THRESHOLD,
    Detection,
    area_under_pck,
    geodesic_diameter,
    geodesic_errors,
    least_confident_share,
    pck_curve,
)
from homolog.evaluation.plot import PckCurve, plot_errors, plot_pck, plot_pck_curves
from homolog.evaluation.protocol import Protocol
from homolog.evaluation.result import Evaluation, PairErrors
from homolog.evaluation.runner import MatchShapes, Metric, ScoredPair, evaluate

__all__ = [
    "PCK_THRESHOLD",
    "Detection",
    "Evaluation",
    "Exchange",
    "ExchangeFinder",
    "MapsFolder",
    "MatchShapes",
    "Metric",
    "Modalities",
    "PairErrors",
    "Partners",
    "PckCurve",
    "Protocol",
    "ScoredPair",
    "area_under_pck",
    "evaluate",
    "exchange_of",
    "geodesic_diameter",
    "geodesic_errors",
    "least_confident_share",
    "mean_shape",
    "mirror_plane",
    "partners",
    "pck_curve",
    "plot_errors",
    "plot_pck",
    "plot_pck_curves",
]
