"""What a method is: it takes a pair of preprocessed shapes and gives point maps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from homolog.core.errors import ArgumentError
from homolog.features import FeatureExtractor
from homolog.pairs import MatcherSettings, Pair, PointMaps


@dataclass(frozen=True, kw_only=True)
class Supports:
    """What a method can do, and what it needs.

    Args:
        clouds: it can match shapes without faces.
        partial: it can match a partial shape with its full one.
        needs_features: it compares the features of an extractor; otherwise none are computed.
        refinement: its maps are near-isometric, so that ZoomOut can refine them.
    """

    clouds: bool = True
    partial: bool = True
    needs_features: bool = True
    refinement: bool = True


@runtime_checkable
class Method(Protocol):
    """A way to find point maps.

    A method is called with a ``Pair``, of which it uses ``x`` and ``y`` (the source and the target, or the full and the
    partial shape), their operators and features, and ``settings``. It gives ``PointMaps`` in the indices of the
    operators: every point of each shape has a counterpart. Which points have none is decided afterwards.
    """

    @property
    def name(self) -> str:
        """What users call it by."""
        ...

    @property
    def supports(self) -> Supports:
        """What it can do, and what it needs."""
        ...

    def __call__(self, pair: Pair, /) -> PointMaps:
        """Point maps between the repaired shapes of a pair."""
        ...


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
    supports: Supports = Supports()
    features: Callable[[MatcherSettings], FeatureExtractor] | None = None

    def __call__(self, pair: Pair, /) -> PointMaps:
        """Point maps between the repaired shapes of a pair."""
        return self.function(pair)


def as_method(given: Any) -> Method:
    """Make a method of a ``Method``, or of a function of a ``Pair``.

    Raises:
        ArgumentError: if it is neither.
    """
    if isinstance(given, Method):
        return given
    if callable(given):
        return FunctionMethod(getattr(given, "__name__", type(given).__name__), given)
    raise ArgumentError(
        f"method is a {type(given).__name__}, but must be the name of a method, or a function of a homolog.pairs.Pair"
    )
