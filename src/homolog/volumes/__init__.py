"""Shapes from volumes: surfaces of segmentation masks and of point clouds, and outlines in slices of a mask."""

from homolog.volumes.mask import Mask
from homolog.volumes.outlines import slice_cloud
from homolog.volumes.reading import read_mask
from homolog.volumes.reconstruction import reconstruct_surface
from homolog.volumes.surface import mask_surface
from homolog.volumes.wrapping import wrapping_surface

__all__ = ["Mask", "mask_surface", "read_mask", "reconstruct_surface", "slice_cloud", "wrapping_surface"]
