"""Texture and colours of OBJ files, and writing a textured one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from homolog.core.errors import DataError
from homolog.core.files import atomic_path
from homolog.shapes import Shape
from homolog.shapes.parsing import content_lines, fan_triangles, number_rows, read_text

_NO_MATERIAL = ""


@dataclass(frozen=True)
class Material:
    """What an OBJ's material says of colour.

    Args:
        image: the file of its texture; None if it has none.
        colour: red, green and blue from 0 to 1.
    """

    image: Path | None = None
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)


@dataclass(frozen=True, eq=False)
class ObjTexture:
    """The texture coordinates of an OBJ file.

    Args:
        coordinates: for each corner of each triangle its place in the image, from the upper left (m, 3, 2).
        material_of: the material of each triangle (m,).
        materials: all that are used.
    """

    coordinates: Float[np.ndarray, "m 3 2"]
    material_of: Int[np.ndarray, " m"]
    materials: tuple[Material, ...]


def read_obj_colours(path: Path) -> Float[np.ndarray, "n 3"] | None:
    """Red, green and blue of each point, from 0 to 1, where they follow all the coordinates; None otherwise."""
    lines = [line for line in _lines(path) if line.startswith(("v ", "v\t"))]
    if not lines or any(len(line.split()) != 7 for line in lines):
        return None
    colours = number_rows(lines, (4, 5, 6))
    return colours / 255.0 if colours.max() > 1.0 else colours


def read_obj_texture(path: Path) -> ObjTexture | None:
    """The texture of an OBJ file, for the triangles that ``read_shape`` makes of it; None if no face has an image.

    Raises:
        DataError: if its materials are missing.
    """
    coordinates = _Coordinates()
    libraries = list[str]()
    for line in _lines(path):
        coordinates.take(line)
        if line.startswith("mtllib"):
            libraries.append(line.split(None, 1)[1] if " " in line else "")
    if not coordinates.corners or not any(number >= 0 for corners in coordinates.corners for number in corners):
        return None
    known = {name: material for library in libraries for name, material in _materials(path.parent / library).items()}
    names = list(dict.fromkeys(coordinates.material_of))
    materials = tuple(known.get(name, Material()) for name in names)
    if all(material.image is None for material in materials):
        return None
    return coordinates.assembled(names, materials)


class _Coordinates:
    """What the lines of an OBJ file say of texture, one after the other."""

    def __init__(self) -> None:
        self.places: list[tuple[float, float]] = []
        self.corners: list[list[int]] = []
        self.material_of: list[str] = []
        self._material = _NO_MATERIAL

    def take(self, line: str) -> None:
        match line.split():
            case ["vt", u, *rest]:
                self.places.append((float(u), float(rest[0]) if rest else 0.0))
            case ["usemtl", *name]:
                self._material = " ".join(name)
            case ["f", *corners]:
                self.corners.append([self._number(corner) for corner in corners])
                self.material_of.append(self._material)

    def _number(self, corner: str) -> int:
        """The texture coordinates of a corner such as 3/7/2, which counts from 1, or backward; -1 if it has none."""
        _, _, rest = corner.partition("/")
        number = int(rest.partition("/")[0] or 0)
        return number - 1 if number > 0 else len(self.places) + number if number < 0 else -1

    def assembled(self, names: list[str], materials: tuple[Material, ...]) -> ObjTexture:
        """A row per triangle; faces without coordinates have those of the image's corner."""
        sizes = np.array([len(corners) for corners in self.corners])
        numbers = np.array([number for corners in self.corners for number in corners])
        if numbers.max() >= len(self.places):
            raise DataError(f"a face names texture coordinates {numbers.max() + 1}, but there are {len(self.places)}")
        triangles = numbers[fan_triangles(sizes, np.arange(len(numbers)))]
        # The last row stands for corners without coordinates.
        places = np.array([*self.places, (0.0, 1.0)])[triangles]
        of_polygon = np.array([names.index(name) for name in self.material_of])
        flipped = np.stack([places[..., 0], 1.0 - places[..., 1]], axis=-1)
        return ObjTexture(flipped, np.repeat(of_polygon, np.maximum(sizes - 2, 0)), materials)


def _lines(path: Path) -> list[str]:
    return content_lines(read_text(path).replace("\\\r\n", " ").replace("\\\n", " "))


def _materials(library: Path) -> dict[str, Material]:
    """The materials of an MTL file, by their names."""
    if not library.is_file():
        raise DataError(f"{library}, the materials of an OBJ file, is not there; put it beside that file")
    found, name = dict[str, Material](), _NO_MATERIAL
    for line in _lines(library):
        before = found.get(name, Material())
        match line.split():
            case ["newmtl", *words]:
                name = " ".join(words)
                found[name] = Material()
            case ["Kd", red, green, blue, *_]:
                found[name] = Material(before.image, (float(red), float(green), float(blue)))
            case ["map_Kd", *_]:
                found[name] = Material(_image_file(library.parent, line.split(None, 1)[1]), before.colour)
    return found


def _image_file(folder: Path, words: str) -> Path:
    """The file that a line names, beside the materials or below them; options come before its name."""
    name = words.split()[-1] if words.startswith("-") else words
    place = folder / name.replace("\\", "/")
    return place if place.is_file() else folder / place.name


def write_obj(
    path: Path,
    shape: Shape,
    corners: Float[np.ndarray, "m 3 2"],
    *,
    materials: str,
    image: str,
) -> None:
    """Write a mesh and a file of materials that gives it one texture; points and faces keep their numbers.

    Args:
        path: the OBJ; its folder exists.
        shape: a mesh.
        corners: for each corner of each face its place in the image, from the upper left.
        materials: the name of the MTL file, which goes beside it.
        image: the name of the image, which is beside it.
    """
    assert shape.faces is not None
    flipped = np.stack([corners[..., 0], 1.0 - corners[..., 1]], axis=-1).reshape(-1, 2)
    places, place_of = np.unique(flipped, axis=0, return_inverse=True)
    rows = np.stack([shape.faces + 1, place_of.reshape(-1, 3) + 1], axis=-1).reshape(-1, 6)
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"mtllib {materials}\n")
        file.writelines("v %r %r %r\n" % tuple(point) for point in shape.points.tolist())  # noqa: UP031
        file.writelines("vt %r %r\n" % tuple(place) for place in places.tolist())  # noqa: UP031
        file.write("usemtl texture\n")
        file.writelines("f %d/%d %d/%d %d/%d\n" % tuple(row) for row in rows.tolist())  # noqa: UP031
    with atomic_path(path.with_name(materials)) as temporary:
        lines = ("newmtl texture", "Ka 1 1 1", "Kd 1 1 1", "Ks 0 0 0", "illum 1", f"map_Kd {image}")
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
