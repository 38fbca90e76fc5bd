"""Sets of shapes with splits, pairs and ground truth."""

from homolog.datasets.folder import Pair, ShapeFolder, Split, drawn_pairs

__all__ = ["Pair", "ShapeFolder", "Split", "drawn_pairs"]
