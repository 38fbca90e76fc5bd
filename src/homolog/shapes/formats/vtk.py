"""Reading and writing VTK's own files: legacy .vtk, and the XML formats .vtp and .vtu."""

from __future__ import annotations

import re
from importlib.util import find_spec
from pathlib import Path
from typing import Any

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
_XML_PIECE = re.compile(rb"<Piece\b(?P<head>[^>]*)>(?P<body>.*?)</Piece>", re.DOTALL)
_XML_ASCII = rb"""<DataArray\b(?=[^>]*\bformat\s*=\s*["']ascii)%s[^>]*>([^<]*)<"""
# Per kind of cells, the array of text that has a number for each of them; of points it has three.
_XML_SECTIONS = {
    b"Points": re.compile(rb"<Points\b[^>]*>\s*" + _XML_ASCII % b""),
    **{
        kind: re.compile(
            rb"<%s\b[^>]*>(?:(?!</%s>).)*?" % (kind, kind) + _XML_ASCII % rb"""(?=[^>]*\bName\s*=\s*["']offsets)""",
            re.DOTALL,
        )
        for kind in (b"Verts", b"Lines", b"Strips", b"Polys", b"Cells")
    },
}
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
    _check_piece_counts(content)
    announced = sum(_LEAST_BYTES * int(match[1][:_DIGITS]) for match in _XML_COUNTS.finditer(content))
    if fault := expansion_fault(announced, len(content)):
        raise UnreadableError(fault)


def _check_piece_counts(content: bytes) -> None:
    """Refuse arrays of text that hold more points or cells than their piece announces, which VTK passes over."""
    for piece in _XML_PIECE.finditer(content):
        for kind, section in _XML_SECTIONS.items():
            announced = re.search(rb"""\bNumberOf%s\s*=\s*["']\s*(\d+)""" % kind, piece["head"])
            held = re.search(section, piece["body"])
            if announced is None or held is None:
                continue
            count, found = int(announced[1][:_DIGITS]), len(held[1].split()) // (3 if kind == b"Points" else 1)
            if found > count:
                what = kind.decode().lower()
                raise UnreadableError(
                    f"a piece of it announces {count} {what}, but holds {found}; correct the count, or export it again"
                )


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
