"""Shape models: a template registered to many shapes, and the statistics of the corresponding points."""

from homolog.shape_models.batch import register_all, settings_record
from homolog.shape_models.build import BuiltModel, build
from homolog.shape_models.choice import choice_for_all
from homolog.shape_models.completion import COMPLETION_FILES, Completion, complete, write_completion
from homolog.shape_models.folder import Outcome, ShapeModelFolder
from homolog.shape_models.groups import (
    COMPARISON_FILES,
    ComparedGroups,
    compared_groups,
    read_groups,
    write_comparison,
)
from homolog.shape_models.landmarks import TemplateLandmarks
from homolog.shape_models.model_fit import ModelFit, ModelFitSettings, ModelFitter, PartSamples
from homolog.shape_models.outputs import check_extra, write_outputs
from homolog.shape_models.overview import MOST_SHOWN
from homolog.shape_models.registered_shapes import ModelSettings, RegisteredShapes
from homolog.shape_models.registration import Figures, Registered, Template, check_template
from homolog.shape_models.sequence import TRACK_FILES, Track, TrackedFrame, track, write_track
from homolog.shape_models.settings import ShapeModelSettings
from homolog.shape_models.stored_model import StoredModel
from homolog.shape_models.subjects import Subject, listed_files, subjects_of

__all__ = [
    "COMPARISON_FILES",
    "COMPLETION_FILES",
    "MOST_SHOWN",
    "TRACK_FILES",
    "BuiltModel",
    "ComparedGroups",
    "Completion",
    "Figures",
    "ModelFit",
    "ModelFitSettings",
    "ModelFitter",
    "ModelSettings",
    "Outcome",
    "PartSamples",
    "Registered",
    "RegisteredShapes",
    "ShapeModelFolder",
    "ShapeModelSettings",
    "StoredModel",
    "Subject",
    "Template",
    "TemplateLandmarks",
    "Track",
    "TrackedFrame",
    "build",
    "check_extra",
    "check_template",
    "choice_for_all",
    "compared_groups",
    "complete",
    "listed_files",
    "read_groups",
    "register_all",
    "settings_record",
    "subjects_of",
    "track",
    "write_comparison",
    "write_completion",
    "write_outputs",
    "write_track",
]
