"""Reading PLY, text and binary of both byte orders, with polygons of any sizes mixed.

A reader of our own, because the one at hand refuses binary files with mixed polygons.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from homolog.shapes.parsing import (
    CUT_OFF,
    Arrays,
    UnreadableError,
    check_claim,
    content_lines,
    fan_triangles,
    number_rows,
    polygon_rows,
)

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8"},
}
_BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_INDEX_NAMES = ("vertex_indices", "vertex_index")
_COLOURS = ("red", "green", "blue")


@dataclass(frozen=True)
class _Property:
    name: str
    type: str
    count_type: str | None = None  # of a list


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)

    @property
    def has_lists(self) -> bool:
        return any(p.count_type for p in self.properties)

    def position(self, name: str) -> int:
        """The column of a property, which must not come after a list."""
        for position, prop in enumerate(self.properties):
            if prop.name == name:
                return position
            if prop.count_type:
                break
        raise UnreadableError(f"its element {self.name} has no property {name}, or one that stands after a list")

    def index_list(self) -> _Property:
        """The list of corners of a face element."""
        for prop in self.properties:
            if prop.count_type and prop.name in _INDEX_NAMES:
                return prop
        raise UnreadableError("its faces have no list vertex_indices")


def read_ply(path: Path) -> Arrays:
    """Read points and faces of a PLY file; all other properties and elements are passed over."""
    body, byte_order, elements = _opened(path)
    points, faces = _read_parts(body, byte_order, elements, tuple("xyz"))
    if points is None:
        raise UnreadableError("it has no element vertex")
    return Arrays(points, faces)


def read_ply_colours(path: Path) -> Float[np.ndarray, "n 3"] | None:
    """The red, green and blue of each point of a PLY file, from 0 to 1; None if it has none."""
    body, byte_order, elements = _opened(path)
    vertex = next((element for element in elements if element.name == "vertex"), None)
    types = {prop.name: prop.type for prop in vertex.properties} if vertex else {}
    if not {*_COLOURS} <= types.keys():
        return None
    values, _ = _read_parts(body, byte_order, elements, _COLOURS)
    types_of_colours = [np.dtype(types[name]) for name in _COLOURS]
    largest = [1.0 if type_.kind == "f" else float(np.iinfo(type_).max) for type_ in types_of_colours]
    return None if values is None else values / largest


def _opened(path: Path) -> tuple[bytes, str, list[_Element]]:
    """What comes after the header, the byte order, and what the header announces."""
    content = path.read_bytes()
    header = re.match(rb"ply\s*?\n.*?^end_header[ \t]*\r?\n", content, re.DOTALL | re.MULTILINE)
    if header is None:
        raise UnreadableError("it has no header from 'ply' to 'end_header'")
    byte_order, elements = _parse_header(header[0].decode("ascii", errors="replace"))
    for element in elements:
        if element.properties:
            check_claim(element.count, f"elements {element.name}", 1, len(content) - header.end())
    return content[header.end() :], byte_order, elements


_Parts = tuple[Float[np.ndarray, "n 3"] | None, Int[np.ndarray, "m 3"] | None]


def _read_parts(body: bytes, byte_order: str, elements: list[_Element], columns: tuple[str, ...]) -> _Parts:
    """Some properties of the points, and the faces."""
    if byte_order == "=":
        return _read_text(body, elements, columns)
    return _read_binary(body, elements, byte_order, columns)


def _parse_header(text: str) -> tuple[str, list[_Element]]:
    byte_order, elements = "", list[_Element]()
    for line in text.splitlines():
        match line.split():
            case ["format", name, *_] if name in _BYTE_ORDERS:
                byte_order = _BYTE_ORDERS[name]
            case ["element", "tristrips", *_]:
                raise UnreadableError("it holds triangle strips; export it with plain faces")
            case ["element", name, count] if count.isdecimal():
                elements.append(_Element(name, int(count)))
            case ["property", "list", count_type, type_, name] if elements and {count_type, type_} <= _TYPES.keys():
                elements[-1].properties.append(_Property(name, _TYPES[type_], _TYPES[count_type]))
            case ["property", type_, name] if elements and type_ in _TYPES:
                elements[-1].properties.append(_Property(name, _TYPES[type_]))
            case ["ply" | "comment" | "obj_info" | "end_header", *_] | []:
                pass
            case _:
                raise UnreadableError(f"its header has a line that is not understood: {line[:50]!r}")
    if not byte_order:
        raise UnreadableError("its header does not say whether it is ascii or binary")
    return byte_order, elements


def _read_text(body: bytes, elements: list[_Element], columns: tuple[str, ...]) -> _Parts:
    lines = content_lines(body.decode("ascii", errors="replace"))
    points, faces = None, None
    for element in elements:
        count = element.count if element.properties else 0
        rows, lines = lines[:count], lines[count:]
        if len(rows) < count:
            raise UnreadableError(f"it ends before the last element {element.name}; {CUT_OFF}")
        if element.name == "vertex":
            points = number_rows(rows, [element.position(name) for name in columns])
        elif element.name == "face" and rows:
            faces = polygon_rows(rows, element.position(element.index_list().name))
    return points, faces


def _read_binary(body: bytes, elements: list[_Element], byte_order: str, columns: tuple[str, ...]) -> _Parts:
    points, faces, offset = None, None, 0
    for element in elements:
        wanted = element.index_list() if element.name == "face" and element.count else None
        if element.has_lists and element.count:
            lists, offset = _binary_lists(body, offset, element, byte_order, wanted)
            faces = fan_triangles(*lists) if wanted else faces
            continue
        rows, offset = _binary_rows(body, offset, element, byte_order)
        if element.name == "vertex":
            values = [rows[f"{element.position(name)}"].astype(np.float64) for name in columns]
            points = np.stack(values, axis=1)
    return points, faces


def _binary_rows(body: bytes, offset: int, element: _Element, byte_order: str) -> tuple[np.ndarray, int]:
    # Named by position: two properties of a file may have the same name.
    dtype = np.dtype([(f"{i}", byte_order + p.type) for i, p in enumerate(element.properties)])
    end = offset + element.count * dtype.itemsize
    if end > len(body):
        raise UnreadableError(f"it ends before the last element {element.name}; {CUT_OFF}")
    rows = np.frombuffer(body, dtype, count=element.count if dtype.itemsize else 0, offset=offset)
    return rows, end


_Lists = tuple[Int[np.ndarray, " m"], Int[np.ndarray, " c"]]


def _binary_lists(
    body: bytes, offset: int, element: _Element, byte_order: str, wanted: _Property | None
) -> tuple[_Lists, int]:
    """The wanted list of each row, and where the element ends: at once if all rows are alike."""
    alike = _lists_alike(body, offset, element, byte_order, wanted)
    return alike if alike is not None else _lists_one_by_one(body, offset, element, byte_order, wanted)


def _lists_alike(
    body: bytes, offset: int, element: _Element, byte_order: str, wanted: _Property | None
) -> tuple[_Lists, int] | None:
    fields: list[tuple[str, str, int]] = []
    for prop, size, _ in _walk_row(body, offset, element, byte_order):
        if prop.count_type:
            fields.append((f"count {prop.name}", byte_order + prop.count_type, 1))
        fields.append((prop.name, byte_order + prop.type, size))
    if len({name for name, _, _ in fields}) < len(fields):
        return None
    dtype = np.dtype([(name, type_, (size,)) for name, type_, size in fields])
    end = offset + element.count * dtype.itemsize
    if end > len(body):
        return None
    rows = np.frombuffer(body, dtype, count=element.count, offset=offset)
    for name, _, _ in fields:
        if name.startswith("count ") and np.any(rows[name] != rows[name][0]):
            return None
    if wanted is None:
        return (np.zeros(0, np.int64), np.zeros(0, np.int64)), end
    corners = rows[wanted.name].astype(np.int64)
    return (np.full(len(rows), corners.shape[1]), corners.ravel()), end


def _lists_one_by_one(
    body: bytes, offset: int, element: _Element, byte_order: str, wanted: _Property | None
) -> tuple[_Lists, int]:
    # The place of a row is known only after the one before it.
    found: list[np.ndarray] = []
    for _ in range(element.count):
        for prop, size, start in _walk_row(body, offset, element, byte_order):
            type_ = np.dtype(byte_order + prop.type)
            if prop is wanted:
                found.append(np.frombuffer(body, type_, count=size, offset=start))
            offset = start + size * type_.itemsize
    sizes = np.array([len(corners) for corners in found], dtype=np.int64)
    corners = np.concatenate([*found, np.zeros(0, np.int64)]).astype(np.int64)
    return (sizes, corners), offset


def _walk_row(body: bytes, offset: int, element: _Element, byte_order: str) -> Iterator[tuple[_Property, int, int]]:
    """Each property of the row at ``offset``: itself, how many values, and where they start."""
    order: Literal["little", "big"] = "little" if byte_order == "<" else "big"
    for prop in element.properties:
        size = 1
        if prop.count_type:
            width = int(prop.count_type[1])
            size = int.from_bytes(body[offset : offset + width], order, signed=prop.count_type[0] == "i")
            offset += width
        end = offset + size * int(prop.type[1])
        if size < 0 or end > len(body):
            raise UnreadableError(f"it ends before the last element {element.name}; {CUT_OFF}")
        yield prop, size, offset
        offset = end
