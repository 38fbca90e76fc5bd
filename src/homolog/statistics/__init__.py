"""Statistics of shapes in correspondence: Procrustes alignment, principal modes, and the quality of a shape model."""

from homolog.statistics.alignment import Aligned, generalised_procrustes
from homolog.statistics.curves import Curve, compactness, generalisation, specificity
from homolog.statistics.model import ShapeModel, principal_modes

__all__ = [
    "Aligned",
    "Curve",
    "ShapeModel",
    "compactness",
    "generalisation",
    "generalised_procrustes",
    "principal_modes",
    "specificity",
]
