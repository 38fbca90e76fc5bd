"""Reading and writing VTK's own files: legacy .vtk, and the XML formats .vtp and .vtu."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from homolog.core.errors import MissingExtraError, ShapeError
from homolog.shapes.formats.parsing import (
    CUT_OFF,
    Arrays,
    UnreadableError,
    check_claim,
    polygon_faces,
    shorten,
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
# No compressor of VTK makes data smaller than this.
_MOST_COMPRESSION = 1100
# Within so many seconds VTK has read any file that is whole.
_SECONDS = 30.0
_SECONDS_PER_BYTE = 2e-6
# The exit code of vtk_process.py that comes with a reason.
_REFUSED = 3


# The kinds of XML data sets that are read.
_XML_KINDS = {"PolyData": ".vtp", "UnstructuredGrid": ".vtu"}


def read(path: Path) -> Arrays:
    """Read the points and the surface of poly data or an unstructured grid, legacy or XML, as the content says.

    Of volume cells the outer surface is read. Faces of quadratic cells go through the points on their edges.
    """
    content = path.read_bytes()
    return _load(path, ".vtk" if content.startswith(b"# vtk") else _xml_kind(content), content)


def _check_legacy(content: bytes) -> None:
    kind = _LEGACY_KIND.search(content)
    if kind is None or kind[1].lower() not in (b"polydata", b"unstructured_grid"):
        found = "no data set" if kind is None else f"a data set {kind[1].decode().upper()}"
        raise UnreadableError(f"it holds {found}, but POLYDATA or UNSTRUCTURED_GRID is needed")
    for match in _LEGACY_COUNTS.finditer(content):
        for count in filter(None, match.groups()):
            check_claim(int(count), "values", 1, len(content))


def _check_xml(content: bytes) -> None:
    if not content.rstrip().endswith(b"</VTKFile>"):
        raise UnreadableError(f"it does not end with </VTKFile>; {CUT_OFF}")
    for match in _XML_COUNTS.finditer(content):
        check_claim(int(match[1]), "values", 1, _MOST_COMPRESSION * len(content))


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
    script = Path(__file__).with_name("vtk_process.py")
    command = [sys.executable, "-I", "-W", "ignore", str(script), str(path.resolve()), suffix, json.dumps(sys.path)]
    limit = _SECONDS + len(content) * _SECONDS_PER_BYTE
    try:
        done = subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL, check=False, timeout=limit)
    except subprocess.TimeoutExpired:
        raise UnreadableError(f"VTK has not read it within {limit:.0f} s; {CUT_OFF}") from None
    if done.returncode:
        # Exit codes other than the one that comes with a reason are crashes.
        said = (
            shorten(done.stderr.decode(errors="replace"), 120)
            if done.returncode == _REFUSED
            else "VTK cannot take it in"
        )
        # A reason that says itself what to do is not about damage.
        raise UnreadableError(said if "; " in said else f"{said}; {CUT_OFF}")
    stream = BytesIO(done.stdout)
    points, sizes, corners, strip_sizes, strip_corners = (np.load(stream, allow_pickle=False) for _ in range(5))
    points = points.astype(np.float64)
    faces = np.concatenate([polygon_faces(points, sizes, corners), strip_corners[strips(strip_sizes)]])
    return Arrays(points, faces if len(faces) else None, space=space_of(content[:256]))


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
