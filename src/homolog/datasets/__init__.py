"""Sets of shapes with splits, pairs and ground truth."""

from homolog.datasets.files import mesh_files
from homolog.datasets.folder import Pair, ShapeFolder, Split, drawn_pairs

__all__ = ["Pair", "ShapeFolder", "Split", "drawn_pairs", "mesh_files"]
