"""Transfer along a match: smooth maps; arrays, labels, landmarks, colours, textures, skins, blend shapes."""

from homolog.core.choices import TEXTURE_SIZE, System
from homolog.geometry.projection import SurfacePoints, SurfaceProjector
from homolog.transfer.animations import Animation, Track
from homolog.transfer.appearance import NO_COLOUR, Appearance, Checkerboard, Texture, read_appearance
from homolog.transfer.atlas import Atlas, bake_texture, unwrap
from homolog.transfer.blend_shapes import BlendShapes, read_blend_shapes
from homolog.transfer.deformation_transfer import DeformationTransfer
from homolog.transfer.delivery import FAR_LANDMARK, OUTPUT_NAMES, Delivery, Kind, check_output_names
from homolog.transfer.export import (
    PARTICLES,
    PointDistances,
    field_of_match,
    point_distances,
    write_distance_table,
    write_distances,
    write_particles,
)
from homolog.transfer.glb import png, write_glb
from homolog.transfer.inputs import Original, read_array, read_labels, read_original
from homolog.transfer.landmark_pairs import read_landmark_pairs
from homolog.transfer.landmarks import LANDMARK_SUFFIXES, Landmarks, read_landmarks, system_of
from homolog.transfer.obj import write_obj
from homolog.transfer.skin import Skin, read_skin
from homolog.transfer.smooth_map import SurfaceMap, surface_map
from homolog.transfer.transfer import Transfer
from homolog.transfer.untangling import untangled

__all__ = [
    "FAR_LANDMARK",
    "LANDMARK_SUFFIXES",
    "NO_COLOUR",
    "OUTPUT_NAMES",
    "PARTICLES",
    "TEXTURE_SIZE",
    "Animation",
    "Appearance",
    "Atlas",
    "BlendShapes",
    "Checkerboard",
    "DeformationTransfer",
    "Delivery",
    "Kind",
    "Landmarks",
    "Original",
    "PointDistances",
    "Skin",
    "SurfaceMap",
    "SurfacePoints",
    "SurfaceProjector",
    "System",
    "Texture",
    "Track",
    "Transfer",
    "bake_texture",
    "check_output_names",
    "field_of_match",
    "png",
    "point_distances",
    "read_appearance",
    "read_array",
    "read_blend_shapes",
    "read_labels",
    "read_landmark_pairs",
    "read_landmarks",
    "read_original",
    "read_skin",
    "surface_map",
    "system_of",
    "untangled",
    "unwrap",
    "write_distance_table",
    "write_distances",
    "write_glb",
    "write_obj",
    "write_particles",
]
