"""PLY, text and binary of both byte orders, with polygons of any sizes mixed and lists in any element.

A reader of our own, because the one at hand refuses binary files with mixed polygons.
"""

from __future__ import annotations

import os
import re
import struct
from array import array
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float, Int, UInt8

from homolog.core.files import opened
from homolog.shapes.finding import Finding
from homolog.shapes.formats.parsing import (
    CUT_OFF,
    Arrays,
    UnreadableError,
    check_claim,
    left_out,
    lines_left_out,
    polygon_faces,
    refuse_further_lines,
    space_of,
)
from homolog.shapes.formats.text_lines import Polygons, mark_length, n_lines, number_rows, polygon_rows, text_lines
from homolog.shapes.shape import Shape

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8"},
}
_BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
# How struct calls the types of counts.
_COUNTERS = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "i8": "q", "u8": "Q"}
_INDEX_NAMES = ("vertex_indices", "vertex_index")
# The line that ends a header, bytes read at a time, and more than that line has.
_END, _BLOCK, _LONGEST_LINE = re.compile(rb"[\r\n][ \t]{0,99}(?=end_header[ \t]{0,99}(?:[\r\n]|\Z))"), 2**16, 1000
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

    def position(self, name: str) -> int:
        """The place of a scalar property among all, by its name in this case or in capitals."""
        scalars = [None if prop.count_type else prop.name for prop in self.properties]
        for spelling in (name, name.upper()):
            if spelling in scalars:
                return scalars.index(spelling)
        raise UnreadableError(f"its element {self.name} has no property {name}")

    def index_list(self) -> int:
        """The place of the list of corners of a face element."""
        for position, prop in enumerate(self.properties):
            if prop.count_type and prop.name in _INDEX_NAMES:
                return position
        raise UnreadableError("its faces have no list vertex_indices")

    def text_column(self, position: int) -> int:
        """The column of a property in lines of text, which cannot be told behind a list."""
        if any(prop.count_type for prop in self.properties[:position]):
            name = self.properties[position].name
            raise UnreadableError(f"its element {self.name} has the property {name} after a list; export it as binary")
        return position


@dataclass(frozen=True)
class _File:
    """What a file holds: the header taken apart, where it ends, and, unless it is text, the bytes behind it."""

    path: Path
    byte_order: str
    elements: list[_Element]
    header: bytes
    start: int
    body: bytes


def read(path: Path) -> Arrays:
    """Read points and faces of a PLY file; all other properties and elements are passed over."""
    file = _opened(path)
    points, polygons, notes = _parts(file, tuple("xyz"))
    if points is None:
        raise UnreadableError("it has no element vertex")
    faces = None if polygons is None else polygon_faces(points, *polygons)
    n_edges = sum(element.count for element in file.elements if element.name == "edge")
    return Arrays(points, faces, (*notes, *lines_left_out(n_edges)), space_of(file.header))


def read_ply_colours(path: Path) -> Float[np.ndarray, "n 3"] | None:
    """The red, green and blue of each point of a PLY file, from 0 to 1; None if it has none."""
    file = _opened(path)
    vertex = next((element for element in file.elements if element.name == "vertex"), None)
    types = {prop.name: prop.type for prop in vertex.properties} if vertex else {}
    if not {*_COLOURS} <= types.keys():
        return None
    values, _, _ = _parts(file, _COLOURS)
    types_of_colours = [np.dtype(types[name]) for name in _COLOURS]
    largest = [1.0 if type_.kind == "f" else float(np.iinfo(type_).max) for type_ in types_of_colours]
    return None if values is None else values / largest


def read_ply_property(path: Path, name: str) -> Float[np.ndarray, " n"] | None:
    """A number of each point of a PLY file; None if it has no such property."""
    file = _opened(path)
    vertex = next((element for element in file.elements if element.name == "vertex"), None)
    if vertex is None or not {name, name.upper()} & {prop.name for prop in vertex.properties if not prop.count_type}:
        return None
    values, _, _ = _parts(file, (name,))
    return None if values is None else values[:, 0]


def _opened(path: Path) -> _File:
    with opened(path) as file:
        mark = mark_length(file.read(4))
        file.seek(mark)
        head = _head(file)
        last = _END.search(head)
        if not head.startswith(b"ply") or last is None:
            raise UnreadableError("it has no header from 'ply' to a line 'end_header'")
        end = last.end()
        # Lines end as the first one does; some old programs write a carriage return alone.
        line_end = b"\n" if b"\n" in head[:end] else b"\r"
        start = mark + (head.find(line_end, end) + 1 or len(head))
        byte_order, elements = _parse_header(head[:end].decode("ascii", errors="replace"))
        size = file.seek(0, os.SEEK_END) - start
        for element in elements:
            if element.properties:
                check_claim(element.count, f"elements {element.name}", 1, size)
        file.seek(start)
        return _File(path, byte_order, elements, head[:end], start, b"" if byte_order == "=" else file.read())


def _head(file: BinaryIO) -> bytes:
    """The bytes up to some behind the header, or all where there is none."""
    head = bytearray()
    while block := file.read(_BLOCK):
        seen = max(len(head) - 2 * _LONGEST_LINE, 0)
        head += block
        last = _END.search(head, seen)
        if not head.startswith(b"ply") or (last is not None and last.end() < len(head) - _LONGEST_LINE):
            break
    return bytes(head)


_Parts = tuple[Float[np.ndarray, "n 3"] | None, Polygons | None, tuple[Finding, ...]]


def _parts(file: _File, columns: tuple[str, ...]) -> _Parts:
    """Some properties of the points, the faces, and notes."""
    return _read_text(file, columns) if file.byte_order == "=" else _read_binary(file, columns)


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
            case ["ply" | "comment" | "obj_info", *_] | []:
                pass
            case _:
                raise UnreadableError(f"its header has a line that is not understood: {line[:50]!r}")
    if not byte_order:
        raise UnreadableError("its header does not say whether it is ascii or binary")
    return byte_order, elements


def _read_text(file: _File, columns: tuple[str, ...]) -> _Parts:
    left = n_lines(text_lines(file.path, start=file.start))
    lines = text_lines(file.path, start=file.start)
    points, polygons = None, None
    for element in file.elements:
        count = element.count if element.properties else 0
        rows, left = islice(lines, count), left - count
        if left < 0:
            raise UnreadableError(f"it ends before the last element {element.name}; {CUT_OFF}")
        if element.name == "vertex":
            points = number_rows(rows, [element.text_column(element.position(name)) for name in columns])
        elif element.name == "face" and count:
            polygons = polygon_rows(rows, element.text_column(element.index_list()))
        deque(rows, maxlen=0)  # of other elements
    refuse_further_lines(left, ", ".join(f"{element.count} {element.name}" for element in file.elements))
    return points, polygons, ()


def _read_binary(file: _File, columns: tuple[str, ...]) -> _Parts:
    points, polygons, offset = None, None, 0
    for element in file.elements:
        rows = _Rows(file, element, offset)
        if element.name == "vertex":
            points = np.stack([rows.scalars(element.position(name)) for name in columns], axis=1)
        elif element.name == "face" and element.count:
            polygons = rows.lists(element.index_list())
        offset = rows.end
    over = len(file.body.rstrip(b"\r\n")) - offset
    notes = (left_out("bytes after the last element", over, "the header announces no more"),) if over > 0 else ()
    return points, polygons, notes


class _Rows:
    """The rows of a binary element, and where in each of them a property lies.

    Rows whose lists all have the sizes of the first row's are found at once, others one after the other.
    """

    def __init__(self, file: _File, element: _Element, offset: int) -> None:
        self._body, self._order, self._element = file.body, file.byte_order, element
        self._stride: int | None = None
        self._row_starts, self._list_starts, self._sizes, self.end = self._walked(offset, min(element.count, 1))
        if element.count > 1 and element.properties and not self._alike(offset):
            self._stride = None
            self._row_starts, self._list_starts, self._sizes, self.end = self._walked(offset, element.count)
        if self.end > len(self._body):
            raise self._too_short()

    def _alike(self, offset: int) -> bool:
        """Take all rows to be as long as the first one, and say whether they are."""
        self._stride, sizes = self.end - offset, self._sizes
        steps = self._stride * np.arange(self._element.count)[:, None]
        self._row_starts, self._list_starts = self._row_starts + steps[:, 0], self._list_starts + steps
        self._sizes, self.end = np.repeat(sizes, len(steps), axis=0), offset + len(steps) * self._stride
        if self.end > len(self._body):
            return False
        count_types = [prop.count_type for prop in self._element.properties if prop.count_type]
        counts = [
            self._values(starts - int(type_[1]), type_)
            for starts, type_ in zip(self._list_starts.T, count_types, strict=True)
        ]
        return all(np.array_equal(found, wanted) for found, wanted in zip(counts, self._sizes.T, strict=True))

    def _walked(self, offset: int, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """Where each row begins, where the values of its lists begin, and their sizes; and where the last row ends."""
        lists, after = self._lists()
        # Numbers of eight bytes each, where objects would take many times the memory of the file.
        row_starts, list_starts, sizes = array("q"), array("q"), array("q")
        try:
            for _ in range(count):
                row_starts.append(offset)
                for before, counter, width in lists:
                    (size,) = counter.unpack_from(self._body, offset + before)
                    if not 0 <= size <= len(self._body):
                        raise self._too_short()
                    offset += before + counter.size
                    list_starts.append(offset)
                    sizes.append(size)
                    offset += size * width
                offset += after
        except struct.error:
            raise self._too_short() from None
        shape = (count, len(lists))
        starts = np.array(list_starts).reshape(shape)
        return np.array(row_starts), starts, np.array(sizes).reshape(shape), offset

    def _lists(self) -> tuple[list[tuple[int, struct.Struct, int]], int]:
        """The bytes before each list, its counter and the bytes of one of its values; and the bytes behind the last."""
        found, gap = list[tuple[int, struct.Struct, int]](), 0
        for prop in self._element.properties:
            width = int(prop.type[1])
            if prop.count_type:
                found.append((gap, struct.Struct(self._order + _COUNTERS[prop.count_type]), width))
            gap = 0 if prop.count_type else gap + width
        return found, gap

    def _too_short(self) -> UnreadableError:
        return UnreadableError(f"it ends before the last element {self._element.name}; {CUT_OFF}")

    def scalars(self, position: int) -> Float[np.ndarray, " m"]:
        """A scalar property of all rows."""
        places, number = self._row_starts, 0
        for before in self._element.properties[:position]:
            width = int(before.type[1])
            if before.count_type:
                places = self._list_starts[:, number] + self._sizes[:, number] * width
                number += 1
            else:
                places = places + width
        return self._values(places, self._element.properties[position].type).astype(np.float64)

    def _values(self, places: Int[np.ndarray, " m"], type_: str) -> np.ndarray:
        dtype = np.dtype(self._order + type_)
        if not len(places) or self._stride is not None:
            first = places[0] if len(places) else 0
            return np.ndarray((len(places),), dtype, self._body, first, (self._stride or 0,))
        which = places[:, None] + np.arange(dtype.itemsize)
        return np.ascontiguousarray(np.frombuffer(self._body, np.uint8)[which]).view(dtype)[:, 0]

    def lists(self, position: int) -> Polygons:
        """The sizes and the values of a list property of all rows."""
        prop = self._element.properties[position]
        number = sum(before.count_type is not None for before in self._element.properties[:position])
        sizes, starts = self._sizes[:, number], self._list_starts[:, number]
        # Bytes within the lists are those after more beginnings than ends.
        edges = np.zeros(len(self._body) + 1, dtype=np.int8)
        edges[starts[sizes > 0]] = 1
        edges[(starts + sizes * int(prop.type[1]))[sizes > 0]] = -1
        within = np.frombuffer(self._body, np.uint8)[np.cumsum(edges[:-1], dtype=np.int8).astype(bool)]
        return sizes, within.view(self._order + prop.type).astype(np.int64)


def write(
    path: Path,
    shape: Shape,
    colours: UInt8[np.ndarray, "n 3"] | None = None,
    numbers: Mapping[str, Float[np.ndarray, " n"]] | None = None,
) -> None:
    """Write a binary PLY file in double precision, with colours and numbers of the points if there are any."""
    numbers = numbers or {}
    columns = {"x": "double", "y": "double", "z": "double", **dict.fromkeys(numbers, "double")}
    columns |= {} if colours is None else dict.fromkeys(_COLOURS, "uchar")
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {shape.n_points}"]
    head += [f"property {type_} {name}" for name, type_ in columns.items()]
    if shape.faces is not None:
        head += [f"element face {shape.n_faces}", "property list uchar int vertex_indices"]
    n_colours = 0 if colours is None else len(_COLOURS)
    points = np.zeros(shape.n_points, [("xyz", "<f8", 3), ("numbers", "<f8", len(numbers)), ("rgb", "u1", n_colours)])
    points["xyz"] = shape.points
    points["numbers"] = np.reshape([*numbers.values()], (len(numbers), shape.n_points)).T
    points["rgb"] = 0 if colours is None else colours
    faces = np.zeros(shape.n_faces, [("size", "u1"), ("corners", "<i4", 3)])
    faces["size"], faces["corners"] = 3, 0 if shape.faces is None else shape.faces
    path.write_bytes("\n".join([*head, "end_header\n"]).encode() + points.tobytes() + faces.tobytes())
