"""Methods that are made of one function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from homolog.core.errors import ArgumentError
from homolog.core.reprs import function_name
from homolog.features import FeatureExtractor
from homolog.pairs import MatcherSettings, Method, Pair, PointMaps, Supports


@dataclass(frozen=True)
class FunctionMethod:
    """A method made of one function.

    Args:
        name: what users call it by.
        function: takes a ``Pair`` and gives ``PointMaps``.
        supports: what it can do, and what it needs.
        features: makes the features that it compares from the settings, where it brings its own.

    Examples:
        >>> from homolog.maps import nearest_neighbour
        >>> from homolog.methods import FunctionMethod, Supports
        >>> from homolog.pairs import PointMaps
        >>> def nearest_points(pair):
        ...     x, y = pair.x.operators.points, pair.y.operators.points
        ...     return PointMaps(nearest_neighbour(x, y).index, nearest_neighbour(y, x).index)
        >>> method = FunctionMethod("nearest-points", nearest_points, Supports(needs_features=False, refinement=False))
    """

    name: str
    function: Callable[[Pair], PointMaps]
    supports: Supports = field(default_factory=Supports)
    features: Callable[[MatcherSettings], FeatureExtractor] | None = None

    def __call__(self, pair: Pair, /) -> PointMaps:
        """Point maps between the repaired shapes of a pair."""
        return self.function(pair)


def as_method(given: Any) -> Method:
    """Make a method of a ``Method``, or of a function of a ``Pair``.

    The maps of a bare function are taken as they are, without refinement, and it gets the features of an extractor. Its
    attribute ``supports``, where it has one, says otherwise.

    Raises:
        ArgumentError: if it is neither, or its ``supports`` is no ``Supports``.

    Examples:
        >>> from homolog.methods import Supports, as_method
        >>> def nearest_points(pair): ...
        >>> as_method(nearest_points).supports.refinement
        False
        >>> nearest_points.supports = Supports(needs_features=False)
        >>> as_method(nearest_points).supports.refinement
        True
    """
    if not callable(given):
        raise ArgumentError(
            f"method is a {type(given).__name__}, but must be the name of a method, or a function of a "
            "homolog.pairs.Pair"
        )
    if isinstance(given, Method):
        method = given
    else:
        declared = getattr(given, "supports", Supports(refinement=False))
        method = FunctionMethod(function_name(given), given, declared, getattr(given, "features", None))
    supports: object = method.supports
    if not isinstance(supports, Supports):
        kind = type(supports).__name__
        raise ArgumentError(f"supports of method {method.name!r} is a {kind}, but must be homolog.methods.Supports")
    return method
