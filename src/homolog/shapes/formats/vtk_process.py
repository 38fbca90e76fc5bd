"""VTK in a process of its own, because on a damaged file it ends the whole process.

``homolog.core.reader_process`` calls ``read``. This imports nothing of Homolog, to start fast. Writing uses some of it.
"""

from __future__ import annotations

import codecs
import re
import textwrap
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from vtkmodules.util import numpy_support
from vtkmodules.vtkCommonCore import vtkLogger, vtkOutputWindow, vtkStringOutputWindow
from vtkmodules.vtkCommonDataModel import (
    VTK_BIQUADRATIC_QUAD,
    VTK_BIQUADRATIC_TRIANGLE,
    VTK_CONVEX_POINT_SET,
    VTK_PIXEL,
    VTK_POLYGON,
    VTK_POLYHEDRON,
    VTK_QUAD,
    VTK_QUADRATIC_LINEAR_QUAD,
    VTK_QUADRATIC_POLYGON,
    VTK_QUADRATIC_QUAD,
    VTK_QUADRATIC_TRIANGLE,
    VTK_TRIANGLE,
    VTK_TRIANGLE_STRIP,
    vtkGenericCell,
)
from vtkmodules.vtkFiltersGeometry import vtkGeometryFilter
from vtkmodules.vtkIOLegacy import vtkGenericDataObjectReader
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLUnstructuredGridReader

# Not typed by VTK.
vtk_to_numpy: Any = numpy_support.vtk_to_numpy

_BLANKS_LEFT = 32

# What a legacy file announces of its cells, and with which function a data set gives them.
_LEGACY_CELLS = {
    "GetPolys": re.compile(rb"^[ \t]*polygons[ \t]+(\d+)[ \t]+(\d+)", re.IGNORECASE | re.MULTILINE),
    "GetStrips": re.compile(rb"^[ \t]*triangle_strips[ \t]+(\d+)[ \t]+(\d+)", re.IGNORECASE | re.MULTILINE),
    "GetCells": re.compile(rb"^[ \t]*cells[ \t]+(\d+)[ \t]+(\d+)", re.IGNORECASE | re.MULTILINE),
}


def read(path: str, suffix: str) -> dict[str, np.ndarray]:
    """What ``surface`` gives of a file, by name, and the number of its lines."""
    data = load(Path(path), suffix)
    if suffix == ".vtk":
        _check_counts(data, Path(path).read_bytes())
    arrays = *surface(data), np.array(_line_count(data))
    return dict(zip(("points", "sizes", "corners", "strip_sizes", "strip_corners", "n_lines"), arrays, strict=True))


@contextmanager
def collected_messages() -> Iterator[vtkStringOutputWindow]:
    """Collect what VTK would print to standard error."""
    window = vtkStringOutputWindow()
    before, verbosity = vtkOutputWindow.GetInstance(), vtkLogger.GetCurrentVerbosityCutoff()
    vtkOutputWindow.SetInstance(window)
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        yield window
    finally:
        vtkOutputWindow.SetInstance(before)
        vtkLogger.SetStderrVerbosity(verbosity)


def reason(messages: str) -> str:
    """What VTK said first, without its file names and addresses."""
    lines = [line for line in messages.splitlines() if line and not re.match(r"(ERROR|.*Warning): In ", line)]
    said = re.sub(r"^\w+ \(0x\w+\): ", "", lines[0]) if lines else "VTK gives no reason"
    if "amplification" in said:
        return "the entities of its XML would expand to too much"
    # Of an error in XML, what its parser says last; the place in the file helps nobody.
    said = re.sub(r"^Error parsing XML in stream at .*?byte index \d+: ", "its XML is damaged: ", said)
    return textwrap.shorten(said.partition(" for file")[0].rstrip("!. "), 80, placeholder=" ...")


def load(path: Path, suffix: str) -> Any:
    """Read a data set.

    Raises:
        ValueError: with VTK's reason, for a warning as well: a file that ends too early is filled up.
    """
    readers: dict[str, Any] = {
        ".vtk": vtkGenericDataObjectReader,
        ".vtp": vtkXMLPolyDataReader,
        ".vtu": vtkXMLUnstructuredGridReader,
    }
    reader = readers[suffix]()
    with collected_messages() as messages, _readable(path) as path:
        reader.SetFileName(str(path))
        reader.Update()
        data = reader.GetOutput()
    if complaint := messages.GetOutput():
        raise ValueError(reason(complaint))
    if data is None:
        raise ValueError("it holds no points")
    return data


@contextmanager
def _readable(path: Path) -> Iterator[Path]:
    """A file without what VTK's reader of legacy files does not bear: a byte order mark, and a long run of blanks.

    In one at the end it never finds the end.
    """
    content = path.read_bytes()
    n_blanks = len(content) - len(content.rstrip())
    is_marked = content.startswith(codecs.BOM_UTF8)
    if n_blanks <= 2 * _BLANKS_LEFT and not is_marked:
        yield path
        return
    with TemporaryDirectory() as folder:
        shorter = Path(folder) / "shorter.vtk"
        # Some blanks may be the last bytes of numbers.
        end = len(content) - max(0, n_blanks - _BLANKS_LEFT)
        shorter.write_bytes(content[len(codecs.BOM_UTF8) if is_marked else 0 : end])
        yield shorter


def surface(data: Any) -> tuple[np.ndarray, ...]:
    """Points in file order, and the surface over them; of volume cells the outer surface.

    Returns:
        Points, the sizes and corners of polygons, and the sizes and corners of triangle strips.
    """
    if data.GetPoints() is None:
        raise ValueError("it holds no points")
    points = vtk_to_numpy(data.GetPoints().GetData())
    if data.IsA("vtkPolyData"):
        return points, *_cells(data.GetPolys(), len(points)), *_cells(data.GetStrips(), len(points))
    nothing = np.zeros(0, dtype=np.int64)
    _cells(data.GetCells(), len(points))
    linear = all(_cell_of(cell_type).IsLinear() for cell_type in np.unique(_types(data)).tolist())
    return points, *(_linear_surface(data) if linear else (*_quadratic_surface(data), nothing, nothing))


def _check_counts(data: Any, content: bytes) -> None:
    """Refuse a legacy file whose cells are not as many as it announces: VTK goes by one of two counts alone."""
    version = re.search(rb"# vtk DataFile Version +(\d+)", content)
    with_offsets = version is not None and int(version[1]) >= 5
    for get, pattern in _LEGACY_CELLS.items():
        announced = pattern.search(content)
        if announced is None or not hasattr(data, get):
            continue
        cells = getattr(data, get)()
        n_cells, n_corners = cells.GetNumberOfCells(), cells.GetNumberOfConnectivityIds()
        # From version 5 on there is one offset more than there are cells; before, sizes stand among the corners.
        found = (n_cells + 1, n_corners) if with_offsets else (n_cells, n_cells + n_corners)
        if found != (int(announced[1]), int(announced[2])) and (n_cells or int(announced[1])):
            raise ValueError(
                f"it announces {announced[1].decode()[:20]} {announced[2].decode()[:20]} for its cells, but holds "
                f"{found[0]} {found[1]}; correct the counts"
            )


def _cells(cells: Any, n_points: int) -> tuple[np.ndarray, np.ndarray]:
    """Sizes and corners of cells, once all corners exist: VTK would look up others wherever they lead."""
    if cells is None or not cells.GetNumberOfCells():
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    corners = vtk_to_numpy(cells.GetConnectivityArray()).astype(np.int64)
    offsets = vtk_to_numpy(cells.GetOffsetsArray()).astype(np.int64)
    if len(corners) and not 0 <= corners.min() <= corners.max() < n_points:
        raise ValueError("its cells refer to points that it does not hold")
    if offsets[0] != 0 or offsets[-1] != len(corners) or np.any(np.diff(offsets) < 0):
        raise ValueError("its cells do not add up")
    return np.diff(offsets), corners


def _line_count(data: Any) -> int:
    """How many cells are lines, straight or curved, which no surface has."""
    if data.IsA("vtkPolyData"):
        return int(data.GetNumberOfLines())
    types, counts = np.unique(_types(data), return_counts=True)
    return sum(int(n) for kind, n in zip(types.tolist(), counts, strict=True) if _cell_of(kind).GetCellDimension() == 1)


def _types(data: Any) -> np.ndarray:
    """The type of each cell of a grid."""
    if not data.GetNumberOfCells():
        return np.zeros(0, dtype=np.uint8)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # from 9.6 on VTK would have another name, which earlier ones do not know
        types: np.ndarray = vtk_to_numpy(data.GetCellTypesArray())
    return types


def _linear_surface(data: Any) -> tuple[np.ndarray, ...]:
    extract = vtkGeometryFilter()
    extract.PassThroughPointIdsOn()
    extract.SetOriginalPointIdsName("file_index")
    extract.SetInputData(data)
    with collected_messages():
        extract.Update()
    found = extract.GetOutput()
    sizes, corners = _cells(found.GetPolys(), found.GetNumberOfPoints())
    strip_sizes, strip_corners = _cells(found.GetStrips(), found.GetNumberOfPoints())
    if not found.GetNumberOfPoints():
        return sizes, corners, strip_sizes, strip_corners
    number = vtk_to_numpy(found.GetPointData().GetArray("file_index")).astype(np.int64)
    return sizes, number[corners], strip_sizes, number[strip_corners]


def _quadratic_surface(data: Any) -> tuple[np.ndarray, np.ndarray]:
    """The outer faces of cells with points on their edges, each split into triangles and quadrilaterals over these.

    VTK's own filter makes new points, which have no number in the file.
    """
    types = _types(data)
    offsets = vtk_to_numpy(data.GetCells().GetOffsetsArray())
    corners = vtk_to_numpy(data.GetCells().GetConnectivityArray())
    pieces = list[np.ndarray]()
    inner, keys = list[np.ndarray](), list[np.ndarray]()
    for cell_type in np.unique(types).tolist():
        (cells,) = np.nonzero(types == cell_type)
        if cell_type in _ANY_NUMBER_OF_CORNERS:
            for ring, key in (found for cell in cells.tolist() for found in _rings(data, cell)):
                keys.append(np.sort([key]))
                pieces.append(np.array([ring]))
                inner.append(np.ones(1, dtype=np.int64))
            continue
        is_surface, faces = _faces_of(cell_type)
        for n_corners, nodes, parts in faces:
            of_cells = corners[offsets[cells][:, None] + np.array(nodes)]
            # Faces that belong to no volume are all kept.
            keys.append(np.sort(of_cells[:, :n_corners], axis=1) if not is_surface else -2 - cells[:, None])
            inner.append(np.full(len(cells), len(parts)))
            pieces.append(np.stack([_padded(of_cells[:, part], 4) for part in parts], axis=1).reshape(-1, 4))
    if not keys:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    _, which, counts = np.unique(_stacked(keys), axis=0, return_inverse=True, return_counts=True)
    outer = np.repeat((counts == 1)[which.ravel()], np.concatenate(inner))
    polygons = _stacked(pieces)[outer].astype(np.int64)
    return (polygons >= 0).sum(axis=1), polygons[polygons >= 0]


def _padded(rows: np.ndarray, width: int) -> np.ndarray:
    """Rows of corners made wider with -1."""
    return np.pad(rows, ((0, 0), (0, width - rows.shape[1])), constant_values=-1)


def _stacked(tables: list[np.ndarray]) -> np.ndarray:
    width = max(table.shape[1] for table in tables)
    return np.concatenate([_padded(table, width) for table in tables])


# Cells whose corners are not as many as their type says.
_ANY_NUMBER_OF_CORNERS = (VTK_POLYGON, VTK_QUADRATIC_POLYGON, VTK_TRIANGLE_STRIP, VTK_POLYHEDRON, VTK_CONVEX_POINT_SET)


def _rings(data: Any, number: int) -> Iterator[tuple[list[int], list[int]]]:
    """The faces of one such cell as rings of points, and what two cells have in common that share a face."""
    cell = data.GetCell(number)
    nodes = _nodes(cell)
    if cell.GetCellDimension() == 3:
        for face in range(cell.GetNumberOfFaces()):
            ring = _nodes(cell.GetFace(face))
            yield ring, ring
    elif cell.GetCellType() == VTK_TRIANGLE_STRIP:
        for first in range(len(nodes) - 2):
            a, b, c = nodes[first : first + 3]
            yield ([a, c, b] if first % 2 else [a, b, c]), [-2 - number, first]
    elif cell.GetCellType() == VTK_QUADRATIC_POLYGON:
        # The corners come first, then the middles of the edges.
        half = len(nodes) // 2
        yield [node for pair in zip(nodes[:half], nodes[half:], strict=True) for node in pair], [-2 - number]
    else:
        yield nodes, [-2 - number]


def _nodes(cell: Any) -> list[int]:
    return [cell.GetPointId(position) for position in range(cell.GetNumberOfPoints())]


def _cell_of(cell_type: int) -> Any:
    cell: Any = vtkGenericCell.InstantiateCell(cell_type)
    if cell is None:
        raise ValueError(f"it holds cells of the unknown type {cell_type}; export it with linear cells")
    return cell


_Face = tuple[int, list[int], list[list[int]]]


def _faces_of(cell_type: int) -> tuple[bool, list[_Face]]:
    """Whether cells of a type are faces themselves, and their faces.

    Of each face the number of corners, its nodes as positions in the cell, and its pieces as positions among the nodes.

    Raises:
        ValueError: for cells whose faces have other nodes than corners, middles of edges and a middle.
    """
    cell = _cell_of(cell_type)
    dimension = cell.GetCellDimension()
    if dimension < 2:
        return True, []
    for position in range(cell.GetNumberOfPoints()):
        cell.GetPointIds().SetId(position, position)
    found = list[_Face]()
    for number in range(1 if dimension == 2 else cell.GetNumberOfFaces()):
        # A cell has one object for all of its faces, one after the other.
        face = cell if dimension == 2 else cell.GetFace(number)
        nodes = _nodes(face)
        if face.GetCellType() not in _SPLITS or not nodes:
            raise ValueError(
                f"its cells of the kind {cell.GetClassName()} are not read; export it with linear cells alone"
            )
        n_corners, parts = _SPLITS[face.GetCellType()]
        found.append((n_corners, nodes, parts))
    return dimension == 2, found


# For each type of faces the corners, and its pieces as positions among its nodes: corners first, then the middles of
# edges from the first one on, then the middle.
_SPLITS: dict[int, tuple[int, list[list[int]]]] = {
    VTK_TRIANGLE: (3, [[0, 1, 2]]),
    VTK_QUAD: (4, [[0, 1, 2, 3]]),
    VTK_PIXEL: (4, [[0, 1, 3, 2]]),
    VTK_QUADRATIC_LINEAR_QUAD: (4, [[0, 4, 5, 3], [4, 1, 2, 5]]),
    VTK_QUADRATIC_TRIANGLE: (3, [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]),
    VTK_BIQUADRATIC_TRIANGLE: (
        3,
        [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 6], [4, 5, 6], [5, 3, 6]],
    ),
    VTK_QUADRATIC_QUAD: (4, [[0, 4, 7], [4, 1, 5], [5, 2, 6], [6, 3, 7], [4, 5, 6, 7]]),
    VTK_BIQUADRATIC_QUAD: (4, [[0, 4, 8, 7], [4, 1, 5, 8], [8, 5, 2, 6], [7, 8, 6, 3]]),
}
