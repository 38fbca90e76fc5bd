"""Transfer of arrays, labels, landmarks, colours, textures, skins and blend shapes along one match."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from jaxtyping import Float, Int, Num, UInt8

from homolog.core.choices import TEXTURE_SIZE
from homolog.core.errors import ArgumentError
from homolog.core.progress import Progress, ignore
from homolog.geometry.projection import SurfaceProjector
from homolog.matching import Match
from homolog.shapes import Shape
from homolog.transfer.appearance import Appearance, Checkerboard
from homolog.transfer.atlas import Atlas, bake_texture, unwrap
from homolog.transfer.blend_shapes import BlendShapes, transfer_blend_shapes
from homolog.transfer.skin import Skin, transfer_skin
from homolog.transfer.smooth_map import SurfaceMap, surface_map


class Transfer:
    """Transfers attributes from the source of a match to its target, along a smooth map between their surfaces.

    Points without a counterpart get NaN, the label ``no_counterpart_label``, or grey.

    Args:
        result: the match; ``result.inverse()`` transfers the other way.
        source: the source as ``read_shape`` reads it, where faces must be counted as in its file; by default the
            result's own.

    Examples:
        >>> transfer = Transfer(homolog.Match.load("result"))  # doctest: +SKIP
        >>> thickness_on_target = transfer.array(thickness_on_source)  # doctest: +SKIP
    """

    def __init__(self, result: Match, *, source: Shape | None = None) -> None:
        self.found = result
        self.source = SurfaceProjector(result.source if source is None else source)
        self.target = SurfaceProjector(result.target)

    @cached_property
    def to_source(self) -> SurfaceMap:
        """The smooth map from the target's points to the source's surface."""
        return surface_map(self.target, self.source, self.found.inverse())

    @cached_property
    def to_target(self) -> SurfaceMap:
        """The smooth map from the source's points to the target's surface."""
        return surface_map(self.source, self.target, self.found)

    def array(self, values: Num[np.ndarray, "n_source ..."]) -> Float[np.ndarray, "n_target ..."]:
        """Interpolate values of the source's points at the target's points; in the same precision.

        Raises:
            ArgumentError: if there is not one row for each point.
        """
        values = self._rows(values, "values")
        found = self.to_source.surface_points.interpolate(values)
        return found.astype(values.dtype) if values.dtype.kind == "f" else found

    def labels(self, labels: Int[np.ndarray, " n_source"]) -> Int[np.ndarray, " n_target"]:
        """Transfer labels: at each target point the one with the largest weight, never a mean of several.

        Points without a counterpart get ``no_counterpart_label(labels)``.

        Raises:
            ArgumentError: if there is not one for each point.
        """
        labels = self._rows(labels, "labels")
        return self.to_source.surface_points.labels(labels, fill=no_counterpart_label(labels))

    def landmarks(self, points: Float[np.ndarray, "p 3"]) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, " p"]]:
        """Map points of the source's surface to the target's surface.

        Returns:
            The positions in the target's coordinates, NaN for points without a counterpart or a position; and the
            distance of each given point from the source's surface, in the source's coordinates.
        """
        projected = self.source.project(points)
        distances = np.linalg.norm(self.source.positions(projected) - points, axis=1)
        return self.target.positions(self.to_target.apply(projected)), distances

    def colours(self, appearance: Appearance) -> UInt8[np.ndarray, "n_target 3"]:
        """The source's colours at the target's points."""
        return appearance.colours(self.to_source.surface_points)

    def texture(
        self, appearance: Appearance | Checkerboard, *, size: int = TEXTURE_SIZE
    ) -> tuple[Atlas, UInt8[np.ndarray, "h w 3"]]:
        """Unwrap the target and bake the source's colours into its texture.

        Args:
            appearance: the source's.
            size: texels along the image's width.

        Raises:
            ArgumentError: if the target has no faces.
            MissingExtraError: if a package that makes textures is not installed.
        """
        if self.target.surface is None:
            raise ArgumentError(f"{self.target.given.name} has no faces to put a texture on; transfer colours instead")
        atlas = unwrap(self.target, size=size)
        to_source = self.to_source
        return atlas, bake_texture(atlas, self.target, lambda points: appearance.colours(to_source.apply(points)))

    def skin(self, skin: Skin) -> Skin:
        """Transfer the source's skeleton and skinning weights to the target; see ``transfer_skin``.

        Raises:
            ArgumentError: if the target has no faces.
        """
        if self.target.surface is None:
            raise ArgumentError(f"{self.target.given.name} has no faces, but a skin is for meshes")
        return transfer_skin(skin, self.to_source, self.to_target)

    def blend_shapes(self, shapes: BlendShapes, progress: Progress = ignore) -> BlendShapes:
        """Transfer the source's blend shapes to the target; see ``DeformationTransfer``.

        Args:
            shapes: the source's.
            progress: called before each.

        Raises:
            ArgumentError: if the source or the target has no faces.
        """
        return transfer_blend_shapes(shapes, self.to_source, progress)

    def _rows(self, values: np.ndarray, name: str) -> np.ndarray:
        values, count = np.asarray(values), self.source.given.n_points
        if values.ndim < 1 or len(values) != count:
            found = f"{name} has shape {values.shape}"
            raise ArgumentError(f"{found}, but must have one row for each of the {count} points of the source")
        return values


def no_counterpart_label(labels: Int[np.ndarray, " n"]) -> int:
    """The label of points without a counterpart: -1, or one below the smallest label where -1 is a label itself.

    Examples:
        >>> no_counterpart_label(np.array([0, 3])), no_counterpart_label(np.array([-1, 3]))
        (-1, -2)
    """
    return int(np.min(labels)) - 1 if np.any(np.asarray(labels) == -1) else -1
