"""What a shape is: reading, writing, checking and repairing meshes and point clouds."""

from homolog.core.choices import Up
from homolog.shapes.checking import Finding, Report, check
from homolog.shapes.reading import READABLE, VOLUMES, check_suffix, files_of_shape, read_hashed_shape, read_shape
from homolog.shapes.repairing import Repaired, drawable, repair
from homolog.shapes.sampling import add_noise, farthest_points
from homolog.shapes.shape import FEWEST_POINTS, Modality, Shape
from homolog.shapes.topology import components, face_areas, face_vectors
from homolog.shapes.upright import rotation_about, stand_upright, upright_rotation
from homolog.shapes.writing import WRITABLE, write_shape

__all__ = [
    "FEWEST_POINTS",
    "READABLE",
    "VOLUMES",
    "WRITABLE",
    "Finding",
    "Modality",
    "Repaired",
    "Report",
    "Shape",
    "Up",
    "add_noise",
    "check",
    "check_suffix",
    "components",
    "drawable",
    "face_areas",
    "face_vectors",
    "farthest_points",
    "files_of_shape",
    "read_hashed_shape",
    "read_shape",
    "repair",
    "rotation_about",
    "stand_upright",
    "upright_rotation",
    "write_shape",
]
