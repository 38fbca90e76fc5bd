"""Synthetic data with exact ground truth: people, hands, heads, animals; partial shapes."""

from homolog.synthesis.animals import Animals
from homolog.synthesis.bodies import Body, BodySettings, Kind, MeshedBody, make_body, mesh_body
from homolog.synthesis.body_folder import BodyFolder, write_shape_files
from homolog.synthesis.body_model import BodyModel
from homolog.synthesis.cutting import cut, cut_holes
from homolog.synthesis.degradation import add_floor, add_outliers, add_shells, add_strays, subsample
from homolog.synthesis.hands import Hands
from homolog.synthesis.heads import Heads
from homolog.synthesis.meshings import STRETCHED, Meshing, other_meshing, write_meshings
from homolog.synthesis.partial_shape import PartialShape
from homolog.synthesis.people import People
from homolog.synthesis.production import (
    synthesize_animals,
    synthesize_hands,
    synthesize_heads,
    synthesize_people,
)
from homolog.synthesis.remeshing import MeshSettings
from homolog.synthesis.view_dataset import write_view_dataset
from homolog.synthesis.views import Camera, View, ViewSettings, camera_apart, sample_camera, view, view_from

__all__ = [
    "STRETCHED",
    "Animals",
    "Body",
    "BodyFolder",
    "BodyModel",
    "BodySettings",
    "Camera",
    "Hands",
    "Heads",
    "Kind",
    "MeshSettings",
    "MeshedBody",
    "Meshing",
    "PartialShape",
    "People",
    "View",
    "ViewSettings",
    "add_floor",
    "add_outliers",
    "add_shells",
    "add_strays",
    "camera_apart",
    "cut",
    "cut_holes",
    "make_body",
    "mesh_body",
    "other_meshing",
    "sample_camera",
    "subsample",
    "synthesize_animals",
    "synthesize_hands",
    "synthesize_heads",
    "synthesize_people",
    "view",
    "view_from",
    "write_meshings",
    "write_shape_files",
    "write_view_dataset",
]
