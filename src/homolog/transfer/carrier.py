"""All that can be carried along one match."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from jaxtyping import Float, Int, Num, UInt8

from homolog.core.choices import TEXTURE_SIZE
from homolog.core.errors import ArgumentError
from homolog.matching import MatchResult
from homolog.shapes import Shape
from homolog.transfer.appearance import Appearance, Checkerboard
from homolog.transfer.atlas import Atlas, painted, unwrapped
from homolog.transfer.places import PlaceFinder
from homolog.transfer.skin import Skin, carried_skin
from homolog.transfer.smooth_map import SurfaceMap, surface_map


class Carrier:
    """Carries from the source of a match to its target, along a smooth map between their surfaces.

    Points without a counterpart get NaN, the label -1, or grey.

    Args:
        result: what ``read_result`` gives; ``result.inverse()`` carries the other way.
        source: the source as ``read_shape`` reads it, where faces must be counted as in its file; by default the
            result's own.
    """

    def __init__(self, result: MatchResult, *, source: Shape | None = None) -> None:
        self.found = result.found
        self.source = PlaceFinder(result.source if source is None else source)
        self.target = PlaceFinder(result.target)

    @cached_property
    def to_source(self) -> SurfaceMap:
        """Where each of the target's points lies on the source."""
        return surface_map(self.target, self.source, self.found.inverse())

    @cached_property
    def to_target(self) -> SurfaceMap:
        """Where each of the source's points lies on the target."""
        return surface_map(self.source, self.target, self.found)

    def array(self, values: Num[np.ndarray, "n_source ..."]) -> Float[np.ndarray, "n_target ..."]:
        """Values of the source's points, interpolated at the target's; in the same precision.

        Raises:
            ArgumentError: if there is not one row for each point.
        """
        values = self._rows(values, "values")
        carried = self.to_source.places.values(values)
        return carried.astype(values.dtype) if values.dtype.kind == "f" else carried

    def labels(self, labels: Int[np.ndarray, " n_source"]) -> Int[np.ndarray, " n_target"]:
        """Labels of the source's points, at the target's: the one with the largest weight, never a mean of several.

        Raises:
            ArgumentError: if there is not one for each point.
        """
        return self.to_source.places.labels(self._rows(labels, "labels"))

    def landmarks(self, points: Float[np.ndarray, "p 3"]) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, " p"]]:
        """Points of the source's surface, at their places on the target's, in its coordinates.

        Returns:
            The positions, NaN for points without a counterpart or a position, and how far away from the source's
            surface each point was, in its coordinates.
        """
        places = self.source.places(points)
        away = np.linalg.norm(self.source.positions(places) - points, axis=1)
        return self.target.positions(self.to_target.at(places)), away

    def colours(self, appearance: Appearance) -> UInt8[np.ndarray, "n_target 3"]:
        """The source's colours at the target's points."""
        return appearance.colours(self.to_source.places)

    def texture(
        self, appearance: Appearance | Checkerboard, *, size: int = TEXTURE_SIZE
    ) -> tuple[Atlas, UInt8[np.ndarray, "h w 3"]]:
        """An atlas of the target's own, and an image of the source's colours in it.

        Args:
            appearance: the source's.
            size: texels along the image's width.

        Raises:
            ArgumentError: if the target has no faces.
            MissingExtraError: if a package that makes textures is not installed.
        """
        if self.target.surface is None:
            raise ArgumentError(f"{self.target.given.name} has no faces to put a texture on; carry colours instead")
        atlas = unwrapped(self.target, size=size)
        to_source = self.to_source
        return atlas, painted(atlas, self.target, lambda places: appearance.colours(to_source.at(places)))

    def skin(self, skin: Skin) -> Skin:
        """The source's skeleton and weights, for the target; see ``carried_skin``.

        Raises:
            ArgumentError: if the target has no faces.
        """
        if self.target.surface is None:
            raise ArgumentError(f"{self.target.given.name} has no faces, but a skin is for meshes")
        return carried_skin(skin, self.to_source, self.to_target)

    def _rows(self, values: np.ndarray, name: str) -> np.ndarray:
        values, count = np.asarray(values), self.source.given.n_points
        if values.ndim < 1 or len(values) != count:
            found = f"{name} has shape {values.shape}"
            raise ArgumentError(f"{found}, but must have one row for each of the {count} points of the source")
        return values
