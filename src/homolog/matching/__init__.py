"""From two shapes to a match: the road (``Matcher``), its stages, and the result (``Match``)."""

from homolog.matching.alignment import Alignment, align_partial, best_alignment
from homolog.matching.alternatives import (
    FIRST_ALTERNATIVE,
    alternative_folder,
    alternative_folders,
    degrees_between,
    exchanges_sides,
    load_alternatives,
)
from homolog.matching.choice import features_of_weights, needs_features
from homolog.matching.colours import matched_colours, position_colours
from homolog.matching.extra_parts import extra_part_warnings, without_extra_parts
from homolog.matching.feature_choice import FeatureChoice
from homolog.matching.guidance import guided, meet_landmarks
from homolog.matching.in_one_call import match
from homolog.matching.inputs import with_inputs
from homolog.matching.matcher import Matcher
from homolog.matching.misfit import map_misfit
from homolog.matching.placing import align_parts
from homolog.matching.quality import MEASURES, MapQuality, Quality
from homolog.matching.refinement import refine
from homolog.matching.result import Match, check_point_map, checked_maps
from homolog.matching.result_files import (
    MAP_SUFFIXES,
    RESULT_FILES,
    given_files,
    matched_name,
    read_point_map,
    write_folder,
)
from homolog.matching.search import Hypothesis, orient, orientations
from homolog.matching.smoothing import smoothed
from homolog.matching.units import unit_warnings
from homolog.matching.warnings import low_confidence_warnings, orientation_warnings, part_warnings

__all__ = [
    "FIRST_ALTERNATIVE",
    "MAP_SUFFIXES",
    "MEASURES",
    "RESULT_FILES",
    "Alignment",
    "FeatureChoice",
    "Hypothesis",
    "MapQuality",
    "Match",
    "Matcher",
    "Quality",
    "align_partial",
    "align_parts",
    "alternative_folder",
    "alternative_folders",
    "best_alignment",
    "check_point_map",
    "checked_maps",
    "degrees_between",
    "exchanges_sides",
    "extra_part_warnings",
    "features_of_weights",
    "given_files",
    "guided",
    "load_alternatives",
    "low_confidence_warnings",
    "map_misfit",
    "match",
    "matched_colours",
    "matched_name",
    "meet_landmarks",
    "needs_features",
    "orient",
    "orientation_warnings",
    "orientations",
    "part_warnings",
    "position_colours",
    "read_point_map",
    "refine",
    "smoothed",
    "unit_warnings",
    "with_inputs",
    "without_extra_parts",
    "write_folder",
]
