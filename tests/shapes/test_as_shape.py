"""Shapes of other libraries, by their attributes; the libraries themselves where they are installed."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trimesh

from homolog.core.errors import ArgumentError, ShapeError
from homolog.shapes import Shape, as_shape, check, write_shape

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


def is_mesh(shape, points=POINTS, faces=FACES):
    np.testing.assert_array_equal(shape.points, points)
    np.testing.assert_array_equal(shape.faces, faces)
    return True


def is_cloud(shape):
    np.testing.assert_array_equal(shape.points, POINTS)
    return shape.faces is None


def test_shapes_paths_and_names(tmp_path):
    shape = Shape(POINTS, FACES, name="a")
    assert as_shape(shape) is shape
    assert as_shape(shape, name="b").name == "b"
    write_shape(tmp_path / "a.ply", shape)
    assert as_shape(tmp_path / "a.ply").name == "a.ply"
    assert (
        is_mesh(as_shape(str(tmp_path / "a.ply"), name="c")) and as_shape(str(tmp_path / "a.ply"), name="c").name == "c"
    )
    assert as_shape((POINTS, FACES), name="d").name == "d"


@pytest.mark.parametrize("given", [POINTS, POINTS.tolist(), torch.tensor(POINTS, requires_grad=True)])
def test_points(given):
    assert is_cloud(as_shape(given))


@pytest.mark.parametrize("faces", [FACES, FACES.tolist(), torch.tensor(FACES), FACES.astype(np.float32), list(FACES)])
def test_vertices_and_faces(faces):
    assert is_mesh(as_shape((torch.tensor(POINTS), faces)))
    assert is_mesh(as_shape((POINTS.tolist(), faces)))


def test_polygons_are_triangulated():
    arrow = np.array([[0, 0, 0], [2, -1, 0], [0, 3, 0], [-2, -1, 0]], float)
    assert check(as_shape((arrow, [[2, 3, 0, 1]]))).area == pytest.approx(6)
    assert check(as_shape((arrow, np.array([[1, 2, 3, 0]])))).area == pytest.approx(6)
    assert as_shape((arrow, [[0, 1, 2], [0, 1, 2, 3]])).n_faces == 3


def test_no_faces_is_a_cloud():
    assert is_cloud(as_shape((POINTS, None)))
    assert is_cloud(as_shape((POINTS, np.zeros((0, 3), int))))


@pytest.mark.parametrize("faces", [FACES + 1, (FACES + 1).tolist(), [[1, 2, 3, 4]]])
def test_faces_that_count_from_one(faces):
    with pytest.raises(ShapeError, match="body: faces seem to count from 1"):
        as_shape((POINTS, faces), name="body")


@pytest.mark.parametrize("faces", [[[0, 1, 4]], [[-1, 0, 1]], [[0, 1, 2, 9]], [[0, 1, 2.5]]])
def test_faces_that_do_not_fit(faces):
    with pytest.raises(ShapeError, match="body: faces") as caught:
        as_shape((POINTS, faces), name="body")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("given", [None, 3, {"points": POINTS}, SimpleNamespace(corners=POINTS)])
def test_what_is_no_shape(given):
    with pytest.raises(ArgumentError, match=f"{type(given).__name__} was given; give a Shape, a path"):
        as_shape(given)


def test_trimesh():
    mesh = trimesh.Trimesh(POINTS, FACES, process=False)
    assert is_mesh(as_shape(mesh))
    assert is_cloud(as_shape(trimesh.PointCloud(POINTS)))
    scene = trimesh.Scene()
    scene.add_geometry(mesh, transform=trimesh.transformations.translation_matrix([5, 0, 0]))
    assert is_mesh(as_shape(scene), np.add(POINTS, [5, 0, 0]))
    scene.add_geometry(mesh)
    both = as_shape(scene)
    assert both.n_points == 8 and both.n_faces == 8


def test_pyvista():
    pyvista = pytest.importorskip("pyvista")
    assert is_mesh(as_shape(pyvista.PolyData.from_regular_faces(POINTS, FACES)))
    assert is_cloud(as_shape(pyvista.PolyData(POINTS)))
    grid = pyvista.UnstructuredGrid(np.array([4, 0, 1, 2, 3]), np.array([10]), POINTS)
    shape = as_shape(grid)
    assert set(map(tuple, np.sort(shape.faces))) == set(map(tuple, np.sort(FACES)))
    strips = pyvista.PolyData(POINTS, strips=[4, 0, 1, 2, 3])
    np.testing.assert_array_equal(as_shape(strips).faces, [[0, 1, 2], [1, 3, 2]])
    with pytest.raises(ShapeError, match="ImageData of VTK is no surface"):
        as_shape(pyvista.ImageData(dimensions=(2, 2, 2)))


def test_meshio():
    meshio = pytest.importorskip("meshio")
    assert is_mesh(as_shape(meshio.Mesh(POINTS, [("line", [[0, 1]]), ("triangle", FACES)])))
    assert as_shape(meshio.Mesh(POINTS, [("quad", [[0, 1, 2, 3]]), ("triangle", FACES)])).n_faces == 6
    assert is_cloud(as_shape(meshio.Mesh(POINTS, [("vertex", [[0], [1]])])))
    with pytest.raises(ShapeError, match="meshio mesh of tetra has no triangles"):
        as_shape(meshio.Mesh(POINTS, [("tetra", [[0, 1, 2, 3]])]))


class Vector(list):
    """Open3D's vectors are sequences that numpy takes, of the type of a class of their own."""

    def __array__(self, dtype=None, copy=None):
        return np.array(list(self), dtype=dtype)


class TensorMap:
    """Open3D's map of tensors: it has no method ``get``."""

    def __init__(self, **values):
        self._values = values

    def __contains__(self, key):
        return key in self._values

    def __getitem__(self, key):
        return self._values[key]


class Tensor:
    """Open3D's tensor: without ``detach``, and not to be read where it lies on a GPU."""

    def __init__(self, array):
        self._array = array

    def cpu(self):
        return self

    def numpy(self):
        return self._array


def test_open3d():
    """As Open3D 0.18 calls its attributes."""
    assert is_mesh(as_shape(SimpleNamespace(vertices=Vector(POINTS), triangles=Vector(FACES))))
    assert is_cloud(as_shape(SimpleNamespace(points=Vector(POINTS), colors=Vector())))
    tensors = TensorMap(positions=Tensor(POINTS)), TensorMap(indices=Tensor(FACES))
    assert is_mesh(as_shape(SimpleNamespace(vertex=tensors[0], triangle=tensors[1])))
    assert is_cloud(as_shape(SimpleNamespace(vertex=tensors[0], triangle=TensorMap())))
    assert is_cloud(as_shape(SimpleNamespace(point=tensors[0])))


def test_pytorch_geometric():
    assert is_mesh(as_shape(SimpleNamespace(pos=torch.tensor(POINTS), face=torch.tensor(FACES.T), x=None)))
    assert is_cloud(as_shape(SimpleNamespace(pos=torch.tensor(POINTS), face=None)))
    assert is_cloud(as_shape(SimpleNamespace(pos=torch.tensor(POINTS))))


@dataclass
class TriMesh:
    """As pyFM has it."""

    vertlist: np.ndarray
    facelist: np.ndarray | None = field(default=None)


def test_pyfm_and_geomfum():
    assert is_mesh(as_shape(TriMesh(POINTS, FACES)))
    assert is_cloud(as_shape(TriMesh(POINTS)))
    assert is_mesh(as_shape(SimpleNamespace(vertices=POINTS, faces=FACES, basis=None)))


def test_points_are_copied():
    points = POINTS.copy()
    shape = as_shape((points, FACES))
    points[:] = 7
    assert is_mesh(shape)
