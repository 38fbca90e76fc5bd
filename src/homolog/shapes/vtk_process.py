"""VTK in a process of its own, because on a damaged file it ends the whole process.

Run as a script with a path and its suffix, this reads the file and writes points and faces to standard
output, or a reason to standard error. It imports nothing of Homolog, to start fast. Writing uses some of it.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

if __name__ == "__main__":
    # The search path of the calling process, which may have been changed there.
    sys.path[:] = json.loads(sys.argv[3])

import numpy as np
from vtkmodules.util import numpy_support
from vtkmodules.vtkCommonCore import vtkLogger, vtkOutputWindow, vtkStringOutputWindow
from vtkmodules.vtkFiltersCore import vtkTriangleFilter
from vtkmodules.vtkFiltersGeometry import vtkGeometryFilter
from vtkmodules.vtkIOLegacy import vtkGenericDataObjectReader
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLUnstructuredGridReader

if TYPE_CHECKING:
    from jaxtyping import Float, Int

# Not typed by VTK.
vtk_to_numpy: Any = numpy_support.vtk_to_numpy

REFUSED = 3
"""The exit code when standard error holds the reason why the file is refused."""

_LEAST_MEMORY = 6 * 2**30
_MEMORY_PER_BYTE = 64


def main() -> int:
    """Read the file named on the command line; gives the exit code."""
    path = Path(sys.argv[1])
    _limit_memory(path.stat().st_size)
    try:
        points, faces = surface(load(path, sys.argv[2]))
    except (ValueError, MemoryError) as error:
        sys.stderr.write(str(error) or "it does not fit into memory")
        return REFUSED
    stream = BytesIO()
    for array in (points, faces):
        np.save(stream, array, allow_pickle=False)
    sys.stdout.buffer.write(stream.getbuffer())
    return 0


def _limit_memory(file_size: int) -> None:
    """Let damaged sizes in a file fail here, not exhaust the machine; there is no such limit on Windows."""
    try:
        import resource
    except ImportError:
        return
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    wanted = _LEAST_MEMORY + _MEMORY_PER_BYTE * file_size
    if hard == resource.RLIM_INFINITY or wanted < hard:
        resource.setrlimit(resource.RLIMIT_AS, (wanted, hard))


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
    return said.partition(" for file")[0][:80].rstrip(".! ")


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
    with collected_messages() as messages:
        reader.SetFileName(str(path))
        reader.Update()
        data = reader.GetOutput()
    if complaint := messages.GetOutput():
        raise ValueError(reason(complaint))
    if data is None or data.GetPoints() is None:
        raise ValueError("it holds no points")
    return data


def surface(data: Any) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]]:
    """Points in file order, and the triangulated surface over them; of volume cells the outer surface."""
    points = vtk_to_numpy(data.GetPoints().GetData())
    is_grid = data.IsA("vtkUnstructuredGrid")
    for cells in [data.GetCells()] if is_grid else [data.GetPolys(), data.GetStrips()]:
        _check_corners(cells, len(points))
    with collected_messages():
        triangulate = vtkTriangleFilter()
        triangulate.PassVertsOff()
        triangulate.PassLinesOff()
        triangulate.SetInputData(_grid_surface(data) if is_grid else data)
        triangulate.Update()
        triangles = triangulate.GetOutput()
    faces = vtk_to_numpy(triangles.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    if is_grid and len(faces):
        faces = vtk_to_numpy(triangles.GetPointData().GetArray("file_index"))[faces]
    return points, faces


def _check_corners(cells: Any, n_points: int) -> None:
    """Refuse corners that do not exist, which VTK would look up wherever they lead."""
    if cells is None or not cells.GetNumberOfCells():
        return
    corners = vtk_to_numpy(cells.GetConnectivityArray())
    offsets = vtk_to_numpy(cells.GetOffsetsArray())
    if len(corners) and not 0 <= corners.min() <= corners.max() < n_points:
        raise ValueError("its cells refer to points that it does not hold")
    if offsets[0] != 0 or offsets[-1] != len(corners) or np.any(np.diff(offsets) < 0):
        raise ValueError("its cells do not add up")


def _grid_surface(data: Any) -> Any:
    extract = vtkGeometryFilter()
    extract.PassThroughPointIdsOn()
    extract.SetOriginalPointIdsName("file_index")
    extract.SetInputData(data)
    extract.Update()
    return extract.GetOutput()


if __name__ == "__main__":
    sys.exit(main())
