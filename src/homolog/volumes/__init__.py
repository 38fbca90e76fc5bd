"""Volumes to shapes: the surface of what a segmentation mask marks, and outlines in some of its slices."""

from homolog.volumes.mask import Mask
from homolog.volumes.outlines import slice_cloud
from homolog.volumes.reading import read_mask
from homolog.volumes.surface import mask_surface

__all__ = ["Mask", "mask_surface", "read_mask", "slice_cloud"]
