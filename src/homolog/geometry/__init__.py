"""Discrete differential geometry of one shape: Laplacian, gradient, spectrum, geodesics, and Operators of it all."""

from homolog.core.caches import cache_folder
from homolog.geometry.basis import Basis, some_points
from homolog.geometry.cache import OperatorCache
from homolog.geometry.clutter import CLUTTER_RULES, EXTRA_PART, MASKED, Clutter, find_clutter, restricted, set_apart
from homolog.geometry.clutter_settings import ClutterSettings
from homolog.geometry.geodesics import Geodesics, distances_from, edge_graph, geodesic_distances, pair_distances
from homolog.geometry.laplacian import CLOUD_NEIGHBOURS, LaplacianKind, cloud_laplacian, mesh_laplacian
from homolog.geometry.operators import Operators, OperatorSettings, compute_operators
from homolog.geometry.outliers import find_outliers
from homolog.geometry.sampling import areas_by_density, lies_in_lines
from homolog.geometry.scale import Frame, cloud_area, surface_area, unit_frame
from homolog.geometry.spectrum import Spectrum, lowest_eigenpairs
from homolog.geometry.surface import (
    BarycentricPoints,
    ReferenceSurface,
    SplitSurface,
    Surface,
    closest_weights,
    outward,
    split_long,
    unit,
)

__all__ = [
    "CLOUD_NEIGHBOURS",
    "CLUTTER_RULES",
    "EXTRA_PART",
    "MASKED",
    "BarycentricPoints",
    "Basis",
    "Clutter",
    "ClutterSettings",
    "Frame",
    "Geodesics",
    "LaplacianKind",
    "OperatorCache",
    "OperatorSettings",
    "Operators",
    "ReferenceSurface",
    "Spectrum",
    "SplitSurface",
    "Surface",
    "areas_by_density",
    "cache_folder",
    "closest_weights",
    "cloud_area",
    "cloud_laplacian",
    "compute_operators",
    "distances_from",
    "edge_graph",
    "find_clutter",
    "find_outliers",
    "geodesic_distances",
    "lies_in_lines",
    "lowest_eigenpairs",
    "mesh_laplacian",
    "outward",
    "pair_distances",
    "restricted",
    "set_apart",
    "some_points",
    "split_long",
    "surface_area",
    "unit",
    "unit_frame",
]
