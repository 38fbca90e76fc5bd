"""Reading and writing VTK's own files: legacy .vtk, and the XML formats .vtp and .vtu."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Int

from homolog.core.errors import MissingExtraError, ShapeError
from homolog.core.files import read_bytes
from homolog.core.memory import expansion_fault
from homolog.core.messages import shorten
from homolog.core.reader_process import ReaderProcessError, read_in_process
from homolog.shapes.formats.parsing import (
    CUT_OFF,
    Arrays,
    UnreadableError,
    check_claim,
    lines_left_out,
    polygon_faces,
    space_of,
)
from homolog.shapes.formats.text_lines import mark_length
from homolog.shapes.polygons import strips
from homolog.shapes.shape import Shape

# Lines of a legacy file that announce how many of something follow, and the data arrays of a FIELD.
_LEGACY_COUNTS = re.compile(
    rb"^[ \t]*(?:(?:points|vertices|lines|polygons|triangle_strips|cells|cell_types|point_data|cell_data"
    rb"|field[ \t]+\S+)"
    rb"[ \t]+(\d+)(?:[ \t]+(\d+))?|\S+[ \t]+(\d+)[ \t]+(\d+)[ \t]+[a-z_]+\s*$)",
    re.IGNORECASE | re.MULTILINE,
)
_LEGACY_KIND = re.compile(rb"^[ \t]*dataset[ \t]+(\w+)", re.IGNORECASE | re.MULTILINE)
_XML_COUNTS = re.compile(rb"""\bNumberOf\w+\s*=\s*["']\s*(\d+)""")
# The parts of a piece that the head of it counts.
_XML_SECTIONS = (b"Points", b"Verts", b"Lines", b"Strips", b"Polys", b"Cells")
_XML_ARRAY = re.compile(rb"<DataArray\b(?P<head>[^<>]*)>(?P<text>[^<]*)")
_XML_ATTRIBUTE = re.compile(rb"""\b(\w+)\s*=\s*["']\s*([^"']*)""")
_XML_APPENDED = re.compile(rb"<AppendedData\b([^<>]*)>\s*_")
# Characters that hold the words before the numbers of an array, with what blanks there may be.
_XML_WORDS = 100
# Of a point or of a cell, once it is expanded.
_LEAST_BYTES = 12
# A number of more digits is too large in any case.
_DIGITS = 20
_PROCESS = Path(__file__).with_name("vtk_process.py")


# The kinds of XML data sets that are read.
_XML_KINDS = {"PolyData": ".vtp", "UnstructuredGrid": ".vtu"}


def read(path: Path) -> Arrays:
    """Read the points and the surface of poly data or an unstructured grid, legacy or XML, as the content says.

    Of volume cells the outer surface is read. Faces of quadratic cells go through the points on their edges.
    """
    content = read_bytes(path)
    content = content[mark_length(content[:4]) :]
    return _load(path, ".vtk" if content.startswith(b"# vtk") else _xml_kind(content), content)


def _check_legacy(content: bytes) -> None:
    kind = _LEGACY_KIND.search(content)
    if kind is None or kind[1].lower() not in (b"polydata", b"unstructured_grid"):
        found = "no data set" if kind is None else f"a data set {kind[1].decode().upper()}"
        raise UnreadableError(f"it holds {found}, but POLYDATA or UNSTRUCTURED_GRID is needed")
    for match in _LEGACY_COUNTS.finditer(content):
        for count in filter(None, match.groups()):
            check_claim(int(count[:_DIGITS]), "values", 1, len(content))


def _check_xml(content: bytes) -> None:
    if not content.rstrip().endswith(b"</VTKFile>"):
        raise UnreadableError(f"it does not end with </VTKFile>; {CUT_OFF}")
    announced = sum(_LEAST_BYTES * int(match[1][:_DIGITS]) for match in _XML_COUNTS.finditer(content))
    if fault := expansion_fault(announced, len(content)):
        raise UnreadableError(fault)
    _check_piece_counts(content)


def _check_piece_counts(content: bytes) -> None:
    """Refuse arrays that hold other numbers of points or cells than their piece announces; VTK passes over more."""
    numbers = _XmlNumbers(content)
    for head, piece in _elements(content, b"Piece"):
        counts = dict(_XML_ATTRIBUTE.findall(head))
        for kind in _XML_SECTIONS:
            count = int(counts.get(b"NumberOf" + kind, b"0").strip()[:_DIGITS] or 0)
            section = next((section for _, section in _elements(piece, kind)), b"")
            found = numbers.count(section, kind)
            if found not in (count, None):
                announced = f"a piece of it announces {count} {kind.decode().lower()}"
                raise UnreadableError(f"{announced}, but holds {found}; correct the count, or export it again")


def _elements(content: bytes, name: bytes) -> Iterator[tuple[bytes, bytes]]:
    """The attributes and the content of each element of a name; none behind one that does not end."""
    opening, end = re.compile(rb"<%s\b([^<>]*)>" % name), 0
    while begin := opening.search(content, end):
        end = content.find(b"</%s>" % name, begin.end())
        if end < 0:
            return
        yield begin[1], content[begin.end() : end]


class _XmlNumbers:
    """How many numbers the arrays of an XML file hold, as text, inline or appended, compressed or not."""

    def __init__(self, content: bytes) -> None:
        root = re.search(rb"<VTKFile\b[^>]*", content[:2000])
        told = dict(_XML_ATTRIBUTE.findall(root[0])) if root else {}
        self._word = 8 if told.get(b"header_type") == b"UInt64" else 4
        self._order: Literal["big", "little"] = "big" if told.get(b"byte_order") == b"BigEndian" else "little"
        self._compressed, self._content = bool(told.get(b"compressor")), content
        appended = _XML_APPENDED.search(content)
        self._appended = len(content) if appended is None else appended.end()
        self._is_raw = appended is not None and dict(_XML_ATTRIBUTE.findall(appended[1])).get(b"encoding") == b"raw"

    def count(self, section: bytes, kind: bytes) -> int | None:
        """The number of points or cells that a section holds, by the ends of these; None where it cannot be told."""
        for array in _XML_ARRAY.finditer(section):
            told = dict(_XML_ATTRIBUTE.findall(array["head"]))
            if kind == b"Points" or told.get(b"Name", b"") == b"offsets":
                numbers = self._numbers(told, array)
                return None if numbers is None else numbers // (3 if kind == b"Points" else 1)
        return 0

    def _numbers(self, told: dict[bytes, bytes], array: re.Match[bytes]) -> int | None:
        if told.get(b"format") == b"ascii":
            return len(array["text"].split())
        bits = re.fullmatch(rb"(?:Float|Int|UInt)(8|16|32|64)", told.get(b"type", b""))
        offset = told.get(b"offset", b"0").strip()
        if bits is None or not offset.isdigit():
            return None
        is_appended = told.get(b"format") == b"appended"
        first = self._appended + int(offset[:_DIGITS]) if is_appended else array.start("text")
        start = (self._content if is_appended else array.string)[first : first + _XML_WORDS]
        n_bytes = self._n_bytes(start, is_raw=is_appended and self._is_raw)
        return None if n_bytes is None else n_bytes // (int(bits[1]) // 8)

    def _n_bytes(self, start: bytes, *, is_raw: bool) -> int | None:
        """The bytes of an array, once expanded, by the words before them; None where these are damaged."""
        n_words = 3 if self._compressed else 1
        size = n_words * self._word
        try:
            # Groups of four characters hold three bytes.
            head = start if is_raw else base64.b64decode(b"".join(start.split())[: -(-size // 3) * 4])
        except ValueError:
            return None
        words = [int.from_bytes(head[at : at + self._word], self._order) for at in range(0, size, self._word)]
        if len(head) < (size if words[0] else self._word):
            return None
        if not self._compressed or not words[0]:
            return words[0]
        n_blocks, block, last = words
        return (n_blocks - 1) * block + last if last else n_blocks * block


def _xml_kind(content: bytes) -> str:
    """The suffix of files that hold what this one says it holds."""
    root = re.search(rb"<VTKFile\b[^>]*", content[:2000])
    kind = re.search(rb"""\btype\s*=\s*["'](\w+)""", root[0]) if root else None
    if kind is None:
        raise UnreadableError("it does not start with '# vtk DataFile' or <VTKFile>")
    name = kind[1].decode()
    if name not in _XML_KINDS:
        raise UnreadableError(f"it holds a data set {name}, but PolyData or UnstructuredGrid is needed")
    return _XML_KINDS[name]


def _load(path: Path, suffix: str, content: bytes) -> Arrays:
    """Read the file in a second process, which damaged content may end without any harm here."""
    (_check_legacy if suffix == ".vtk" else _check_xml)(content)
    if find_spec("vtkmodules") is None:
        raise _missing()
    space = space_of(content[:256])
    del content
    try:
        found = read_in_process(_PROCESS, path, suffix, library="VTK")
    except ReaderProcessError as error:
        said = shorten(error, 120)
        # A reason that says itself what to do is not about damage.
        raise UnreadableError(said if "; " in said else f"{said}; {CUT_OFF}") from None
    points = found["points"].astype(np.float64)
    of_strips = found["strip_corners"][strips(found["strip_sizes"])]
    faces = np.concatenate([polygon_faces(points, found["sizes"], found["corners"]), of_strips])
    notes = lines_left_out(int(found["n_lines"]))
    return Arrays(points, faces if len(faces) else None, notes, space)


def surface_of(data: Any) -> tuple[np.ndarray, Int[np.ndarray, " m"], Int[np.ndarray, " c"]]:
    """The points of VTK's poly data or unstructured grid, and the sizes and corners of its outer polygons.

    Raises:
        ShapeError: if its cells cannot be used.
    """
    from homolog.shapes.formats.vtk_process import surface

    try:
        points, sizes, corners, strip_sizes, strip_corners = surface(data)
    except ValueError as error:
        raise ShapeError(f"a VTK data set cannot be used: {error}") from None
    of_strips = strip_corners[strips(strip_sizes)]
    return points, np.append(sizes, np.full(len(of_strips), 3)), np.append(corners, of_strips.ravel())


def _missing() -> MissingExtraError:
    return MissingExtraError("Reading and writing VTK, VTP and VTU files", "vtk", "vtk")


def write_vtk(path: Path, shape: Shape) -> None:
    """Write a legacy VTK file, binary, in double precision."""
    _save(path, shape, ".vtk")


def write_vtp(path: Path, shape: Shape) -> None:
    """Write a VTP file in double precision."""
    _save(path, shape, ".vtp")


def write_vtu(path: Path, shape: Shape) -> None:
    """Write a VTU file in double precision."""
    _save(path, shape, ".vtu")


def _save(path: Path, shape: Shape, suffix: str) -> None:
    try:
        from vtkmodules.vtkIOLegacy import vtkPolyDataWriter
        from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

        from homolog.shapes.formats.vtk_process import collected_messages, reason
    except ImportError:
        raise _missing() from None

    writers = {".vtk": vtkPolyDataWriter, ".vtp": vtkXMLPolyDataWriter, ".vtu": vtkXMLUnstructuredGridWriter}
    writer: Any = writers[suffix]()
    if suffix == ".vtk":
        writer.SetFileTypeToBinary()
    with collected_messages() as messages:
        writer.SetFileName(str(path))
        writer.SetInputData(_data_set(shape, suffix))
        written = writer.Write()
    if not written or messages.GetOutput():
        raise OSError(reason(messages.GetOutput()))


def _data_set(shape: Shape, suffix: str) -> Any:
    from vtkmodules.util import numpy_support
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import VTK_TRIANGLE, VTK_VERTEX, vtkPolyData, vtkUnstructuredGrid

    data: Any = vtkUnstructuredGrid() if suffix == ".vtu" else vtkPolyData()
    numpy_to_vtk: Any = numpy_support.numpy_to_vtk
    points = vtkPoints()
    points.SetData(numpy_to_vtk(shape.points, deep=True))
    data.SetPoints(points)
    if suffix == ".vtu":
        data.SetCells(VTK_VERTEX if shape.faces is None else VTK_TRIANGLE, _cells(shape))
    elif shape.faces is None:
        data.SetVerts(_cells(shape))
    else:
        data.SetPolys(_cells(shape))
    return data


def _cells(shape: Shape) -> Any:
    """The faces, or a cell per point: VTK shows nothing that is not a cell."""
    from vtkmodules.util import numpy_support
    from vtkmodules.vtkCommonDataModel import vtkCellArray

    corners = np.arange(shape.n_points)[:, None] if shape.faces is None else shape.faces
    offsets = np.arange(len(corners) + 1) * corners.shape[1]
    to_vtk: Any = numpy_support.numpy_to_vtkIdTypeArray
    cells = vtkCellArray()
    cells.SetData(*(to_vtk(a.astype(np.int64).ravel(), deep=True) for a in (offsets, corners)))
    return cells
