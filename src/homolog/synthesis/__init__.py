"""Making shapes with exact ground truth: people of any build in any pose, each with a mesh of its own."""

from homolog.synthesis.body_model import BodyModel
from homolog.synthesis.people import MeshedBody, PeopleSettings, Person, make_person, meshed
from homolog.synthesis.people_folder import PeopleFolder, write_shape_files
from homolog.synthesis.production import synthesize_people
from homolog.synthesis.remeshing import MeshSettings

__all__ = [
    "BodyModel",
    "MeshSettings",
    "MeshedBody",
    "PeopleFolder",
    "PeopleSettings",
    "Person",
    "make_person",
    "meshed",
    "synthesize_people",
    "write_shape_files",
]
