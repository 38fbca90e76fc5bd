"""Shapes made for training and tests: parts and views of complete ones, with the way back, and what scanners do."""

from homolog.synthesis.degradation import add_outliers, thin
from homolog.synthesis.part import Part
from homolog.synthesis.parts import cut, pierce
from homolog.synthesis.view_set import write_view_set
from homolog.synthesis.views import Camera, View, ViewSettings, drawn_camera, view, view_from

__all__ = [
    "Camera",
    "Part",
    "View",
    "ViewSettings",
    "add_outliers",
    "cut",
    "drawn_camera",
    "pierce",
    "thin",
    "view",
    "view_from",
    "write_view_set",
]
