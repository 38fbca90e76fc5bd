"""Datasets: folders of shapes with splits, pairs and ground truth, read by descriptions."""

from homolog.datasets.checking import DatasetReport, check_dataset, counted
from homolog.datasets.description import DatasetDescription, builtin_descriptions, read_description
from homolog.datasets.files import mesh_files
from homolog.datasets.folder import Pair, ShapeFolder, Split, drawn_pairs, partner
from homolog.datasets.truth import Counterparts, GroundTruth, Truth, read_truth

__all__ = [
    "Counterparts",
    "DatasetDescription",
    "DatasetReport",
    "GroundTruth",
    "Pair",
    "ShapeFolder",
    "Split",
    "Truth",
    "builtin_descriptions",
    "check_dataset",
    "counted",
    "drawn_pairs",
    "mesh_files",
    "partner",
    "read_description",
    "read_truth",
]
