"""Sets of shapes with splits, pairs and ground truth."""

from homolog.datasets.checking import SetReport, check_set, counted
from homolog.datasets.description import SetDescription, read_description, shipped_descriptions
from homolog.datasets.files import mesh_files
from homolog.datasets.folder import Pair, ShapeFolder, Split, drawn_pairs, partner
from homolog.datasets.truth import Counterparts, GroundTruth, Truth, read_truth

__all__ = [
    "Counterparts",
    "GroundTruth",
    "Pair",
    "SetDescription",
    "SetReport",
    "ShapeFolder",
    "Split",
    "Truth",
    "check_set",
    "counted",
    "drawn_pairs",
    "mesh_files",
    "partner",
    "read_description",
    "read_truth",
    "shipped_descriptions",
]
