"""Parametric models fitted to scans: the body model of synthetic people, by a map from its template."""

from homolog.fitting.articulated import ArticulatedModel, Fit, Goal, Pose, fitted
from homolog.fitting.body import PeopleModel
from homolog.fitting.files import FIT_FILES, read_fit, write_fit
from homolog.fitting.registration import BodyFit, BodyTemplate, Unit, fit_body, fit_to_match

__all__ = [
    "FIT_FILES",
    "ArticulatedModel",
    "BodyFit",
    "BodyTemplate",
    "Fit",
    "Goal",
    "PeopleModel",
    "Pose",
    "Unit",
    "fit_body",
    "fit_to_match",
    "fitted",
    "read_fit",
    "write_fit",
]
