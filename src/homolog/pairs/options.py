"""What a user says of the two shapes of a match, decided once."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Annotated, Any

from homolog.core.choices import AsCloud, KeepClutter, Mirror, Orient, Parts, Side, Up, UseProxy
from homolog.core.errors import ArgumentError
from homolog.core.settings import Positive, Settings
from homolog.pairs.landmarks import LandmarkPairs
from homolog.pairs.masks import Mask, mask_of

SIDES: tuple[Side, Side] = ("source", "target")


@dataclass(frozen=True, kw_only=True)
class PairOptions(Settings):
    """What is known of two shapes before they are matched.

    Args:
        as_cloud: which of the two to use without its faces.
        partial: which of the two, if any, is a part of a shape like the other; ``"both"`` for two parts that overlap.
            Points that have no counterpart then get -1: of the full shape, or of both parts.
        partial_scale: what the partial shape's lengths are multiplied by to be in the full shape's units: 0.001 for a
            partial shape in millimetres and a full one in metres. Of two parts, those of the target to be in the
            source's.
        pre_aligned: the partial shape is already aligned with the other one; otherwise its pose does not count.
        source_up: which axis of the source points up.
        target_up: which axis of the target.
        orient: ``"auto"`` finds which way round the shapes are, ``"given"`` trusts their coordinates.
        mirror: which of the two is a mirror image of what it should be, if one is, and is reflected first. ``"auto"``
            reflects the source where both are found to be mirror images of each other, full shapes in one pose.
        clutter: ``"remove"`` sets apart outliers, planes in the background, other objects, and parts that only one of
            two full shapes has; their points get -1. ``"keep"`` takes them for parts of the shapes.
        proxy: ``"auto"`` matches one closed surface around a mesh in its place where the mesh is in loose shells; see
            ``ProxySettings``. ``"always"`` does so for all meshes, ``"never"`` for none.
        strict: fail if a shape needs repair or a warning would be issued.
        landmarks: points that are known to correspond: ``LandmarkPairs``, or two arrays, of the source and the target,
            of indices (p,) or positions in the files' coordinates (p, 3).
        source_mask: how much each point of the source counts: a file that ``read_mask`` reads, or truth values or
            numbers from 0, one for each point. Points with 0 are set apart, such as teeth, a base or a scan's edge:
            they get -1, and no point is mapped to them. Others count by their number where maps are refined, and in
            ``registration``.
        target_mask: likewise of the target.

    Raises:
        ArgumentError: if a word is none of those allowed, or an option needs a partial shape and there is none.

    Examples:
        >>> from homolog.pairs import PairOptions
        >>> PairOptions(partial="source", partial_scale=0.001).is_cloud("source")
        False
    """

    as_cloud: AsCloud | None = None
    partial: Parts | None = None
    partial_scale: Annotated[Positive, "and finite"] = 1.0
    pre_aligned: bool = False
    source_up: Up = "y"
    target_up: Up = "y"
    orient: Orient = "auto"
    mirror: Mirror | None = None
    clutter: KeepClutter = "remove"
    proxy: UseProxy = "auto"
    strict: bool = False
    landmarks: Annotated[LandmarkPairs, "or two arrays, of indices or positions"] | None = None
    source_mask: Annotated[Mask, "or an array, or a file"] | None = None
    target_mask: Annotated[Mask, "or an array, or a file"] | None = None

    def __post_init__(self) -> None:
        given: Any = self.landmarks
        if isinstance(given, tuple | list) and len(given) == 2:
            object.__setattr__(self, "landmarks", LandmarkPairs(*given))
        for side in SIDES:
            object.__setattr__(self, f"{side}_mask", mask_of(self.mask(side), f"{side}_mask"))
        super().__post_init__()

    def check(self) -> None:
        """Refuse what is about a partial shape where there is none."""
        if self.partial is None:
            for name, unset in (("partial_scale", 1), ("pre_aligned", False)):
                if getattr(self, name) != unset:
                    raise ArgumentError(
                        f"{name} is {getattr(self, name)!r}, but neither shape is partial; say which one is by "
                        "partial='source', partial='target' or partial='both'"
                    )

    def is_cloud(self, side: Side) -> bool:
        """Whether a shape is used without its faces."""
        return self.as_cloud in (side, "both")

    def is_partial(self, side: Side) -> bool:
        """Whether a shape is partial."""
        return self.partial in (side, "both")

    def mask(self, side: Side) -> Mask | None:
        """How much the points of a shape count; None where all count alike."""
        return self.source_mask if side == "source" else self.target_mask

    def to_dict(self) -> dict[str, Any]:
        """For reports: all but the masks, which have a number for each point."""
        return {name: value for name, value in asdict(self).items() if not name.endswith("_mask")}

    def up(self, side: Side) -> Up:
        """Which axis of a shape points up."""
        return self.source_up if side == "source" else self.target_up
