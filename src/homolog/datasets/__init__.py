"""Datasets: folders of shapes with splits, pairs and ground truth, read by descriptions.


A name is imported when it is first used: a description is read without loading what reads shapes.
"""

from typing import TYPE_CHECKING

from homolog.core.lazy import lazy_names

if TYPE_CHECKING:
    from homolog.core.choices import Split
    from homolog.datasets.checking import DatasetReport, check_dataset, checksum, counted
    from homolog.datasets.description import DatasetDescription, builtin_descriptions, read_description
    from homolog.datasets.files import mesh_files
    from homolog.datasets.folder import Pair, ShapeFolder, class_of, demo_folder, drawn_pairs, partner
    from homolog.datasets.truth import Counterparts, GroundTruth, Truth, read_truth, read_vertices

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
    "checksum",
    "class_of",
    "counted",
    "demo_folder",
    "drawn_pairs",
    "mesh_files",
    "partner",
    "read_description",
    "read_truth",
    "read_vertices",
]

_MODULES = {
    "Counterparts": "truth",
    "DatasetDescription": "description",
    "DatasetReport": "checking",
    "GroundTruth": "truth",
    "Pair": "folder",
    "ShapeFolder": "folder",
    "Split": "folder",
    "Truth": "truth",
    "builtin_descriptions": "description",
    "check_dataset": "checking",
    "checksum": "checking",
    "class_of": "folder",
    "counted": "checking",
    "demo_folder": "folder",
    "drawn_pairs": "folder",
    "mesh_files": "files",
    "partner": "folder",
    "read_description": "description",
    "read_truth": "truth",
    "read_vertices": "truth",
}
__getattr__ = lazy_names(__name__, _MODULES)
