"""A match to look at: what is drawn and marked, in a live viewer or in one self-contained page."""

from homolog.viewing.addresses import address_of, free_port, listener
from homolog.viewing.colours import Ramp, principal_colours
from homolog.viewing.contact_sheet import MOST_TILES, Tile, contact_sheet
from homolog.viewing.layers import Layer, confidence_layer, error_layer, feature_layer, matched_layer
from homolog.viewing.live import LiveView
from homolog.viewing.measuring import map_errors, pair_features
from homolog.viewing.modes_page import ModesScene, modes_page_of
from homolog.viewing.page import page_of, page_style, write_page
from homolog.viewing.picking import Ray
from homolog.viewing.picture import check_picture, picture_of, write_picture
from homolog.viewing.png import write_png
from homolog.viewing.scene import SIDES, Body, Mark, Scene, Shown, scene_of

__all__ = [
    "MOST_TILES",
    "SIDES",
    "Body",
    "Layer",
    "LiveView",
    "Mark",
    "ModesScene",
    "Ramp",
    "Ray",
    "Scene",
    "Shown",
    "Tile",
    "address_of",
    "check_picture",
    "confidence_layer",
    "contact_sheet",
    "error_layer",
    "feature_layer",
    "free_port",
    "listener",
    "map_errors",
    "matched_layer",
    "modes_page_of",
    "page_of",
    "page_style",
    "pair_features",
    "picture_of",
    "principal_colours",
    "scene_of",
    "write_page",
    "write_picture",
    "write_png",
]
