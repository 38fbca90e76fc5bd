"""What is written reads back the same: points, faces, and their order."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from homolog.core.errors import ArgumentError, ShapeError
from homolog.core.files import atomic_path
from homolog.shapes import Shape, read_shape, readable_suffixes, writable_suffixes, write_shape

POINTS_ONLY = (".xyz", ".txt", ".csv", ".npy", ".pcd")
SINGLE = (".stl", ".glb")


def awkward_mesh():
    """Coordinates with many digits, an unused point, equal points, and a face with a repeated corner."""
    points = np.random.default_rng(3).normal(size=(9, 3)) * [1e-3, 1, 1e3] + [0, 0, 1 / 3]
    points[7] = points[2]
    return Shape(points, [[8, 0, 1], [1, 0, 2], [3, 4, 5], [5, 7, 3], [2, 2, 1]], name="awkward")


@pytest.mark.parametrize("suffix", [s for s in writable_suffixes() if s not in (*POINTS_ONLY, ".stl")])
def test_mesh_there_and_back(tmp_path, suffix):
    mesh = awkward_mesh()
    write_shape(tmp_path / f"a{suffix}", mesh)
    back = read_shape(tmp_path / f"a{suffix}")
    expected = mesh.points.astype(np.float32) if suffix in SINGLE else mesh.points
    np.testing.assert_array_equal(back.points, expected)
    np.testing.assert_array_equal(back.faces, mesh.faces)
    assert [p.name for p in tmp_path.iterdir()] == [f"a{suffix}"]


@pytest.mark.parametrize("suffix", [s for s in writable_suffixes() if s != ".stl"])
def test_cloud_there_and_back(tmp_path, suffix):
    cloud = awkward_mesh().as_cloud()
    write_shape(tmp_path / f"a{suffix.upper()}", cloud)
    back = read_shape(tmp_path / f"a{suffix.upper()}")
    expected = cloud.points.astype(np.float32) if suffix in SINGLE else cloud.points
    np.testing.assert_array_equal(back.points, expected)
    assert back.faces is None


def test_stl_there_and_back_for_points_in_order_of_first_use(tmp_path):
    box = trimesh.creation.box()
    order = list(dict.fromkeys(box.faces.ravel().tolist()))
    mesh = Shape(box.vertices[order], np.argsort(order)[box.faces])
    write_shape(tmp_path / "a.stl", mesh)
    back = read_shape(tmp_path / "a.stl")
    np.testing.assert_array_equal(back.points, mesh.points)
    np.testing.assert_array_equal(back.faces, mesh.faces)


@settings(derandomize=True, deadline=None, max_examples=50)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=12, max_size=12, unique=True))
def test_text_keeps_every_bit(tmp_path_factory, numbers):
    cloud = Shape(np.reshape(numbers, (4, 3)))
    for suffix in (".off", ".obj", ".csv", ".xyz"):
        path = tmp_path_factory.getbasetemp() / f"bits{suffix}"
        write_shape(path, cloud)
        np.testing.assert_array_equal(read_shape(path).points, cloud.points)


@pytest.mark.parametrize("suffix", [".off", ".obj", ".ply", ".stl", ".glb"])
def test_another_reader_agrees(tmp_path, suffix):
    sphere = trimesh.creation.icosphere(subdivisions=1)
    write_shape(tmp_path / f"a{suffix}", Shape(sphere.vertices, sphere.faces))
    other = trimesh.load_mesh(tmp_path / f"a{suffix}")
    assert other.is_watertight
    assert other.area == pytest.approx(sphere.area, rel=1e-6)


def test_ply_colours(tmp_path):
    mesh = awkward_mesh()
    colours = np.arange(27, dtype=np.uint8).reshape(9, 3)
    write_shape(tmp_path / "a.ply", mesh, colours=colours)
    np.testing.assert_array_equal(read_shape(tmp_path / "a.ply").points, mesh.points)
    other = trimesh.load_mesh(tmp_path / "a.ply", process=False)
    np.testing.assert_array_equal(other.visual.vertex_colors[:, :3], colours)


def test_what_a_format_cannot_hold(tmp_path):
    mesh = awkward_mesh()
    for suffix in POINTS_ONLY:
        with pytest.raises(ShapeError, match="cannot hold the faces"):
            write_shape(tmp_path / f"a{suffix}", mesh)
    with pytest.raises(ShapeError, match="point cloud"):
        write_shape(tmp_path / "a.stl", mesh.as_cloud())
    colours = np.zeros((9, 3), np.uint8)
    with pytest.raises(ArgumentError, match=r"\.ply"):
        write_shape(tmp_path / "a.off", mesh, colours=colours)
    for wrong in (colours[:5], colours.astype(float), colours.ravel()):
        with pytest.raises(ArgumentError, match=r"uint8 of shape \(9, 3\)"):
            write_shape(tmp_path / "a.ply", mesh, colours=wrong)
    with pytest.raises(ArgumentError, match="must have one of"):
        write_shape(tmp_path / "a.docx", mesh)
    with pytest.raises(ArgumentError, match="must have one of"):
        write_shape(tmp_path / "a.gltf", mesh)
    assert list(tmp_path.iterdir()) == []


def test_folder_that_does_not_exist(tmp_path):
    with pytest.raises(ArgumentError, match="create it first"):
        write_shape(tmp_path / "none" / "a.ply", awkward_mesh())
    (tmp_path / "a.ply").mkdir()
    with pytest.raises(ArgumentError, match="it is a folder"):
        write_shape(tmp_path / "a.ply", awkward_mesh())


def test_all_that_is_written_can_be_read():
    assert set(writable_suffixes()) <= set(readable_suffixes())


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_error_or_interrupt_leaves_the_old_file(tmp_path, error):
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(error), atomic_path(target) as path:
        path.write_text("half")
        raise error
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_full_disk_is_an_error_of_one_line(tmp_path):
    with (
        pytest.raises(ArgumentError, match=r"a\.txt cannot be written: No space"),
        atomic_path(tmp_path / "a.txt"),
    ):
        raise OSError(28, "No space left on device")


def test_link_is_followed(tmp_path):
    (tmp_path / "real.txt").write_text("old")
    (tmp_path / "link.txt").symlink_to(tmp_path / "real.txt")
    with atomic_path(tmp_path / "link.txt") as path:
        assert path.suffix == ".txt"
        path.write_text("new")
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "real.txt").read_text() == "new"
