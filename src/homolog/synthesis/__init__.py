"""Synthetic data with exact ground truth: people, hands, heads, animals, bones, variants of a shape; partial shapes."""

from homolog.synthesis.animals import Animals
from homolog.synthesis.bodies import Body, BodySettings, Kind, MeshedBody, make_body, mesh_body
from homolog.synthesis.body_folder import BodyFolder, write_shape_files
from homolog.synthesis.body_model import BodyModel
from homolog.synthesis.bones import Bones
from homolog.synthesis.cutting import cut, cut_holes
from homolog.synthesis.degradation import add_floor, add_outliers, add_shells, add_strays, subsample
from homolog.synthesis.hands import Hands
from homolog.synthesis.heads import Heads
from homolog.synthesis.meshings import STRETCHED, Meshing, other_meshing, write_meshings
from homolog.synthesis.organs import Organs
from homolog.synthesis.partial_shape import PartialShape
from homolog.synthesis.people import People
from homolog.synthesis.production import (
    synthesize_animals,
    synthesize_bones,
    synthesize_hands,
    synthesize_heads,
    synthesize_organs,
    synthesize_people,
)
from homolog.synthesis.remeshing import MeshSettings
from homolog.synthesis.view_dataset import write_view_dataset
from homolog.synthesis.views import Camera, View, ViewSettings, camera_apart, sample_camera, view, view_from
from homolog.synthesis.warping import Warp

__all__ = [
    "STRETCHED",
    "Animals",
    "Body",
    "BodyFolder",
    "BodyModel",
    "BodySettings",
    "Bones",
    "Camera",
    "Hands",
    "Heads",
    "Kind",
    "MeshSettings",
    "MeshedBody",
    "Meshing",
    "Organs",
    "PartialShape",
    "People",
    "View",
    "ViewSettings",
    "Warp",
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
    "synthesize_bones",
    "synthesize_hands",
    "synthesize_heads",
    "synthesize_organs",
    "synthesize_people",
    "view",
    "view_from",
    "write_meshings",
    "write_shape_files",
    "write_view_dataset",
]
