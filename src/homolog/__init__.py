"""Homolog: dense correspondences between non-rigid 3D shapes.

Meshes and point clouds, full or partial, in any mix::

    import homolog

    source, target = homolog.read_shape("a.ply"), homolog.read_shape("b.obj")
    matcher = homolog.Matcher.from_weights()  # pretrained; or give a file
    found = matcher.match(source, target)
    found.source_to_target  # for each source point the index of its target point

The names below and the packages (``homolog.maps``, ``homolog.transfer``, ...) are imported when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from homolog.core.lazy import lazy_names

if TYPE_CHECKING:
    from homolog import core as core
    from homolog import datasets as datasets
    from homolog import evaluation as evaluation
    from homolog import features as features
    from homolog import fitting as fitting
    from homolog import geometry as geometry
    from homolog import maps as maps
    from homolog import matching as matching
    from homolog import methods as methods
    from homolog import pairs as pairs
    from homolog import reproduction as reproduction
    from homolog import serving as serving
    from homolog import shape_models as shape_models
    from homolog import shapes as shapes
    from homolog import statistics as statistics
    from homolog import symmetries as symmetries
    from homolog import synthesis as synthesis
    from homolog import testing as testing
    from homolog import training as training
    from homolog import transfer as transfer
    from homolog import viewing as viewing
    from homolog import volumes as volumes
    from homolog.core.errors import HomologError
    from homolog.core.memory import get_working_memory, set_working_memory, working_memory
    from homolog.core.threads import tune_threads
    from homolog.features import load_weights
    from homolog.geometry import OperatorCache, Operators, compute_operators
    from homolog.maps import functional_map, point_map_from_functional_map, resolvent_mask, sinkhorn_matches
    from homolog.matching import Match, Matcher, match
    from homolog.pairs import MatcherSettings, PairOptions
    from homolog.shapes import (
        Report,
        Shape,
        as_shape,
        check,
        demo_shapes,
        read_shape,
        repair,
        stand_upright,
        write_shape,
    )
    from homolog.symmetries import symmetry

__all__ = [
    "HomologError",
    "Match",
    "Matcher",
    "MatcherSettings",
    "OperatorCache",
    "Operators",
    "PairOptions",
    "Report",
    "Shape",
    "as_shape",
    "check",
    "compute_operators",
    "demo_shapes",
    "functional_map",
    "get_working_memory",
    "load_weights",
    "match",
    "point_map_from_functional_map",
    "read_shape",
    "repair",
    "resolvent_mask",
    "set_working_memory",
    "sinkhorn_matches",
    "stand_upright",
    "symmetry",
    "tune_threads",
    "working_memory",
    "write_shape",
]

_MODULES = {
    "Match": "matching",
    "HomologError": "core.errors",
    "Matcher": "matching",
    "MatcherSettings": "pairs",
    "OperatorCache": "geometry",
    "Operators": "geometry",
    "PairOptions": "pairs",
    "Report": "shapes",
    "Shape": "shapes",
    "as_shape": "shapes",
    "check": "shapes",
    "compute_operators": "geometry",
    "demo_shapes": "shapes",
    "functional_map": "maps",
    "get_working_memory": "core.memory",
    "load_weights": "features",
    "match": "matching",
    "point_map_from_functional_map": "maps",
    "read_shape": "shapes",
    "repair": "shapes",
    "resolvent_mask": "maps",
    "set_working_memory": "core.memory",
    "sinkhorn_matches": "maps",
    "stand_upright": "shapes",
    "symmetry": "symmetries",
    "tune_threads": "core.threads",
    "working_memory": "core.memory",
    "write_shape": "shapes",
}
_PACKAGES = (
    "core",
    "datasets",
    "evaluation",
    "features",
    "fitting",
    "geometry",
    "maps",
    "matching",
    "methods",
    "pairs",
    "reproduction",
    "serving",
    "shape_models",
    "shapes",
    "statistics",
    "symmetries",
    "synthesis",
    "testing",
    "training",
    "transfer",
    "viewing",
    "volumes",
)
_public = lazy_names(__name__, _MODULES)


def __getattr__(name: str) -> Any:
    """Import a public name, or a package, when it is first used."""
    if name == "__version__":
        return import_module("homolog.core.versions").version_of("homolog")
    if name in _PACKAGES:
        return import_module(f"homolog.{name}")
    return _public(name)


def __dir__() -> list[str]:
    """All names, loaded or not."""
    return sorted({*globals(), *__all__, *_PACKAGES, "__version__"})
