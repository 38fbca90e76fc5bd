"""Many shapes matched to one template: its points placed on each, and what follows from points that correspond."""

from homolog.shape_models.delivery import check_extra, deliver
from homolog.shape_models.folder import CollectionFolder, Outcome
from homolog.shape_models.gathered import ModelSettings
from homolog.shape_models.overview import MOST_SHOWN
from homolog.shape_models.production import CollectionSettings, collect, making
from homolog.shape_models.registering import Figures, Registered, Template, check_template
from homolog.shape_models.subjects import Subject, subjects_of

__all__ = [
    "MOST_SHOWN",
    "CollectionFolder",
    "CollectionSettings",
    "Figures",
    "ModelSettings",
    "Outcome",
    "Registered",
    "Subject",
    "Template",
    "check_extra",
    "check_template",
    "collect",
    "deliver",
    "making",
    "subjects_of",
]
