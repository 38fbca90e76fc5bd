"""The files that a transfer leaves in a folder."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from homolog.core.choices import TEXTURE_SIZE, System
from homolog.core.errors import ArgumentError, DataError
from homolog.core.files import all_or_nothing, atomic_path, made_folder, write_json, write_npy
from homolog.shapes import drawable, write_shape
from homolog.transfer.appearance import Appearance, Checkerboard
from homolog.transfer.atlas import Atlas, painted, unwrapped
from homolog.transfer.carrier import Carrier
from homolog.transfer.glb import png, write_glb
from homolog.transfer.inputs import Original, read_array, read_labels
from homolog.transfer.landmarks import read_landmarks
from homolog.transfer.obj import write_obj
from homolog.transfer.skin import Skin

Kind = Literal["texture", "colours", "skin"]
"""What a shape's file can hold beside points and faces."""

_OBJ, _MTL, _PNG = "textured.obj", "textured.mtl", "textured.png"
_PLY, _GLB, _REPORT = "coloured.ply", "carried.glb", "transfer.json"
_CHECKERED = "checkered.glb"
OWN_NAMES = (_OBJ, _MTL, _PNG, _PLY, _GLB, _CHECKERED, _REPORT)
"""The names of the files that a delivery may write, beside those of arrays and landmarks."""

# Landmarks that are so many point spacings away from the surface are told of.
_FAR = 3.0

# Writes files into a folder; gives what the report says of each, by its name.
_Writer = Callable[[Path], dict[str, Any]]


class Delivery:
    """Files to be written, in an order: what they need is read at once, and carried when they are written.

    Args:
        carrier: what carries.
        axes: the coordinates of both shapes, for landmarks that say theirs.
        texture_size: texels along the width of a new texture.
    """

    def __init__(self, carrier: Carrier, *, axes: System = "LPS", texture_size: int = TEXTURE_SIZE) -> None:
        self.carrier, self.axes, self.texture_size = carrier, axes, texture_size
        self.notes: list[str] = []
        """What the user should know, a line each, once all is written."""
        self._writers: list[_Writer] = []

    def add_array(self, path: Path) -> None:
        """An NPY file of numbers, a row per source point; see ``read_array``."""
        values = read_array(path, self.carrier.source.given)

        def write(folder: Path) -> dict[str, Any]:
            carried = self.carrier.array(values)
            write_npy(folder / path.name, carried)
            return {path.name: {"kind": "array", "file": str(path)}}

        self._writers.append(write)

    def add_labels(self, path: Path) -> None:
        """An NPY file of whole numbers, one per source point; see ``read_labels``."""
        labels = read_labels(path, self.carrier.source.given)

        def write(folder: Path) -> dict[str, Any]:
            write_npy(folder / path.name, self.carrier.labels(labels))
            return {path.name: {"kind": "labels", "file": str(path)}}

        self._writers.append(write)

    def add_landmarks(self, path: Path) -> None:
        """A file of points on the source; see ``read_landmarks``."""
        landmarks = read_landmarks(path)

        def write(folder: Path) -> dict[str, Any]:
            carried, away = self.carrier.landmarks(landmarks.points_in(self.axes))
            landmarks.write_from(folder / path.name, carried, self.axes)
            lost = int((np.isfinite(away) & np.isnan(carried[:, 0])).sum())
            farthest = float(np.nanmax(away)) if np.isfinite(away).any() else None
            self._tell_of_landmarks(path, lost, farthest)
            told = {"without_counterpart": lost, "largest_distance_from_source": farthest}
            return {path.name: {"kind": "landmarks", "file": str(path), **told}}

        self._writers.append(write)

    def add_contents(self, original: Original, kinds: Collection[Kind]) -> None:
        """What the source's own file holds of texture, colours and skin.

        Raises:
            DataError: if it does not hold one of these, or holds it damaged.
            ArgumentError: if the target has no faces, but needs them.
        """
        kinds = self._checked(original, kinds)

        def write(folder: Path) -> dict[str, Any]:
            drawn = drawable(self.carrier.target.given)
            texture = self._texture(folder, original.appearance) if "texture" in kinds else None
            colours = self.carrier.colours(original.appearance) if "colours" in kinds else None
            skin = self._skin(original) if "skin" in kinds else None
            written = [_OBJ, _MTL, _PNG] if texture is not None else []
            if colours is not None:
                write_shape(folder / _PLY, drawn, colours=colours)
                written.append(_PLY)
            if drawn.faces is not None:
                write_glb(folder / _GLB, self.carrier.target, texture=texture, colours=colours, skin=skin)
                written.append(_GLB)
            return {name: {"kind": "contents", "file": str(original.path), "holds": sorted(kinds)} for name in written}

        self._writers.append(write)

    def add_checkerboard(self) -> None:
        """Squares painted on both shapes, to look at the map with.

        Raises:
            ArgumentError: if one of the shapes has no faces.
        """
        for finder in (self.carrier.source, self.carrier.target):
            if finder.surface is None:
                raise ArgumentError(f"{finder.given.name} has no faces to paint squares on; carry --colours instead")

        def write(folder: Path) -> dict[str, Any]:
            source, board = self.carrier.source, Checkerboard(self.carrier.source)
            atlas = unwrapped(source, size=self.texture_size)
            image = png(painted(atlas, source, board.colours))
            write_glb(folder / _CHECKERED, source, texture=(atlas, image))
            write_glb(folder / _GLB, self.carrier.target, texture=self._texture(folder, board))
            return {name: {"kind": "checkerboard"} for name in (_CHECKERED, _OBJ, _MTL, _PNG, _GLB)}

        self._writers.append(write)

    def write(self, folder: Path, report: dict[str, Any]) -> list[Path]:
        """Carry and write everything, all of it or nothing, and a report.

        Args:
            folder: made if need be.
            report: what ``transfer.json`` is to say besides.

        Returns:
            The files.

        Raises:
            HomologError: as carrying and writing do.
        """
        with all_or_nothing():
            files = dict[str, Any]()
            place = made_folder(folder)
            for writer in self._writers:
                files |= writer(place)
            points = {"points": self.carrier.target.given.n_points, "without_counterpart": self._lost()}
            write_json(place / _REPORT, report | {"target": points, "files": files})
        return [place / name for name in (*files, _REPORT)]

    def _lost(self) -> int:
        return int((self.carrier.found.target_to_source < 0).sum())

    def _tell_of_landmarks(self, path: Path, lost: int, farthest: float | None) -> None:
        if lost:
            self.notes.append(f"{path.name}: no counterpart for {lost} of its landmarks")
        if farthest is not None and farthest > _FAR * self.carrier.source.spacing:
            self.notes.append(
                f"Warning: a landmark of {path.name} is {farthest:.3g} away from the source's surface; "
                "look at its units and at --axes"
            )

    def _checked(self, original: Original, kinds: Collection[Kind]) -> set[Kind]:
        """The kinds that were asked for, if they can be carried; all that can, if none was."""
        mesh = self.carrier.target.surface is not None
        held = _held(original)
        if not kinds:
            # A cloud has the texture's colours.
            possible: set[Kind] = held
            if not mesh:
                possible = {"colours"} if held & {"texture", "colours"} else set()
            if not possible:
                raise DataError(
                    f"{original.path} holds nothing that could be carried; give --array, --labels or --landmarks"
                )
            return set(possible)
        for kind in kinds:
            if kind not in held and not (kind == "colours" and "texture" in held):
                raise DataError(f"{original.path} holds no {kind}; leave --{kind} out, or give the file that does")
            if kind != "colours" and not mesh:
                raise ArgumentError(
                    f"{self.carrier.target.given.name} has no faces, but --{kind} needs them; carry --colours instead"
                )
        return set(kinds)

    def _texture(self, folder: Path, appearance: Appearance | Checkerboard) -> tuple[Atlas, bytes]:
        atlas, image = self.carrier.texture(appearance, size=self.texture_size)
        content = png(image)
        with atomic_path(folder / _PNG) as temporary:
            temporary.write_bytes(content)
        drawn, corners = drawable(self.carrier.target.given), atlas.places[atlas.faces]
        write_obj(folder / _OBJ, drawn, corners, materials=_MTL, image=_PNG)
        return atlas, content

    def _skin(self, original: Original) -> Skin:
        assert original.skin is not None
        return self.carrier.skin(original.skin)


def _held(original: Original) -> set[Kind]:
    appearance = original.appearance
    found: dict[Kind, object] = {
        "texture": appearance.texture,
        "colours": appearance.point_colours,
        "skin": original.skin,
    }
    return {kind for kind, held in found.items() if held is not None}


def check_names(paths: Sequence[Path]) -> None:
    """Refuse files of which two would be written to one place, and one that is given twice.

    Raises:
        ArgumentError: if there are any.
    """
    names = list[str](OWN_NAMES)
    for place, path in enumerate(paths):
        if path in paths[:place]:
            raise ArgumentError(f"{path} is given twice; say once what it is")
        if path.name in names:
            raise ArgumentError(f"{path}: another file named {path.name} is written as well; rename this one")
        names.append(path.name)
