"""Texture and colours of OBJ files, and writing a textured one."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import unquote

import numpy as np
from jaxtyping import Float, Int

from homolog.core.errors import DataError
from homolog.core.files import atomic_path
from homolog.core.messages import shorten
from homolog.shapes import Shape
from homolog.shapes.formats.obj import ObjMesh, obj_statements, parse_obj
from homolog.shapes.formats.parsing import UnreadableError
from homolog.shapes.formats.text_lines import number_rows, text_blocks
from homolog.shapes.polygons import triangulate

_NO_MATERIAL = ""
# Where a comment may begin; before a number the mark may be part of a name.
_MARK, _MARK_OF_WORDS = re.compile(r"\s+#"), re.compile(r"\s+#(?!\d)")
_DECIMAL = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?"
_NUMBER = rf"{_DECIMAL}\s+"
# No name of a file is longer, with what may stand before it.
_LONGEST_NAME = 4096
# The values that follow options of textures, where these are not one word.
_OPTIONS = dict.fromkeys(("o", "s", "t"), f"(?i:{_NUMBER}){{1,3}}") | {"mm": f"(?i:{_NUMBER}){{1,2}}"}


@dataclass(frozen=True)
class Material:
    """What an OBJ's material says of colour.

    Args:
        image: the file of its texture; None if it has none.
        colour: red, green and blue from 0 to 1.
        scale: what texture coordinates are multiplied with.
        offset: what is added to them then.
    """

    image: Path | None = None
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)


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
    lines = [rest for key, rest in obj_statements(path) if key == "v"]
    if not lines or any(len(line.split()) != 6 for line in lines):
        return None
    colours = number_rows(lines, (3, 4, 5))
    return colours / 255.0 if colours.max() > 1.0 else colours


def read_obj_texture(path: Path) -> ObjTexture | None:
    """The images and colours of an OBJ file's materials, for the triangles that ``read_shape`` makes of it.

    None if no face has an image, and all have the same grey, which says nothing.

    Raises:
        DataError: if its materials are missing, though faces have texture coordinates.
    """
    coordinates = _Coordinates()
    for key, rest in obj_statements(path):
        coordinates.take(key, rest)
    if not coordinates.material_of:
        return None
    known = dict[str, Material]()
    for file in libraries(path, obj_statements(path), may_lack=all(number < 0 for number in coordinates.numbers)):
        known |= _materials(file)
    names = list(dict.fromkeys(coordinates.material_of))
    materials = tuple(_material(known, name) or Material() for name in names)
    if all(material.image is None for material in materials) and not tells_colours([m.colour for m in materials]):
        return None
    return coordinates.assembled(parse_obj(obj_statements(path)), names, materials)


def tells_colours(colours: Sequence[tuple[float, float, float]]) -> bool:
    """Whether the colours of materials say anything of a shape: more than one grey, which all programs write."""
    return len({*colours}) > 1 or any(len({*colour}) > 1 for colour in colours)


def libraries(path: Path, statements: Iterable[tuple[str, str]], *, may_lack: bool = False) -> list[Path]:
    """The files of materials that the statements of an OBJ file name.

    Raises:
        DataError: if one is not there, unless ``may_lack``.
    """
    named = [rest for key, rest in statements if key == "mtllib"]
    files = [file for library in named for file in _library_files(path.parent, library)]
    for file in files:
        if not file.is_file() and not may_lack:
            raise DataError(f"{file}, the materials of an OBJ file, is not there; put it beside that file")
    return [file for file in files if file.is_file()]


def obj_files(path: Path) -> list[Path]:
    """The files that an OBJ's materials and images are read from; those that are not there are left out."""
    files = libraries(path, obj_statements(path), may_lack=True)
    images = [material.image for file in files for material in _materials(file).values()]
    return [*files, *(image for image in images if image is not None and image.is_file())]


# What materials have that a transfer does not carry, and how it is called.
_NOT_CARRIED = {
    "normal maps": ("bump", "map_bump", "norm", "disp"),
    "gloss": ("map_ks", "map_ns", "refl"),
    "transparency": ("map_d",),
    "emission": ("map_ke",),
}


def looks_left_out(path: Path) -> set[str]:
    """What an OBJ's materials say of its look beside images and colours."""
    files = libraries(path, obj_statements(path), may_lack=True)
    keys = {key for file in files for key, _ in obj_statements(file)}
    return {called for called, of_it in _NOT_CARRIED.items() if keys & {*of_it}}


def missing_materials(path: Path) -> list[str]:
    """The names of materials that faces of an OBJ file have, but none of its libraries holds."""
    names, name = dict[str, None](), _NO_MATERIAL
    for key, rest in obj_statements(path):
        name = _unquoted(rest) if key == "usemtl" else name
        if key == "f":
            names[name] = None
    known = dict[str, Material]()
    for file in libraries(path, obj_statements(path), may_lack=True):
        known |= _materials(file)
    return [name for name in names if name != _NO_MATERIAL and _material(known, name) is None]


def _material(known: dict[str, Material], name: str) -> Material | None:
    """The material of a name, in another case if need be; a comment may follow the name here and in the library.

    A number behind the mark may be part of a name: ``Material #1`` is not ``Material #2``. Of several that differ
    in their comments alone the last one counts, as it does of several of one name.
    """
    lower = {other.lower(): material for other, material in known.items()}
    for spelling in _without_comments(name):
        if found := known.get(spelling, lower.get(spelling.lower())):
            return found
    bare = {spelling.lower() for spelling in _without_comments(name, numbered=False)}
    commented = [other for other in known if bare & {cut.lower() for cut in _without_comments(other, numbered=False)}]
    if commented:
        return known[commented[-1]]
    numbered = [other for other in known if name.lower() in {cut.lower() for cut in _without_comments(other)}]
    return known[numbered[0]] if len(numbered) == 1 else None


def _without_comments(name: str, *, numbered: bool = True) -> Iterator[str]:
    """A name, and then what is left of it where each of its marks of comments begins one, the last mark first.

    Args:
        name: what follows a keyword.
        numbered: whether a number may follow such a mark.
    """
    yield _unquoted(name)
    for mark in reversed([*(_MARK if numbered else _MARK_OF_WORDS).finditer(name)]):
        yield _unquoted(name[: mark.start()])


def _unquoted(name: str) -> str:
    """A name without quotes around it; a comment may follow them."""
    return name.strip().strip('"')


class _Coordinates:
    """What the statements of an OBJ file say of texture, one after the other."""

    def __init__(self) -> None:
        self.places: list[tuple[float, float]] = []
        self.numbers: list[int] = []
        self.material_of: list[str] = []
        self._material = _NO_MATERIAL

    def take(self, key: str, rest: str) -> None:
        if key == "vt":
            u, *more = rest.split()
            self.places.append((float(u), float(more[0]) if more else 0.0))
        elif key == "usemtl":
            self._material = _unquoted(rest)
        elif key == "f":
            self.numbers += [self._number(corner) for corner in rest.split()]
            self.material_of.append(self._material)

    def _number(self, corner: str) -> int:
        """The texture coordinates of a corner such as 3/7/2, which counts from 1, or backward; -1 if it has none."""
        _, _, rest = corner.partition("/")
        number = int(rest.partition("/")[0] or 0)
        return number - 1 if number > 0 else len(self.places) + number if number < 0 else -1

    def assembled(self, mesh: ObjMesh, names: list[str], materials: tuple[Material, ...]) -> ObjTexture:
        """A row per triangle; faces without coordinates have those of the image's corner."""
        numbers = np.array(self.numbers)
        if numbers.max() >= len(self.places):
            raise UnreadableError(
                f"a face names texture coordinates {numbers.max() + 1}, but there are {len(self.places)}"
            )
        # The last row stands for corners without coordinates.
        places = np.array([*self.places, (0.0, 1.0)])[numbers[triangulate(*mesh)]]
        number_of = {name: number for number, name in enumerate(names)}
        of_polygon = np.array([number_of[name] for name in self.material_of])
        material_of = np.repeat(of_polygon, mesh.sizes - 2)
        scale, offset = (np.array([getattr(m, what) for m in materials])[material_of] for what in ("scale", "offset"))
        places = places * scale[:, None] + offset[:, None]
        flipped = np.stack([places[..., 0], 1.0 - places[..., 1]], axis=-1)
        return ObjTexture(flipped, material_of, materials)


def _library_files(folder: Path, words: str) -> list[Path]:
    """The files of materials that a statement names: one whose name may hold blanks, or several."""
    words = words[:_LONGEST_NAME]
    whole = _beside(folder, words)
    names = [words] if whole.is_file() else re.findall(r'"[^"]+"|\S.*?\.mtl(?=\s|$)', words, re.IGNORECASE) or [words]
    return [_beside(folder, name) for name in names]


def _materials(library: Path) -> dict[str, Material]:
    """The materials of an MTL file, by their names."""
    found, name = dict[str, Material](), _NO_MATERIAL
    for key, rest in obj_statements(library):
        before = found.get(name, Material())
        if key == "newmtl":
            name = _unquoted(rest)
            found[name] = Material()
        elif key == "kd" and not rest.startswith(("spectral", "xyz")):
            found[name] = replace(before, colour=_colour(library, rest))
        elif key == "map_kd":
            found[name] = _textured(before, rest, library.parent)
    return found


def _colour(library: Path, words: str) -> tuple[float, float, float]:
    """Red, green and blue of a statement; one number stands for all three."""
    given = words.split()
    numbers = [float(word) for word in given if re.fullmatch(_DECIMAL, word, re.IGNORECASE)]
    if len(numbers) < len(given) or len(numbers) in (0, 2) or not all(map(math.isfinite, numbers)):
        raise DataError(
            f"{library}{_line_number(library, given)}: {shorten('Kd ' + words, 60)!r} should hold one number or three, "
            "from 0 to 1; correct it"
        )
    red, green, blue = (numbers * 3)[:3]
    return red, green, blue


def _line_number(library: Path, words: list[str]) -> str:
    """Where a colour stands; nothing if its line goes on in the next."""
    lines = (line.split() for block in text_blocks(library) for line in block.splitlines())
    found = (
        n for n, line in enumerate(lines, 1) if line[:1] and line[0].lower() == "kd" and line[1:][: len(words)] == words
    )
    number = next(found, None)
    return "" if number is None else f", line {number}"


def _textured(material: Material, words: str, folder: Path) -> Material:
    """A material with the texture that a statement names, of whose options those that move coordinates are kept."""
    moves, rest = {"s": material.scale, "o": material.offset}, words[:_LONGEST_NAME]
    while option := re.match(r"-(\w+)\s+", rest):
        name = option[1].lower()
        values = re.compile(_OPTIONS.get(name, r"\S+\s+")).match(rest, option.end())
        if values is None:
            break
        if name in moves:
            u, v, *_ = [float(word) for word in values[0].split()] + [1.0 if name == "s" else 0.0]
            moves[name] = (u, v)
        rest = rest[values.end() :]
    return replace(material, image=_beside(folder, rest), scale=moves["s"], offset=moves["o"])


def _beside(folder: Path, name: str) -> Path:
    """The file of a name, beside another file or below it.

    If need be without some of its folders, in other case, without a comment behind it, or with what ``%`` quotes.
    """
    spellings = [spelling.replace("\\", "/") for spelling in _without_comments(name)]
    for spelling in dict.fromkeys([*spellings, *map(unquote, spellings)]):
        words = Path(spelling.lstrip("/")).parts
        # An absolute path is of another machine, but its last folders may be there.
        places = (folder.joinpath(*words[first:]) for first in range(len(words)))
        for place in (folder / spelling, *places):
            if place.is_file():
                return place
            if place.parent.is_dir():
                alike = [file for file in place.parent.iterdir() if file.name.lower() == place.name.lower()]
                if alike:
                    return min(alike)
    return folder / Path(spellings[-1]).name


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
