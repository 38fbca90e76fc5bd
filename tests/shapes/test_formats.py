"""A format is one entry in a registry: own ones are read and written as Homolog's are."""

import sys

import numpy as np
import pytest

from homolog.core.errors import ArgumentError, MissingExtraError, ShapeError
from homolog.core.plugins import offered
from homolog.datasets import mesh_files
from homolog.shapes import (
    Shape,
    folder_suffixes,
    read_shape,
    readable_suffixes,
    register_format,
    writable_suffixes,
    write_shape,
)
from homolog.shapes.formats import registry

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
MESH = Shape(POINTS, FACES, name="tetrahedron")


@pytest.fixture(autouse=True)
def own_registry(monkeypatch):
    """What a test registers is gone after it."""
    monkeypatch.setattr(registry, "_FORMATS", dict(registry._FORMATS))


def read_tri(path):
    rows = [line.split() for line in path.read_text().splitlines()]
    points = [list(map(float, row[1:])) for row in rows if row[0] == "p"]
    return points, [list(map(int, row[1:])) for row in rows if row[0] == "t"]


def write_tri(path, shape):
    lines = [f"p {x!r} {y!r} {z!r}" for x, y, z in shape.points.tolist()]
    path.write_text("\n".join(lines + [f"t {a} {b} {c}" for a, b, c in shape.faces.tolist()]))


def test_a_format_of_ones_own(tmp_path):
    register_format(".TRI", read=read_tri, write=write_tri)
    assert ".tri" in readable_suffixes() and ".tri" in writable_suffixes()
    write_shape(tmp_path / "a.tri", MESH)
    back = read_shape(tmp_path / "a.Tri" if (tmp_path / "a.Tri").exists() else tmp_path / "a.tri")
    np.testing.assert_array_equal(back.points, POINTS)
    np.testing.assert_array_equal(back.faces, FACES)
    assert back.name == "a.tri"
    assert mesh_files(tmp_path) == {"a": tmp_path / "a.tri"}


def test_a_format_of_clouds(tmp_path):
    register_format(".raw3", read=lambda path: np.fromfile(path).reshape(-1, 3), clouds_only=True)
    POINTS.tofile(tmp_path / "a.raw3")
    assert read_shape(tmp_path / "a.raw3").faces is None
    assert ".raw3" in folder_suffixes(clouds=True) and ".raw3" not in folder_suffixes(clouds=False)
    with pytest.raises(ArgumentError, match="must have one of"):
        write_shape(tmp_path / "b.raw3", MESH.as_cloud())
    register_format(".raw3", read=print, write=lambda path, shape: shape.points.tofile(path), clouds_only=True)
    with pytest.raises(ShapeError, match="cannot hold the faces"):
        write_shape(tmp_path / "b.raw3", MESH)
    assert not (tmp_path / "b.raw3").exists()


@pytest.mark.parametrize(
    "found", [None, "text", np.zeros((4, 2)), (POINTS, FACES + 1), (POINTS, FACES + 0.5), POINTS[:2]]
)
def test_what_a_reader_gives_is_checked(tmp_path, found):
    register_format(".odd", read=lambda path: found)
    (tmp_path / "a.odd").write_text("x")
    with pytest.raises(ShapeError, match=r"a\.odd"):
        read_shape(tmp_path / "a.odd")


def test_an_error_of_a_reader_is_one_line_and_one_of_a_writer_leaves_no_file(tmp_path):
    def fail(path, shape=None):
        path.write_text("half")
        raise OSError("a\nb") if shape else KeyError("a\nb")

    register_format(".odd", read=fail, write=fail)
    (tmp_path / "a.odd").write_text("x")
    with pytest.raises(ShapeError, match=r"a\.odd could not be read as ODD") as caught:
        read_shape(tmp_path / "a.odd")
    assert "\n" not in str(caught.value)
    with pytest.raises(ArgumentError, match=r"b\.odd cannot be written"):
        write_shape(tmp_path / "b.odd", MESH)
    assert not (tmp_path / "b.odd").exists()


def test_a_missing_package_names_its_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "no_such_package", None)

    def read(path):
        import no_such_package

        return no_such_package

    register_format(".odd", read=read, extra="vtk")
    (tmp_path / "a.odd").write_text("x")
    with pytest.raises(MissingExtraError, match=r"no_such_package.*homolog\[vtk\]"):
        read_shape(tmp_path / "a.odd")


@pytest.mark.parametrize("suffix", ["tri", ".", "", ".a/b", ".tar.gz"])
def test_suffixes_that_are_none(suffix):
    with pytest.raises(ArgumentError, match="suffix is"):
        register_format(suffix, read=read_tri)


def test_read_must_be_a_function():
    with pytest.raises(ArgumentError, match="read is 3"):
        register_format(".tri", read=3)
    with pytest.raises(ArgumentError, match="write is 'x'"):
        register_format(".tri", read=read_tri, write="x")


def test_installed_packages_bring_formats_and_their_faults_are_told(tmp_path, monkeypatch, caplog):
    """One whose module cannot be imported, one whose function fails, and one that works."""
    (tmp_path / "halfbroken.py").write_text(
        "from homolog.shapes import register_format\n"
        "def broken():\n    raise RuntimeError('out of order')\n"
        "def fine():\n    register_format('.fine', read=print)\n"
    )
    info = tmp_path / "theirs-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    points = ["gone = no_such_module:formats", "broken = halfbroken:broken", "fine = halfbroken:fine"]
    (info / "entry_points.txt").write_text("\n".join(["[homolog.formats]", *points]))
    monkeypatch.syspath_prepend(tmp_path)
    for cached in (offered, registry._load_installed):
        cached.cache_clear()
    try:
        assert ".fine" in readable_suffixes() and ".fine" in readable_suffixes()
    finally:
        for cached in (offered, registry._load_installed):
            cached.cache_clear()
        sys.modules.pop("halfbroken", None)
    first, second = caplog.messages
    assert f"{points[0]} in homolog.formats of package theirs are left out (ModuleNotFoundError: No module" in first
    assert f"{points[1]} in homolog.formats of package theirs are left out (RuntimeError: out of order)" in second
