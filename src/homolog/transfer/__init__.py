"""Carrying things from one shape to another along a match: smooth maps between surfaces, and what goes along them."""

from homolog.core.choices import TEXTURE_SIZE, System
from homolog.transfer.appearance import NO_COLOUR, Appearance, Checkerboard, Texture, read_appearance
from homolog.transfer.atlas import Atlas, painted, unwrapped
from homolog.transfer.carrier import Carrier
from homolog.transfer.delivery import OWN_NAMES, Delivery, Kind, check_names
from homolog.transfer.glb import png, write_glb
from homolog.transfer.inputs import Original, read_array, read_labels, read_original
from homolog.transfer.landmarks import LANDMARK_SUFFIXES, Landmarks, read_landmarks
from homolog.transfer.obj import write_obj
from homolog.transfer.places import PlaceFinder, ShapePlaces
from homolog.transfer.skin import Skin, read_skin
from homolog.transfer.smooth_map import SurfaceMap, surface_map
from homolog.transfer.untangling import untangled

__all__ = [
    "LANDMARK_SUFFIXES",
    "NO_COLOUR",
    "OWN_NAMES",
    "TEXTURE_SIZE",
    "Appearance",
    "Atlas",
    "Carrier",
    "Checkerboard",
    "Delivery",
    "Kind",
    "Landmarks",
    "Original",
    "PlaceFinder",
    "ShapePlaces",
    "Skin",
    "SurfaceMap",
    "System",
    "Texture",
    "check_names",
    "painted",
    "png",
    "read_appearance",
    "read_array",
    "read_labels",
    "read_landmarks",
    "read_original",
    "read_skin",
    "surface_map",
    "untangled",
    "unwrapped",
    "write_glb",
    "write_obj",
]
