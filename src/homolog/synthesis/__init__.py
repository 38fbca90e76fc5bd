"""Synthetic data with exact ground truth: people, and partial shapes (cuts, holes, views) of full ones."""

from homolog.synthesis.body_model import BodyModel
from homolog.synthesis.cutting import cut, cut_holes
from homolog.synthesis.degradation import add_outliers, subsample
from homolog.synthesis.partial_shape import PartialShape
from homolog.synthesis.people import MeshedBody, PeopleSettings, Person, make_person, mesh_body
from homolog.synthesis.people_folder import PeopleFolder, write_shape_files
from homolog.synthesis.production import synthesize_people
from homolog.synthesis.remeshing import MeshSettings
from homolog.synthesis.view_dataset import write_view_dataset
from homolog.synthesis.views import Camera, View, ViewSettings, sample_camera, view, view_from

__all__ = [
    "BodyModel",
    "Camera",
    "MeshSettings",
    "MeshedBody",
    "PartialShape",
    "PeopleFolder",
    "PeopleSettings",
    "Person",
    "View",
    "ViewSettings",
    "add_outliers",
    "cut",
    "cut_holes",
    "make_person",
    "mesh_body",
    "sample_camera",
    "subsample",
    "synthesize_people",
    "view",
    "view_from",
    "write_shape_files",
    "write_view_dataset",
]
