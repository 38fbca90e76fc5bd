"""What a shape is: reading, writing, checking and repairing meshes and point clouds."""

from homolog.core.choices import Up
from homolog.shapes.checking import Report, check
from homolog.shapes.demo import demo_shapes
from homolog.shapes.finding import Finding
from homolog.shapes.foreign import as_shape
from homolog.shapes.formats import folder_suffixes, readable_suffixes, register_format, writable_suffixes
from homolog.shapes.reading import VOLUMES, check_suffix, files_of_shape, read_hashed_shape, read_shape
from homolog.shapes.repairing import Repaired, drawable, repair
from homolog.shapes.sampling import add_noise, farthest_points
from homolog.shapes.shape import FEWEST_POINTS, Modality, Shape
from homolog.shapes.topology import components, cross_products, face_areas, face_vectors, half_edges, mesh_components
from homolog.shapes.upright import mirrored, rotation_about, stand_upright, upright_rotation
from homolog.shapes.writing import write_shape

__all__ = [
    "FEWEST_POINTS",
    "VOLUMES",
    "Finding",
    "Modality",
    "Repaired",
    "Report",
    "Shape",
    "Up",
    "add_noise",
    "as_shape",
    "check",
    "check_suffix",
    "components",
    "cross_products",
    "demo_shapes",
    "drawable",
    "face_areas",
    "face_vectors",
    "farthest_points",
    "files_of_shape",
    "folder_suffixes",
    "half_edges",
    "mesh_components",
    "mirrored",
    "read_hashed_shape",
    "read_shape",
    "readable_suffixes",
    "register_format",
    "repair",
    "rotation_about",
    "stand_upright",
    "upright_rotation",
    "writable_suffixes",
    "write_shape",
]
