"""Many shapes matched to one template: its points placed on each, and what follows from points that correspond."""

from homolog.collecting.delivery import check_extra, deliver
from homolog.collecting.folder import CollectionFolder, Outcome
from homolog.collecting.gathered import ModelSettings
from homolog.collecting.overview import MOST_SHOWN
from homolog.collecting.placing import Figures, Placed, Template, check_template
from homolog.collecting.production import CollectionSettings, collect, making
from homolog.collecting.subjects import Subject, subjects_of

__all__ = [
    "MOST_SHOWN",
    "CollectionFolder",
    "CollectionSettings",
    "Figures",
    "ModelSettings",
    "Outcome",
    "Placed",
    "Subject",
    "Template",
    "check_extra",
    "check_template",
    "collect",
    "deliver",
    "making",
    "subjects_of",
]
