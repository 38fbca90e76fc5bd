"""How shapes of a collection are matched to its template."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Annotated, Any

from homolog.core.choices import KeepClutter, Orient, UseProxy
from homolog.core.settings import CountOrZero, Settings
from homolog.pairs import Mask, PairOptions, mask_of
from homolog.shapes import Up


@dataclass(frozen=True)
class ShapeModelSettings(Settings):
    """How shapes are matched to the template, besides the matcher's own settings.

    Args:
        template_up: the axis of the template that points up.
        shapes_up: the axis of the shapes that points up.
        template_as_cloud: match without the template's faces.
        shapes_as_cloud: match without the shapes' faces.
        orient: ``"auto"`` finds which way round the shapes are, ``"given"`` trusts their coordinates.
        clutter: ``"remove"`` sets apart what does not belong to the shapes, ``"keep"`` takes it for parts of them. The
            template is taken as it is.
        proxy: whether a surface around a mesh is matched in its place: ``"auto"`` where the mesh is in loose shells or
            large, ``"always"``, or ``"never"``; of the template as well.
        strict: refuse shapes that need repair or would get a warning.
        adapt: steps for which the weights are trained on all shapes at once; 0 for none.
        template_mask: how much each of the template's points counts; those with 0 are not matched, and follow the
            others. A mask, an array, or a file that ``homolog.pairs.read_mask`` reads.
    """

    template_up: Up = "y"
    shapes_up: Up = "y"
    template_as_cloud: bool = False
    shapes_as_cloud: bool = False
    orient: Orient = "auto"
    clutter: KeepClutter = "remove"
    proxy: UseProxy = "auto"
    strict: bool = False
    adapt: CountOrZero = 0
    # The folder's manifest has its hash, so that settings that are alike otherwise have one mask.
    template_mask: Annotated[Mask, "or an array, or a file"] | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "template_mask", mask_of(self.template_mask, "template_mask"))
        super().__post_init__()

    def pair_options(self) -> PairOptions:
        """Of the template with a shape, both of them preprocessed."""
        return PairOptions(orient=self.orient, clutter=self.clutter, proxy=self.proxy)

    def to_dict(self) -> dict[str, Any]:
        """For reports: all but the mask, which has a number for each point."""
        return {name: value for name, value in asdict(self).items() if name != "template_mask"}
