"""Laplacian, gradient, spectrum, geodesics, and Operators: all of a shape's operators, computed once, cached."""

from homolog.core.caches import cache_folder
from homolog.geometry.basis import Basis
from homolog.geometry.cache import OperatorCache
from homolog.geometry.geodesics import edge_graph, pair_distances
from homolog.geometry.laplacian import CLOUD_NEIGHBOURS, LaplacianKind, cloud_laplacian, mesh_laplacian
from homolog.geometry.operators import Operators, OperatorSettings, compute_operators
from homolog.geometry.scale import Frame, cloud_area, surface_area, unit_frame
from homolog.geometry.spectrum import Spectrum, lowest_eigenpairs
from homolog.geometry.surface import Ground, Pieces, Places, Surface, closest_weights, split_long, unit

__all__ = [
    "CLOUD_NEIGHBOURS",
    "Basis",
    "Frame",
    "Ground",
    "LaplacianKind",
    "OperatorCache",
    "OperatorSettings",
    "Operators",
    "Pieces",
    "Places",
    "Spectrum",
    "Surface",
    "cache_folder",
    "closest_weights",
    "cloud_area",
    "cloud_laplacian",
    "compute_operators",
    "edge_graph",
    "lowest_eigenpairs",
    "mesh_laplacian",
    "pair_distances",
    "split_long",
    "surface_area",
    "unit",
    "unit_frame",
]
