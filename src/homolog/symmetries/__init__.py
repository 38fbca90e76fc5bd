"""Bilateral symmetry of one shape: mirror partners, the mirror plane, and how asymmetric each point is."""

from homolog.symmetries.files import (
    SYMMETRY_FILES,
    heat_layers,
    read_partner_positions,
    scene_of_symmetry,
    write_symmetry,
)
from homolog.symmetries.finding import BENT, Symmetry, mirror_words, symmetry
from homolog.symmetries.measuring import local_stretch

__all__ = [
    "BENT",
    "SYMMETRY_FILES",
    "Symmetry",
    "heat_layers",
    "local_stretch",
    "mirror_words",
    "read_partner_positions",
    "scene_of_symmetry",
    "symmetry",
    "write_symmetry",
]
