"""Shapes made for training and tests, with exact ground truth: people, and parts and views of complete shapes."""

from homolog.synthesis.body_model import BodyModel
from homolog.synthesis.degradation import add_outliers, subsample
from homolog.synthesis.part import Part
from homolog.synthesis.parts import cut, cut_holes
from homolog.synthesis.people import MeshedBody, PeopleSettings, Person, make_person, meshed
from homolog.synthesis.people_folder import PeopleFolder, write_shape_files
from homolog.synthesis.production import synthesize_people
from homolog.synthesis.remeshing import MeshSettings
from homolog.synthesis.view_set import write_view_set
from homolog.synthesis.views import Camera, View, ViewSettings, drawn_camera, view, view_from

__all__ = [
    "BodyModel",
    "Camera",
    "MeshSettings",
    "MeshedBody",
    "Part",
    "PeopleFolder",
    "PeopleSettings",
    "Person",
    "View",
    "ViewSettings",
    "add_outliers",
    "cut",
    "cut_holes",
    "drawn_camera",
    "make_person",
    "meshed",
    "subsample",
    "synthesize_people",
    "view",
    "view_from",
    "write_shape_files",
    "write_view_set",
]
