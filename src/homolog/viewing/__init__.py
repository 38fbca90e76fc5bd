"""A match to look at: as one self-contained page, as a picture, and in notebooks; contact sheets of many shapes."""

from homolog.pairs import SIDES
from homolog.viewing.colours import Ramp, principal_colours
from homolog.viewing.contact_sheet import MOST_TILES, Tile, contact_sheet
from homolog.viewing.guiding import Guide, guide_of
from homolog.viewing.layers import Layer, confidence_layer, error_layer, feature_layer, heat_layer, matched_layer
from homolog.viewing.measuring import map_errors, pair_features
from homolog.viewing.modes_page import ModesScene, modes_page_of
from homolog.viewing.notebook import notebook_html, plot
from homolog.viewing.page import check_page, page_of, page_style, write_page
from homolog.viewing.picture import check_picture, picture_of, write_picture
from homolog.viewing.png import write_png
from homolog.viewing.scene import Body, Scene, scene_of
from homolog.viewing.ways import scene_of_all

__all__ = [
    "MOST_TILES",
    "SIDES",
    "Body",
    "Guide",
    "Layer",
    "ModesScene",
    "Ramp",
    "Scene",
    "Tile",
    "check_page",
    "check_picture",
    "confidence_layer",
    "contact_sheet",
    "error_layer",
    "feature_layer",
    "guide_of",
    "heat_layer",
    "map_errors",
    "matched_layer",
    "modes_page_of",
    "notebook_html",
    "page_of",
    "page_style",
    "pair_features",
    "picture_of",
    "plot",
    "principal_colours",
    "scene_of",
    "scene_of_all",
    "write_page",
    "write_picture",
    "write_png",
]
