"""What a shape looks like: the texture or vertex colours of its file, sampled at any point of the surface."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float, Int, UInt8

from homolog.core.errors import DataError, HomologError, needs_extra
from homolog.shapes import Shape
from homolog.shapes.gltf_format import quiet_trimesh
from homolog.shapes.parsing import UnreadableError
from homolog.shapes.ply_format import read_ply_colours
from homolog.transfer.obj import read_obj_colours, read_obj_texture
from homolog.transfer.projection import SurfacePoints, SurfaceProjector

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
        raise DataError(f"{path}: its texture or colours cannot be read ({error}); export it again") from error


def read_image(path: Path) -> Image:
    """Read an image file; what it has of transparency is passed over.

    Raises:
        DataError: if it is missing or damaged.
        MissingExtraError: if Pillow is not installed.
    """
    with needs_extra("reading a texture", "transfer"):
        from PIL import Image as Pillow
    try:
        with Pillow.open(path) as image:
            return np.asarray(image.convert("RGB"))
    except (OSError, ValueError, SyntaxError, Pillow.DecompressionBombError) as error:
        raise DataError(
            f"{path}, a texture, cannot be read as an image ({error}); put it there, or export it again"
        ) from None


def _of_ply(path: Path, shape: Shape) -> Appearance:
    return Appearance(point_colours=read_ply_colours(path))


def _of_obj(path: Path, shape: Shape) -> Appearance:
    found = read_obj_texture(path)
    if found is None or shape.faces is None:
        return Appearance(point_colours=read_obj_colours(path))
    images = [_WHITE if material.image is None else read_image(material.image) for material in found.materials]
    tints = [1.0 if material.image is not None else np.array(material.colour) for material in found.materials]
    tinted = tuple(_tinted(image, tint) for image, tint in zip(images, tints, strict=True))
    return Appearance(Texture(found.coordinates, found.material_of, tinted), read_obj_colours(path))


def _tinted(image: Image, tint: Any) -> Image:
    return np.asarray(np.round(image * tint).clip(0, 255), dtype=np.uint8)


def _of_gltf(path: Path, shape: Shape) -> Appearance:
    with needs_extra("reading a texture", "transfer"):
        import PIL  # noqa: F401  # trimesh passes over textures without it
    with quiet_trimesh():
        scene = trimesh.load_scene(path)
    meshes = [scene.geometry[scene.graph[node][1]] for node in scene.graph.nodes_geometry]
    faces = [mesh for mesh in meshes if isinstance(mesh, trimesh.Trimesh)]
    if (
        sum(len(mesh.vertices) for mesh in meshes) != shape.n_points
        or sum(len(m.faces) for m in faces) != shape.n_faces
    ):
        raise UnreadableError("its points are counted differently with and without their texture")
    texture = _gltf_texture(faces) if any(_image_of(mesh) is not None for mesh in faces) else None
    return Appearance(texture, _gltf_colours(meshes))


def _gltf_texture(meshes: list[Any]) -> Texture:
    """One image per mesh: its material's, or its material's colour alone."""
    coordinates, image_of, images = list[np.ndarray](), list[np.ndarray](), list[Image]()
    for number, mesh in enumerate(meshes):
        image, uv = _image_of(mesh), getattr(mesh.visual, "uv", None)
        textured = image is not None and uv is not None and len(uv) == len(mesh.vertices)
        corners = np.asarray(uv)[mesh.faces] if textured else np.zeros((len(mesh.faces), 3, 2))
        # trimesh counts heights from below.
        coordinates.append(np.stack([corners[..., 0], 1.0 - corners[..., 1]], axis=-1))
        image_of.append(np.full(len(mesh.faces), number))
        images.append(_tinted(np.asarray(image.convert("RGB")) if textured else _WHITE, _factor_of(mesh)))
    return Texture(np.concatenate(coordinates), np.concatenate(image_of), tuple(images))


def _image_of(mesh: Any) -> Any:
    material = getattr(mesh.visual, "material", None)
    return getattr(material, "baseColorTexture", None) or getattr(material, "image", None)


def _factor_of(mesh: Any) -> Float[np.ndarray, " 3"]:
    factor = getattr(getattr(mesh.visual, "material", None), "baseColorFactor", None)
    return np.ones(3) if factor is None else np.asarray(factor)[:3] / 255.0


def _gltf_colours(meshes: list[Any]) -> Float[np.ndarray, "n 3"] | None:
    """The colours of vertices; those of meshes without any are unknown, NaN."""
    found = [_colours_of(mesh) for mesh in meshes]
    if all(colours is None for colours in found):
        return None
    unknown = [np.full((len(mesh.vertices), 3), np.nan) for mesh in meshes]
    return np.concatenate([none if known is None else known for known, none in zip(found, unknown, strict=True)])


def _colours_of(mesh: Any) -> Float[np.ndarray, "v 3"] | None:
    """A mesh's colours, which trimesh keeps elsewhere where there is a material."""
    if getattr(mesh.visual, "kind", None) == "vertex":
        colours = np.asarray(mesh.visual.vertex_colors)
    else:
        colours = np.asarray(getattr(mesh.visual, "vertex_attributes", {}).get("color", ()))
    if colours.ndim != 2 or len(colours) != len(mesh.vertices):
        return None
    largest = 1.0 if colours.dtype.kind == "f" else float(np.iinfo(colours.dtype).max)
    return np.asarray(colours[:, :3] / largest)


_READERS: dict[str, Callable[[Path, Shape], Appearance]] = {
    ".ply": _of_ply,
    ".obj": _of_obj,
    ".glb": _of_gltf,
    ".gltf": _of_gltf,
}
