"""Shapes of other libraries, told by their attributes, so that none of these is imported."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from os import PathLike, fspath
from typing import Any

import numpy as np
from jaxtyping import Int

from homolog.core.errors import ArgumentError, ShapeError
from homolog.shapes.formats.parsing import polygon_faces
from homolog.shapes.formats.vtk import surface_of
from homolog.shapes.reading import read_shape
from homolog.shapes.shape import Shape, check_indices

_ALLOWED = (
    "a Shape, a path, points (n, 3), a tuple (vertices, faces), or a mesh or cloud of trimesh, pyvista, VTK, Open3D, "
    "meshio, PyTorch Geometric, pyFM or GeomFuM"
)
# Three rows of more numbers than this are faces as columns, and not three polygons.
_MOST_CORNERS = 8
# Cells of meshio that are polygons of a surface; those of quadratic ones have other points than corners.
_MESHIO_FACES = ("triangle", "quad", "polygon")
_MESHIO_VOLUMES = ("tetra", "hexahedron", "wedge", "pyramid", "voxel", "polyhedron")


def as_shape(found: Any, *, name: str | None = None) -> Shape:
    """Make a ``Shape`` of what another library, a file or a program of one's own has; points keep their order.

    Args:
        found: a ``Shape``; a path; an array or tensor of points (n, 3); a tuple ``(vertices, faces)``, of which faces
            are triangles, polygons of one size, or a list of polygons; a ``Trimesh``, ``PointCloud`` or ``Scene`` of
            trimesh; ``PolyData`` or an ``UnstructuredGrid`` of pyvista or VTK, whose outer surface is taken; a
            ``TriangleMesh`` or ``PointCloud`` of Open3D, old or tensor; ``meshio.Mesh``; ``Data`` of PyTorch Geometric
            with ``pos`` and perhaps ``face``; ``TriMesh`` of pyFM; ``TriangleMesh`` of GeomFuM. Polygons are
            triangulated. Without any face it is a point cloud.
        name: how messages call the shape; by default the file's name, or ``"shape"``.

    Raises:
        ArgumentError: if it is none of these.
        ShapeError: if its points or faces cannot be used, or a file cannot be read.

    Examples:
        >>> import homolog
        >>> square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
        >>> shape = homolog.shapes.as_shape((square, [[0, 1, 2, 3]]), name="square")
        >>> shape
        Shape('square': mesh, 4 points, 2 faces)
    """
    if isinstance(found, Shape):
        return found if name is None else replace(found, name=name)
    if isinstance(found, str | PathLike):
        shape = read_shape(fspath(found))
        return shape if name is None else replace(shape, name=name)
    for has, taken in _KINDS:
        if has(found):
            return _shape(*taken(found), name or "shape")
    raise ArgumentError(f"a shape is needed, but {type(found).__name__} was given; give {_ALLOWED}")


def _shape(points: Any, faces: Any, name: str) -> Shape:
    points, faces = Shape(_numpy(points), name=name).points, _numpy(faces)
    if faces is None or len(faces) == 0:
        return Shape(points, name=name)
    sizes, corners = _polygons(faces, name)
    check_indices(corners, len(points), name)
    return Shape(points, polygon_faces(points, sizes, corners), name=name)


def _numpy(values: Any) -> Any:
    """A tensor, wherever it lies, as one that numpy can read; other things as they are."""
    for step in ("detach", "cpu", "numpy"):
        values = getattr(values, step)() if hasattr(values, step) else values
    return values


def _polygons(faces: Any, name: str) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " c"]]:
    """Sizes and corners of faces: an array with a row a face, or a list of lists of any lengths."""
    if isinstance(faces, list | tuple):
        rows = [np.asarray(_numpy(row)) for row in faces]
        sizes, corners = np.array([row.size for row in rows]), np.concatenate(rows)
    else:
        table = np.atleast_2d(np.asarray(faces))
        if len(table) == 3 and table.shape[1] > _MOST_CORNERS:
            raise ShapeError(f"{name}: faces have shape {table.shape}, but must have shape (m, 3); transpose them")
        sizes, corners = np.full(len(table), table.shape[1]), table.ravel()
    if corners.dtype.kind not in "biuf" or not np.array_equal(corners, np.round(corners)):
        raise ShapeError(f"{name}: faces must be whole numbers, indices of points from 0")
    return sizes, corners.astype(np.int64)


def _of_scene(found: Any) -> tuple[Any, Any]:
    """The meshes of a trimesh scene with their transforms, as one."""
    whole = found.to_geometry() if hasattr(found, "to_geometry") else found.dump(concatenate=True)
    return whole.vertices, getattr(whole, "faces", None)


def _of_vtk(found: Any) -> tuple[Any, Any]:
    if not (found.IsA("vtkPolyData") or found.IsA("vtkUnstructuredGrid")):
        raise ShapeError(
            f"a {type(found).__name__} of VTK is no surface; give PolyData, as its extract_surface() gives it"
        )
    points, sizes, corners = surface_of(found)
    return points, np.split(corners, np.cumsum(sizes)[:-1]) if len(sizes) else None


def _of_open3d_tensor(found: Any) -> tuple[Any, Any]:
    if hasattr(found, "vertex"):
        # Open3D's maps of tensors have no method get.
        return found.vertex["positions"], found.triangle["indices"] if "indices" in found.triangle else None  # noqa: SIM401
    return found.point["positions"], None


def _of_meshio(found: Any) -> tuple[Any, Any]:
    faces = [row for block in found.cells if block.type in _MESHIO_FACES for row in block.data]
    other = sorted({block.type for block in found.cells if block.type.startswith(_MESHIO_VOLUMES + _MESHIO_FACES)})
    if not faces and other:
        raise ShapeError(f"a meshio mesh of {', '.join(other)} has no triangles or polygons; extract its surface first")
    return found.points, faces


# How each library's shapes are told, and where they keep points and faces; the first that fits counts.
_KINDS: tuple[tuple[Callable[[Any], bool], Callable[[Any], tuple[Any, Any]]], ...] = (
    (
        lambda found: isinstance(found, tuple) and len(found) == 2 and np.ndim(_numpy(found[0])) == 2,
        lambda found: found,
    ),
    (lambda found: hasattr(found, "IsA"), _of_vtk),
    (lambda found: hasattr(found, "geometry") and hasattr(found, "graph"), _of_scene),
    (lambda found: hasattr(found, "vertlist"), lambda found: (found.vertlist, getattr(found, "facelist", None))),
    # Open3D calls its faces triangles; trimesh and GeomFuM call them faces.
    (
        lambda found: hasattr(found, "vertices"),
        lambda found: (found.vertices, getattr(found, "faces", getattr(found, "triangles", None))),
    ),
    (lambda found: hasattr(found, "vertex") or hasattr(found, "point"), _of_open3d_tensor),
    (lambda found: hasattr(found, "points") and hasattr(found, "cells"), _of_meshio),
    (
        lambda found: getattr(found, "pos", None) is not None,
        lambda found: (found.pos, None if getattr(found, "face", None) is None else _numpy(found.face).T),
    ),
    (lambda found: hasattr(found, "points"), lambda found: (found.points, None)),
    (lambda found: hasattr(found, "__array__") or hasattr(found, "detach"), lambda found: (found, None)),
    (lambda found: isinstance(found, list), lambda found: (found, None)),
)
