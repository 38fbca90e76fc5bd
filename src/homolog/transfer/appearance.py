"""What a shape looks like: the texture or vertex colours of its file, sampled at any point of the surface."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any
from warnings import catch_warnings, simplefilter

import numpy as np
from jaxtyping import Float, Int, UInt8

from homolog.core.errors import DataError, HomologError, needs_extra
from homolog.core.files import read_bytes
from homolog.core.memory import expansion_fault
from homolog.core.messages import shorten
from homolog.core.reasons import image_reason, reason_with_remedy
from homolog.geometry.projection import SurfacePoints, SurfaceProjector
from homolog.shapes import Shape
from homolog.shapes.formats.ply import read_ply_colours
from homolog.transfer.gltf import linear, read_gltf_look, srgb
from homolog.transfer.gltf import looks_left_out as _left_out_of_gltf
from homolog.transfer.obj import looks_left_out as _left_out_of_obj
from homolog.transfer.obj import missing_materials, obj_files, read_obj_colours, read_obj_texture, tells_colours

NO_COLOUR = (160, 160, 160)
"""The colour of what has no counterpart: grey."""

_WHITE = np.full((1, 1, 3), 255, dtype=np.uint8)

Image = UInt8[np.ndarray, "h w 3"]


@dataclass(frozen=True, eq=False)
class Texture:
    """Images on a mesh.

    Args:
        coordinates: texture coordinates of each corner of each face (m, 3, 2): (0, 0) is the upper left corner of
            the upper left texel and (1, 1) the lower right corner of the lower right one; images repeat beyond.
        image_of: the image of each face (m,).
        images: red, green and blue of each texel, from 0 to 255.
    """

    coordinates: Float[np.ndarray, "m 3 2"]
    image_of: Int[np.ndarray, " m"]
    images: tuple[Image, ...]

    def colours(self, points: SurfacePoints) -> UInt8[np.ndarray, "p 3"]:
        """Sample the texture at points of the surface, bilinearly; grey at invalid points.

        A point lies in one face, and so in one chart of the atlas: nothing is interpolated across seams.
        """
        assert points.faces is not None
        colours = np.full((len(points.faces), 3), NO_COLOUR, dtype=np.uint8)
        where = np.einsum("pck,pc->pk", self.coordinates[points.faces], points.weights)
        image_of = np.where(points.valid, self.image_of[points.faces], -1)
        for number, image in enumerate(self.images):
            of_image = image_of == number
            colours[of_image] = _sampled(image, where[of_image])
        return colours


def _sampled(image: Image, where: Float[np.ndarray, "p 2"]) -> UInt8[np.ndarray, "p 3"]:
    height, width = image.shape[:2]
    column, row = np.nan_to_num(where).T * np.array([[width], [height]]) - 0.5
    left, top = np.floor(column).astype(int), np.floor(row).astype(int)
    right_share, low_share = (column - left)[:, None], (row - top)[:, None]
    rows, columns = (top % height, (top + 1) % height), (left % width, (left + 1) % width)
    upper, lower = ((1 - right_share) * image[at, columns[0]] + right_share * image[at, columns[1]] for at in rows)
    return np.asarray(np.round((1 - low_share) * upper + low_share * lower), dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class Appearance:
    """What a file says of a shape's colours.

    Args:
        texture: its texture; None if it has none.
        point_colours: red, green and blue of each point, from 0 to 1; None if it has none.
    """

    texture: Texture | None = None
    point_colours: Float[np.ndarray, "n 3"] | None = None

    def colours(self, points: SurfacePoints) -> UInt8[np.ndarray, "p 3"]:
        """The colour at points of the surface, from the texture if there is one; grey where there is none."""
        if self.texture is not None:
            return self.texture.colours(points)
        if self.point_colours is None:
            return np.full((len(points.corners), 3), NO_COLOUR, dtype=np.uint8)
        values = np.where(points.valid[:, None], 255 * points.interpolate(self.point_colours), NO_COLOUR)
        return np.round(np.nan_to_num(values, nan=NO_COLOUR[0]).clip(0, 255)).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Checkerboard:
    """A checkerboard on a shape, projected from the front, to inspect a map; squares are white or coloured by position.

    Args:
        projector: the shape.
        squares: how many make the square root of its area.
    """

    projector: SurfaceProjector
    squares: int = 25

    def colours(self, points: SurfacePoints) -> UInt8[np.ndarray, "p 3"]:
        """The colour at points of the surface; grey at invalid points."""
        positions = np.where(points.valid[:, None], self.projector.positions(points), self.projector.shape.points[0])
        across, up = np.floor(self.squares * positions[:, :2].T / self.projector.unit).astype(int)
        low, high = self.projector.shape.points.min(axis=0), self.projector.shape.points.max(axis=0)
        share = ((positions - low) / np.where(high > low, high - low, 1.0)).clip(0, 1)
        # Depth is hardly visible from the front.
        share[:, 2] = 1.0 - share[:, 1]
        squares = np.where(((across + up) % 2 == 0)[:, None], 255.0, 20 + 200 * share)
        return np.asarray(np.where(points.valid[:, None], squares, NO_COLOUR).round(), dtype=np.uint8)


def read_appearance(path: Path, shape: Shape) -> Appearance:
    """Read the texture and the colours of an OBJ, GLB, glTF or PLY file; other formats have none.

    Args:
        path: the file.
        shape: what ``read_shape`` read from it.

    Raises:
        DataError: if its texture is damaged, or lies in a file that is missing.
        MissingExtraError: if reading its images needs a package that is not installed.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        return Appearance()
    with _blamed(path):
        return reader(path, shape)


@contextmanager
def _blamed(path: Path) -> Iterator[None]:
    try:
        yield
    except HomologError:
        raise
    except Exception as error:
        reason = reason_with_remedy(error, "export it again")
        raise DataError(f"{path}: its texture or colours cannot be read: {reason}") from error


def read_image(source: Path | bytes, name: str | None = None) -> Image:
    """Read an image file, or its content; what it has of transparency is passed over.

    Args:
        source: the file, or what it holds.
        name: how messages call it; by default the file.

    Raises:
        DataError: if it is missing or damaged.
        MissingExtraError: if Pillow is not installed.
    """
    with needs_extra("reading a texture", "transfer"):
        from PIL import Image as Pillow
    try:
        content = source if isinstance(source, bytes) else read_bytes(source)
        with catch_warnings():
            simplefilter("ignore")  # of Pillow, about large images
            with Pillow.open(BytesIO(content)) as image:
                fault = expansion_fault(3 * image.width * image.height, len(content))
                if not fault:
                    return np.asarray(image.convert("RGB"))
    except (OSError, ValueError, SyntaxError, MemoryError, Pillow.DecompressionBombError) as error:
        fault = image_reason(error)
    called = name if isinstance(source, bytes) else f"{shorten(source, 200)}, a texture,"
    raise DataError(f"{called} cannot be read as an image: {fault}")


def _of_obj(path: Path, shape: Shape) -> Appearance:
    found, colours = read_obj_texture(path), read_obj_colours(path)
    # Colours of points say more than those of materials.
    if found is None or shape.faces is None or (colours is not None and not any(m.image for m in found.materials)):
        return Appearance(point_colours=colours)
    images = [_WHITE if material.image is None else read_image(material.image) for material in found.materials]
    tints = [1.0 if material.image is not None else np.array(material.colour) for material in found.materials]
    tinted = tuple(_tinted(image, tint) for image, tint in zip(images, tints, strict=True))
    return Appearance(Texture(found.coordinates, found.material_of, tinted), colours)


def _tinted(image: Image, tint: Any) -> Image:
    if np.all(np.asarray(tint) == 1):
        return image
    # A row at a time, as a number of tinted colour takes eight times the memory of one of the image.
    return np.stack([np.round(row * tint).clip(0, 255).astype(np.uint8) for row in image])


def _lit(image: Image, factor: Any) -> Image:
    """An image times a factor of linear light, as glTF has it."""
    return image if np.all(factor == 1) else _tinted(srgb(linear(image / 255.0) * factor), 255.0)


def _of_gltf(path: Path, shape: Shape) -> Appearance:
    look = read_gltf_look(path)
    if len(look.coordinates) != shape.n_faces or len(look.colours) != shape.n_points:
        raise DataError(f"{path} was changed since its shape was read; read it again")
    colours = None if np.isnan(look.colours).all() else look.colours
    bare = all(material.image is None for material in look.materials)
    tells = colours is None and tells_colours([material.colour for material in look.materials])
    if (bare and not tells) or shape.faces is None:
        return Appearance(point_colours=colours)
    images = [_WHITE if m.image is None else read_image(m.image, f"{path}, its texture") for m in look.materials]
    tinted = [_lit(image, np.array(m.colour)) for image, m in zip(images, look.materials, strict=True)]
    return Appearance(Texture(look.coordinates, look.material_of, tuple(tinted)), colours)


_READERS: dict[str, Callable[[Path, Shape], Appearance]] = {
    ".ply": lambda path, _: Appearance(point_colours=read_ply_colours(path)),
    ".obj": _of_obj,
    ".glb": _of_gltf,
    ".gltf": _of_gltf,
}


def left_out(path: Path) -> tuple[str, ...]:
    """What a file says of a shape's look that ``read_appearance`` does not read, such as normal maps."""
    found = {".obj": _left_out_of_obj, ".glb": _left_out_of_gltf, ".gltf": _left_out_of_gltf}.get(path.suffix.lower())
    with _blamed(path):
        return () if found is None else tuple(sorted(found(path)))


def materials_warning(path: Path) -> str:
    """What is said of materials that the faces of an OBJ file name, but none of its libraries has; else nothing."""
    with _blamed(path):
        missing = missing_materials(path) if path.suffix.lower() == ".obj" else []
    return f"no file of materials holds its {shorten(', '.join(missing), 100)}" if missing else ""


def files_of_look(path: Path) -> tuple[Path, ...]:
    """The files beside a shape's own that its texture and colours are read from."""
    with _blamed(path):
        if path.suffix.lower() == ".obj":
            return tuple(obj_files(path))
        if path.suffix.lower() in (".glb", ".gltf"):
            return tuple(m.image for m in read_gltf_look(path).materials if isinstance(m.image, Path))
    return ()
