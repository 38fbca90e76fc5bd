"""Statistics of shapes in correspondence: alignment, principal modes and their quality, posteriors, mirror planes."""

from homolog.statistics.alignment import Aligned, generalised_procrustes
from homolog.statistics.comparison import PERMUTATIONS, GroupComparison, compare_groups, false_discovery_rates
from homolog.statistics.curves import Curve, compactness, generalisation, specificity
from homolog.statistics.model import ShapeModel, principal_modes
from homolog.statistics.posterior import (
    Observations,
    PlacedPosterior,
    Placement,
    placed_posterior,
    posterior_model,
)
from homolog.statistics.rows import FileRows, PointRows, Rows
from homolog.statistics.symmetry import (
    FEWEST_PAIRS,
    MirrorPlane,
    SymmetricComponents,
    best_mirror_plane,
    mirror_normal,
    symmetric_components,
)

__all__ = [
    "FEWEST_PAIRS",
    "PERMUTATIONS",
    "Aligned",
    "Curve",
    "FileRows",
    "GroupComparison",
    "MirrorPlane",
    "Observations",
    "PlacedPosterior",
    "Placement",
    "PointRows",
    "Rows",
    "ShapeModel",
    "SymmetricComponents",
    "best_mirror_plane",
    "compactness",
    "compare_groups",
    "false_discovery_rates",
    "generalisation",
    "generalised_procrustes",
    "mirror_normal",
    "placed_posterior",
    "posterior_model",
    "principal_modes",
    "specificity",
    "symmetric_components",
]
