"""What to evaluate: which shapes, as what, and how they are disturbed."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from homolog.core.choices import Background, KeepClutter, Modalities, Orient, OutlierKind, Side, Split, Turn, UseProxy
from homolog.core.errors import ArgumentError
from homolog.core.settings import Count, CountOrZero, NotNegative, Positive, Settings
from homolog.pairs.landmarks import MOST_LANDMARKS
from homolog.shapes import rotation_about

PartialPairs = Annotated[bool, "or 'both'"] | Literal["both"]
"""Whether the target of each pair is partial, or both shapes are."""


@dataclass(frozen=True)
class Protocol(Settings):
    """What to evaluate.

    Args:
        modality: of source and target.
        split: which shapes.
        pairs_file: a list of pairs to use instead of the split's.
        n_pairs: how many of the pairs to draw at random, none of a shape with itself; by default all are used.
        partial: whether each target is a part of a shape like its source, in the same units; it takes its scale then.
            ``"both"``: both are parts, which overlap.
        part_units: what the lengths of each target are multiplied by before anything sees it, as those of a part in
            other units than its full shape.
        pre_aligned: whether such parts lie in the coordinates of their sources, about where they belong.
        noise: standard deviation of isotropic noise on the points of every cloud, in units of sqrt(area); independent
            on source and target.
        outliers: number of outliers added to every cloud, relative to its points; source and target have their own.
        outlier_kind: where they lie: anywhere in the bounding box, in clusters there, or near the surface.
        background: ``"floor"`` puts every cloud on a floor with as many points.
        clutter: whether these are to be set apart before matching, or kept.
        proxy: whether a surface around a mesh is matched in its place: where it needs one, never, or always.
        turn: by which rotations the shapes are turned before anything sees them, each on its own.
        orient: whether the way round of full shapes is found, or trusted.
        landmarks: how many points of each pair's ground truth guide its match, by farthest point sampling on the source
            from a point that is drawn. The others are scored.
        seed: of the landmarks, of the noise, of the turns, of the pairs drawn, and of the order of points in sets that
            are shuffled.
    """

    modality: Modalities = "mesh"
    split: Split = "test"
    pairs_file: str | None = None
    n_pairs: Annotated[Count, "or None"] | None = None
    partial: PartialPairs = False
    part_units: Annotated[Positive, "and finite"] = 1.0
    pre_aligned: bool = False
    noise: Annotated[NotNegative, "in units of sqrt(area)"] = 0.0
    outliers: Annotated[NotNegative, "relative to the number of points"] = 0.0
    outlier_kind: OutlierKind = "box"
    background: Background = "none"
    clutter: KeepClutter = "remove"
    proxy: UseProxy = "auto"
    turn: Turn = "none"
    orient: Orient = "auto"
    landmarks: Annotated[int, Ge(0), Le(MOST_LANDMARKS)] = 0
    seed: CountOrZero = 0

    def check(self) -> None:
        """Refuse what does not fit together."""
        if self.pre_aligned and not self.partial:
            raise ArgumentError("pre_aligned is for parts, but partial is False; set it, or leave pre_aligned out")
        if self.part_units != 1 and not self.partial:
            raise ArgumentError(
                f"part_units is {self.part_units:g}, but partial is False; set it, or leave part_units out"
            )
        if self.pre_aligned and self.turn != "none":
            raise ArgumentError(
                f"turn is {self.turn!r}, but pre_aligned parts lie where they belong; leave one of them out"
            )
        added = {"noise": self.noise > 0, "outliers": self.outliers > 0, "background": self.background != "none"}
        for name in (name for name, is_used in added.items() if is_used and self.modality == "mesh"):
            raise ArgumentError(f"{name} is for clouds, but modality is 'mesh'; use 'cloud', or leave {name} out")

    @property
    def is_cluttered(self) -> bool:
        """Whether points are added that do not belong to the shapes."""
        return self.outliers > 0 or self.background != "none"

    def rotation(self, name: str) -> Float[np.ndarray, "3 3"]:
        """What a shape of this name is turned by, drawn from the seed (3, 3)."""
        random = np.random.default_rng(zlib.crc32(f"{self.seed} {name} turn".encode(errors="surrogateescape")))
        if self.turn == "any":
            return np.asarray(Rotation.random(random_state=random).as_matrix())
        return rotation_about(1, random.uniform(-180, 180) if self.turn == "vertical" else 0.0)

    def is_cloud(self, role: Side) -> bool:
        """Whether the shapes in this role lose their faces."""
        source, _, target = self.modality.partition("-to-")
        return (source if role == "source" else target or source) == "cloud"
