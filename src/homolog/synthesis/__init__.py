"""Making shapes with exact ground truth: people of any build in any pose, each with a mesh of its own."""

from homolog.synthesis.body_model import BodyModel
from homolog.synthesis.people import PeopleSettings, Person, make_person
from homolog.synthesis.people_folder import PeopleFolder
from homolog.synthesis.production import synthesize_people
from homolog.synthesis.remeshing import MeshSettings

__all__ = ["BodyModel", "MeshSettings", "PeopleFolder", "PeopleSettings", "Person", "make_person", "synthesize_people"]
