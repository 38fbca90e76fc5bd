"""Correspondence as mathematics: functional maps, soft maps, refinement, confidence, as pure functions of tensors.

Functions take torch tensors or numpy arrays, and return what they were given. ``homolog.maps.reference`` has short,
readable twins of the fast ones. Words and directions: a point map ``y_to_x`` holds for each point of y the index of its
point of x; a functional map ``C_xy`` takes spectral coefficients on x to those on y.
"""

from homolog.maps.coarse_map import CoarseFit, CoarseMapSettings, coarse_fit
from homolog.maps.confidence import (
    ConfidenceSettings,
    confidence,
    coverage_density,
    local_stretch,
    neighbourhoods,
    overlap,
)
from homolog.maps.descriptors import heat_kernel_signature, smoothed_positions, wave_kernel_signature
from homolog.maps.functional_map import (
    functional_map,
    functional_map_from_point_map,
    point_map_from_functional_map,
    resolvent_mask,
)
from homolog.maps.handedness import handedness, surface_handedness
from homolog.maps.nearest import Nearest, most_similar, nearest_neighbour
from homolog.maps.quality import (
    coverage,
    cycle_error,
    dirichlet_energy,
    flipped_triangles,
    smooth_dirichlet_energy,
)
from homolog.maps.registration import (
    RegistrationSettings,
    RegistrationStart,
    SampledSurface,
    registered_positions,
    registered_surfaces,
    registration_start,
)
from homolog.maps.rigid import Similarity, best_similarity, closest_point_similarity, composed, rigid_motion
from homolog.maps.rotations import (
    best_rotation,
    closest_point_rotations,
    cube_rotations,
    distinct_rotations,
    joint_rotations,
    principal_rotations,
    rotation_angle,
)
from homolog.maps.soft_map import SoftMatches, normalised, sinkhorn_matches
from homolog.maps.zoomout import LandmarkRows, RefinementSettings, zoomout, zoomout_partial

__all__ = [
    "CoarseFit",
    "CoarseMapSettings",
    "ConfidenceSettings",
    "LandmarkRows",
    "Nearest",
    "RefinementSettings",
    "RegistrationSettings",
    "RegistrationStart",
    "SampledSurface",
    "Similarity",
    "SoftMatches",
    "best_rotation",
    "best_similarity",
    "closest_point_rotations",
    "closest_point_similarity",
    "coarse_fit",
    "composed",
    "confidence",
    "coverage",
    "coverage_density",
    "cube_rotations",
    "cycle_error",
    "dirichlet_energy",
    "distinct_rotations",
    "flipped_triangles",
    "functional_map",
    "functional_map_from_point_map",
    "handedness",
    "heat_kernel_signature",
    "joint_rotations",
    "local_stretch",
    "most_similar",
    "nearest_neighbour",
    "neighbourhoods",
    "normalised",
    "overlap",
    "point_map_from_functional_map",
    "principal_rotations",
    "registered_positions",
    "registered_surfaces",
    "registration_start",
    "resolvent_mask",
    "rigid_motion",
    "rotation_angle",
    "sinkhorn_matches",
    "smooth_dirichlet_energy",
    "smoothed_positions",
    "surface_handedness",
    "wave_kernel_signature",
    "zoomout",
    "zoomout_partial",
]
