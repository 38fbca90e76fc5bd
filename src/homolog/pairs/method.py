"""What a method is: it takes a pair of preprocessed shapes and gives point maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from homolog.core.errors import ArgumentError
from homolog.pairs.options import SIDES, PairOptions

if TYPE_CHECKING:
    from homolog.pairs.pair import Pair, PointMaps
    from homolog.pairs.preprocessing import PreprocessedShape


@dataclass(frozen=True, kw_only=True)
class Supports:
    """What a method can do, and what it needs.

    Args:
        clouds: it can match shapes without faces.
        partial: it can match a partial shape with its full one.
        parts: it can match two partial shapes that overlap; where they do is decided afterwards.
        needs_features: it compares the features of an extractor; otherwise none are computed.
        refinement: its maps are near-isometric, so that ZoomOut can refine them, guided by features if there are any.
        small_turns: it finds by itself by which angle below 45 degrees one shape is turned against the other, so that
            only larger turns are made before it, and those that bring the shapes as near each other as copies.
    """

    clouds: bool = True
    partial: bool = True
    parts: bool = False
    needs_features: bool = True
    refinement: bool = True
    small_turns: bool = False


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


def check_supported(method: Method, options: PairOptions, *shapes: PreprocessedShape) -> None:
    """Refuse a partial shape where the method knows full shapes alone, and a cloud where it knows meshes alone.

    Args:
        method: what is to find maps.
        options: what is known of both shapes.
        *shapes: both, once they are preprocessed: a file may be a cloud, and repair may leave one.

    Raises:
        ArgumentError: naming the method, and what to give in its place.
    """
    if options.partial == "both" and not method.supports.parts:
        raise ArgumentError(
            f"partial is 'both', but the method {method.name!r} matches no two parts; use 'auto' or "
            "'nearest-features', with weights"
        )
    if options.partial in SIDES and not method.supports.partial:
        raise ArgumentError(
            f"partial is {options.partial!r}, but the method {method.name!r} matches full shapes; "
            "use 'auto' for partial ones"
        )
    if method.supports.clouds:
        return
    clouds = [f"{shape.name} is a cloud" for shape in shapes if shape.modality == "cloud"]
    if options.as_cloud is not None:
        clouds = [f"as_cloud is {options.as_cloud!r}"]
    if clouds:
        raise ArgumentError(f"{clouds[0]}, but the method {method.name!r} matches meshes; use 'auto' for clouds")
