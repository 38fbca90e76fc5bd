"""Homolog: dense correspondences between non-rigid 3D shapes.

Meshes and point clouds, whole or partial, in any mix::

    import homolog

    source, target = homolog.read_shape("a.ply"), homolog.read_shape("b.obj")
    matcher = homolog.Matcher.from_weights()  # those for people; or give a file
    found = matcher.match(source, target)
    found.source_to_target  # for each source point the index of its target point

What is named here is loaded when it is first used, so that the command line answers at once.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

# Idle threads that spin for long make small matrix products many times slower on a machine with other work; ones that
# sleep at once make them half as fast on an idle machine. OpenMP reads this once, when PyTorch is first imported;
# whoever has chosen otherwise, or imported PyTorch before, is left alone. The second is for GNU's OpenMP, some 10 us.
if "OMP_WAIT_POLICY" not in os.environ:
    os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
    os.environ.setdefault("GOMP_SPINCOUNT", "10000")
# Memory in large pages where the system has them: fresh memory costs as much as the matrix product that fills it.
os.environ.setdefault("THP_MEM_ALLOC_ENABLE", "1")

if TYPE_CHECKING:
    from homolog.core.errors import HomologError
    from homolog.core.memory import get_working_memory, set_working_memory, working_memory
    from homolog.features import load_weights
    from homolog.geometry import OperatorCache, Operators, compute_operators
    from homolog.maps import functional_map, point_map_from_functional_map, resolvent_mask, sinkhorn_matches
    from homolog.matching import Correspondence, Matcher, MatcherSettings
    from homolog.shapes import Report, Shape, check, read_shape, repair, stand_upright, write_shape

__all__ = [
    "Correspondence",
    "HomologError",
    "Matcher",
    "MatcherSettings",
    "OperatorCache",
    "Operators",
    "Report",
    "Shape",
    "check",
    "compute_operators",
    "functional_map",
    "get_working_memory",
    "load_weights",
    "point_map_from_functional_map",
    "read_shape",
    "repair",
    "resolvent_mask",
    "set_working_memory",
    "sinkhorn_matches",
    "stand_upright",
    "working_memory",
    "write_shape",
]

_HOMES = ("core.errors", "core.memory", "shapes", "geometry", "maps", "features", "matching")


def __getattr__(name: str) -> Any:
    """Find a public name in the package that it comes from."""
    if name == "__version__":
        return import_module("homolog.core.versions").version_of("homolog")
    if name in __all__:
        for home in _HOMES:
            module = import_module(f"homolog.{home}")
            if hasattr(module, name):
                return getattr(module, name)
    raise AttributeError(f"module 'homolog' has no attribute {name!r}")


def __dir__() -> list[str]:
    """All names, loaded or not."""
    return sorted({*globals(), *__all__, "__version__"})
