"""The files that a transfer writes to a folder."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import UInt8

from homolog.core.choices import TEXTURE_SIZE, Side, System
from homolog.core.errors import ArgumentError, DataError
from homolog.core.files import atomic_path, expanded, write_json, write_npy, written_together
from homolog.core.messages import shorten
from homolog.core.progress import Progress, ignore
from homolog.geometry.projection import SurfaceProjector
from homolog.shapes import drawable, write_shape
from homolog.transfer.appearance import Appearance, Checkerboard, left_out, materials_warning
from homolog.transfer.atlas import Atlas, bake_texture, unwrap
from homolog.transfer.blend_shapes import BlendShapes
from homolog.transfer.glb import png, write_glb
from homolog.transfer.inputs import Original, read_array, read_labels
from homolog.transfer.landmarks import read_landmarks, repeated_names_warning, system_of
from homolog.transfer.obj import write_obj
from homolog.transfer.skin import Skin
from homolog.transfer.transfer import Transfer, no_counterpart_label

Kind = Literal["texture", "colours", "skin", "blend-shapes"]
"""What a shape's file can hold beside points and faces."""

_OBJ, _MTL, _PNG = "textured.obj", "textured.mtl", "textured.png"
_PLY, _GLB, _REPORT = "coloured.ply", "carried.glb", "transfer.json"
_CHECKERED = "checkered.glb"
OUTPUT_NAMES = (_OBJ, _MTL, _PNG, _PLY, _GLB, _CHECKERED, _REPORT)
"""Names of the files that a transfer may write, beside those of arrays, labels and landmarks."""

FAR_LANDMARK = 3.0
"""A landmark farther from the surface than this many point spacings gets a warning."""

# Writes files into a folder, and returns their entries in the report by file name.
_Writer = Callable[[Path], dict[str, Any]]


class Delivery:
    """Collects what is to be transferred, and writes it to a folder.

    Files are read when they are added, and transferred in ``write``.

    Args:
        transfer: along which match.
        axes: the anatomical axes of both shapes, for landmark files that state theirs; None for those that the shapes'
            files name, as 3D Slicer writes them, or LPS.
        texture_size: texels along the width of a new texture.
        target: the target's own file, whose look and skin are kept where no other is transferred.

    Examples:
        >>> delivery = Delivery(Transfer(homolog.Match.load("result")))  # doctest: +SKIP
        >>> delivery.add_labels(Path("organs.npy"))  # doctest: +SKIP
        >>> delivery.write(Path("transferred"), {})  # doctest: +SKIP
    """

    def __init__(
        self,
        transfer: Transfer,
        *,
        axes: System | None = None,
        texture_size: int = TEXTURE_SIZE,
        target: Original | None = None,
    ) -> None:
        self.transfer, self.axes, self.texture_size, self.target = transfer, axes, texture_size, target
        self.notes: list[str] = []
        """Messages for the user, a line each, complete after ``write``."""
        self._progress: Progress = ignore
        self._inputs: list[Path] = []
        self._writers: list[_Writer] = []

    def add_array(self, path: Path) -> None:
        """Add an NPY file of numbers, a row per source point; see ``read_array``."""
        self._inputs.append(path)
        values = read_array(path, self.transfer.source.given)

        def write(folder: Path) -> dict[str, Any]:
            write_npy(folder / path.name, self.transfer.array(values))
            return {path.name: {"kind": "array", "file": str(path)}}

        self._writers.append(write)

    def add_labels(self, path: Path) -> None:
        """Add an NPY file of whole numbers, one per source point; see ``read_labels``."""
        self._inputs.append(path)
        labels = read_labels(path, self.transfer.source.given)
        none = no_counterpart_label(labels)

        def write(folder: Path) -> dict[str, Any]:
            write_npy(folder / path.name, self.transfer.labels(labels))
            if none != -1:
                self.notes.append(f"{path.name}: -1 is one of its labels; points without a counterpart have {none}")
            return {path.name: {"kind": "labels", "file": str(path), "without_counterpart": none}}

        self._writers.append(write)

    def add_landmarks(self, path: Path) -> None:
        """Add a file of landmarks on the source; see ``read_landmarks``."""
        self._inputs.append(path)
        landmarks = read_landmarks(path)

        def write(folder: Path) -> dict[str, Any]:
            images, distances = self.transfer.landmarks(landmarks.points_in(self._axes_of("source")))
            landmarks.write_from(folder / path.name, images, self._axes_of("target"))
            unmatched = int((np.isfinite(distances) & np.isnan(images[:, 0])).sum())
            farthest = float(np.nanmax(distances)) if np.isfinite(distances).any() else None
            self._note_landmarks(path, unmatched, farthest)
            if told := repeated_names_warning(path, landmarks.names):
                self.notes.append(f"Warning: {told}")
            figures = {"without_counterpart": unmatched, "largest_distance_from_source": farthest}
            return {path.name: {"kind": "landmarks", "file": str(path), **figures}}

        self._writers.append(write)

    def add_contents(self, original: Original, kinds: Collection[Kind]) -> None:
        """Add the texture, vertex colours, skin and blend shapes of the source's own file, with its animations.

        Args:
            original: the source's file.
            kinds: which of these; empty for all that the file holds.

        Raises:
            DataError: if the file does not hold one of them, or is damaged.
            ArgumentError: if the target has no faces, but needs them.
        """
        self._inputs += original.files
        kinds = self._checked(original, kinds)

        def write(folder: Path) -> dict[str, Any]:
            drawn = drawable(self.transfer.target.given)
            texture = self._texture(folder, original.appearance) if "texture" in kinds else None
            colours = self.transfer.colours(original.appearance) if "colours" in kinds else None
            skin = self.transfer.skin(original.skin) if "skin" in kinds and original.skin is not None else None
            shapes = self._blend_shapes(original) if "blend-shapes" in kinds else None
            if texture is not None or colours is not None:
                self._note_left_out(original)
            written = [_OBJ, _MTL, _PNG] if texture is not None else []
            if colours is not None:
                write_shape(folder / _PLY, drawn, colours=colours)
                written.append(_PLY)
            if drawn.faces is not None:
                self._write_glb(folder / _GLB, texture, colours, skin, shapes)
                written.append(_GLB)
            entry = {"kind": "contents", "file": str(original.path), "holds": sorted(kinds)}
            moving = {each.name: None for held in (skin, shapes) if held for each in held.animations}
            names = {"blend_shapes": list(shapes.names)} if shapes else {}
            return {name: entry | names | ({"animations": [*moving]} if moving else {}) for name in written}

        self._writers.append(write)

    def add_checkerboard(self) -> None:
        """Add a checkerboard that is painted on both shapes, to inspect the map.

        Raises:
            ArgumentError: if one of the shapes has no faces.
        """
        for projector in (self.transfer.source, self.transfer.target):
            if projector.surface is None:
                raise ArgumentError(
                    f"{projector.given.name} has no faces to paint squares on; transfer --colours instead"
                )

        def write(folder: Path) -> dict[str, Any]:
            source, board = self.transfer.source, Checkerboard(self.transfer.source)
            atlas = unwrap(source, size=self.texture_size)
            image = png(bake_texture(atlas, source, board.colours))
            write_glb(folder / _CHECKERED, source, texture=(atlas, image))
            write_glb(folder / _GLB, self.transfer.target, texture=self._texture(folder, board))
            return {name: {"kind": "checkerboard"} for name in (_CHECKERED, _OBJ, _MTL, _PNG, _GLB)}

        self._writers.append(write)

    def write(self, folder: Path, report: dict[str, Any], progress: Progress = ignore) -> list[Path]:
        """Transfer and write everything with a report; all files land together or none does.

        Args:
            folder: created if needed.
            report: further entries of ``transfer.json``.
            progress: called before each blend shape.

        Returns:
            The files.

        Raises:
            ArgumentError: if a file that was added would be overwritten.
            HomologError: as transferring and writing do.
        """
        self._progress = progress
        names = (*OUTPUT_NAMES, *(path.name for path in self._inputs))
        root, files = expanded(folder), dict[str, Any]()
        with written_together(folder, names, self._inputs):
            for writer in self._writers:
                files |= writer(root)
            target = {
                "points": self.transfer.target.given.n_points,
                "without_counterpart": int((self.transfer.found.target_to_source < 0).sum()),
            }
            write_json(root / _REPORT, report | {"target": target, "files": files, "notes": self.notes})
        return [root / name for name in (*files, _REPORT)]

    def _write_glb(
        self,
        path: Path,
        texture: tuple[Atlas, bytes] | None,
        colours: UInt8[np.ndarray, "n 3"] | None,
        skin: Skin | None,
        shapes: BlendShapes | None,
    ) -> None:
        """Write the target with what is transferred, and with its own look, skin or shapes where no other is."""
        own = self.target
        if own is None or own.shape.faces is None:
            given = self.transfer.target
            write_glb(path, given, texture=texture, colours=colours, skin=skin, blend_shapes=shapes)
            return
        skin = own.skin if skin is None else skin
        shapes = own.blend_shapes if shapes is None else shapes
        look = None
        if texture is None and colours is None:
            self._note_left_out(own)
            look, of_points = own.appearance.texture, own.appearance.point_colours
            colours = (
                None if of_points is None else np.round(255 * np.nan_to_num(of_points).clip(0, 1)).astype(np.uint8)
            )
        # The look counts the faces of the file.
        projector = SurfaceProjector(own.shape) if look is not None else self.transfer.target
        colours = None if look is not None else colours
        write_glb(path, projector, texture=texture, colours=colours, look=look, skin=skin, blend_shapes=shapes)

    def _blend_shapes(self, original: Original) -> BlendShapes | None:
        """The source's blend shapes on the target, of which those that move nothing are told of."""
        assert original.blend_shapes is not None
        shapes = self.transfer.blend_shapes(original.blend_shapes, self._progress)
        if still := [name for name, rows in zip(shapes.names, shapes.offsets, strict=True) if not rows.any()]:
            names = shorten(", ".join(still), 200)
            self.notes.append(f"{original.path.name}: blend shapes that move no point of the target: {names}")
        return shapes

    def _axes_of(self, side: Side) -> System:
        """The anatomical axes of a shape: those that were given, or that its file names."""
        named = self.transfer.found.report.get("inputs", {}).get(side, {}).get("space")
        return system_of(named, self.axes)

    def _note_left_out(self, original: Original) -> None:
        if names := left_out(original.path):
            self.notes.append(f"{original.path.name}: left out of its look: {', '.join(names)}")
        if original.appearance.texture is not None and (told := materials_warning(original.path)):
            self.notes.append(f"Warning: {original.path.name}: {told}; its faces are white")

    def _note_landmarks(self, path: Path, unmatched: int, farthest: float | None) -> None:
        if unmatched:
            self.notes.append(f"{path.name}: no counterpart for {unmatched} of its landmarks")
        if farthest is not None and farthest > FAR_LANDMARK * self.transfer.source.spacing:
            self.notes.append(
                f"Warning: a landmark of {path.name} is {farthest:.3g} away from the source's surface; "
                "look at its units and at --axes"
            )

    def _checked(self, original: Original, kinds: Collection[Kind]) -> set[Kind]:
        """The kinds that were asked for, or all that can be transferred if none was."""
        mesh = self.transfer.target.surface is not None
        held = _held(original)
        if not kinds:
            # A target without faces gets the texture's colours at its points.
            possible: set[Kind] = held
            if not mesh:
                possible = {"colours"} if held & {"texture", "colours"} else set()
                if lost := held - {"texture", "colours"}:
                    what = " and ".join(sorted(lost)).replace("-", " ")
                    self.notes.append(f"{self.transfer.target.given.name} has no faces: left out: {what}")
            if not possible:
                missing = materials_warning(original.path)
                raise DataError(
                    f"{original.path} holds nothing that could be transferred; "
                    + (f"{missing}; name them alike, or " if missing else "")
                    + "give --array, --labels or --landmarks"
                )
            return set(possible)
        for kind in kinds:
            if kind not in held and not (kind == "colours" and "texture" in held):
                raise DataError(f"{original.path} holds no {kind}; leave --{kind} out, or give the file that does")
            if kind != "colours" and not mesh:
                name = self.transfer.target.given.name
                raise ArgumentError(f"{name} has no faces, but --{kind} needs them; transfer --colours instead")
        return set(kinds)

    def _texture(self, folder: Path, appearance: Appearance | Checkerboard) -> tuple[Atlas, bytes]:
        atlas, image = self.transfer.texture(appearance, size=self.texture_size)
        content = png(image)
        with atomic_path(folder / _PNG) as temporary:
            temporary.write_bytes(content)
        drawn, corners = drawable(self.transfer.target.given), atlas.uv[atlas.faces]
        write_obj(folder / _OBJ, drawn, corners, materials=_MTL, image=_PNG)
        return atlas, content


def _held(original: Original) -> set[Kind]:
    """What the source's file holds."""
    appearance = original.appearance
    found: dict[Kind, object] = {
        "texture": appearance.texture,
        "colours": appearance.point_colours,
        "skin": original.skin,
        "blend-shapes": original.blend_shapes,
    }
    return {kind for kind, held in found.items() if held is not None}


def check_output_names(paths: Sequence[Path]) -> None:
    """Refuse two inputs whose outputs would have the same name, and an input that is given twice.

    Raises:
        ArgumentError: if there are any.
    """
    names = list[str](OUTPUT_NAMES)
    for number, path in enumerate(paths):
        if path in paths[:number]:
            raise ArgumentError(f"{path} is given twice; say once what it is")
        if path.name in names:
            raise ArgumentError(f"{path}: another file named {path.name} is written as well; rename this one")
        names.append(path.name)
