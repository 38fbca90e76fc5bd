"""Correspondence as mathematics: pure functions of tensors."""

from homolog.maps.confidence import confidence, coverage_density, covered, local_stretch
from homolog.maps.descriptors import smoothed_positions, wave_kernel_signature
from homolog.maps.elastic import elastic_positions
from homolog.maps.functional_map import (
    functional_map,
    functional_map_from_point_map,
    point_map_from_functional_map,
    resolvent_mask,
)
from homolog.maps.nearest import Nearest, most_similar, nearest_neighbour
from homolog.maps.quality import coverage, dirichlet_energy, flipped_triangles, there_and_back
from homolog.maps.refinement import guided_zoom_out, guided_zoom_out_to_part
from homolog.maps.rigid import rigid_motion
from homolog.maps.soft_map import SoftMatches, normalised, sinkhorn_matches

__all__ = [
    "Nearest",
    "SoftMatches",
    "confidence",
    "coverage",
    "coverage_density",
    "covered",
    "dirichlet_energy",
    "elastic_positions",
    "flipped_triangles",
    "functional_map",
    "functional_map_from_point_map",
    "guided_zoom_out",
    "guided_zoom_out_to_part",
    "local_stretch",
    "most_similar",
    "nearest_neighbour",
    "normalised",
    "point_map_from_functional_map",
    "resolvent_mask",
    "rigid_motion",
    "sinkhorn_matches",
    "smoothed_positions",
    "there_and_back",
    "wave_kernel_signature",
]
