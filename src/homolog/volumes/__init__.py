"""Shapes from volumes: surfaces of masks and clouds, outlines in slices; volumes from shapes: displacement fields."""

from homolog.volumes.displacement import (
    FIELD_SUFFIXES,
    DisplacementField,
    ScatteredInterpolant,
    check_field_file,
    displacement_field,
    write_displacement_field,
)
from homolog.volumes.mask import Mask
from homolog.volumes.outlines import slice_cloud
from homolog.volumes.reading import read_mask
from homolog.volumes.reconstruction import reconstruct_surface
from homolog.volumes.surface import mask_surface
from homolog.volumes.wrapping import wrapping_surface

__all__ = [
    "FIELD_SUFFIXES",
    "DisplacementField",
    "Mask",
    "ScatteredInterpolant",
    "check_field_file",
    "displacement_field",
    "mask_surface",
    "read_mask",
    "reconstruct_surface",
    "slice_cloud",
    "wrapping_surface",
    "write_displacement_field",
]
