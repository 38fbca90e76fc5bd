"""Text is read in blocks: what lies across their ends is read alike, and memory is bounded by the file's size."""

import tracemalloc

import numpy as np
import pytest

from homolog.core.errors import ShapeError
from homolog.shapes import Shape, read_shape
from homolog.shapes.formats import text_lines
from homolog.shapes.polygons import fans, triangulate

RNG = np.random.default_rng(0)
POINTS = RNG.normal(size=(700, 3)).round(6)
FACES = RNG.permuted(np.tile(np.arange(700), (900, 1)), axis=1)[:, :3]
TEXT = "\n".join(" ".join(map(str, row)) for row in POINTS.tolist()) + "\n"


def lines(pattern, rows):
    return "".join(pattern % tuple(row) for row in rows.tolist())


def obj(points, faces, face="f %d %d %d\n"):
    return lines("v %r %r %r\n", points) + lines(face, faces + 1)


def relative(points, faces):
    """Each face directly behind its last point, counted backward."""
    statements = [f"v {x!r} {y!r} {z!r}\n" for x, y, z in points.tolist()]
    for face in faces.tolist():
        last = max(face)
        statements[last] += "f " + " ".join(str(corner - last - 1) for corner in face) + "\n"
    return "".join(statements)


PLY = "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
PLY += "element face {}\nproperty list uchar int vertex_indices\nend_header\n"
ROWS = lines("3 %d %d %d\n", FACES)
FREE = "".join(f"{word}\n" for word in (TEXT + ROWS).split())
MESHES = {
    "plain.off": f"OFF\n700 900 0\n{TEXT}{ROWS}",
    "comments.off": f"OFF # here\n\n700 900\n{TEXT}{ROWS}".replace("\n", "  # a comment\n\n"),
    "a_number_a_line.off": f"OFF\n700 900 0\n{FREE}",
    "one_line.off": "OFF\n700 900 0\n" + FREE.replace("\n", " "),
    "plain.obj": obj(POINTS, FACES),
    "textured.obj": obj(POINTS, FACES, "f %d/1/2 %d/2/2 %d//3\n"),
    "carried_on.obj": obj(POINTS, FACES, "f \\\n%d \\\n %d \\\n%d\n"),
    "plain.ply": PLY.format(700, 900) + TEXT + ROWS,
}


@pytest.fixture(params=[2**20, 7, 1000])
def in_blocks(request, monkeypatch):
    monkeypatch.setattr(text_lines, "_BLOCK", request.param)
    monkeypatch.setattr(text_lines, "_LINES", min(request.param, 11))


@pytest.mark.parametrize("ends", ["\n", "\r\n"])
@pytest.mark.parametrize("name", MESHES)
def test_meshes_read_in_blocks(tmp_path, in_blocks, name, ends):
    (tmp_path / name).write_text(MESHES[name], newline=ends)
    shape = read_shape(tmp_path / name)
    np.testing.assert_array_equal(shape.points, POINTS)
    np.testing.assert_array_equal(shape.faces, FACES)


def test_faces_counted_backward_across_blocks(tmp_path, in_blocks):
    faces = FACES[np.argsort(FACES.max(axis=1), kind="stable")]
    (tmp_path / "a.obj").write_text(relative(POINTS, faces))
    np.testing.assert_array_equal(read_shape(tmp_path / "a.obj").faces, faces)


def test_facets_read_in_blocks(tmp_path, in_blocks):
    facet = "facet normal 0 0 1\nouter loop\n" + 3 * "vertex %r %r %r\n" + "endloop\nend facet\n"
    text = "solid\n" + lines(facet, POINTS[FACES].reshape(-1, 9)) + "endsolid\n"
    (tmp_path / "a.stl").write_bytes(text.encode() + bytes(50))
    shape = read_shape(tmp_path / "a.stl")
    np.testing.assert_array_equal(shape.points[shape.faces], POINTS[FACES])
    (tmp_path / "b.stl").write_bytes(text.encode()[:-30])
    with pytest.raises(ShapeError, match="last triangle is missing"):
        read_shape(tmp_path / "b.stl")


TABLES = {
    "plain.xyz": TEXT,
    "utf_16.txt": TEXT.encode("utf-16"),
    "counted.xyz": f"700\na comment\n{lines('C %r %r %r' + chr(10), POINTS)}",
    "names.csv": "sep=;\nlabel;z;y;x\n" + lines("a;%r;%r;%r\n", POINTS[:, ::-1]),
    "decimal_commas.csv": "x;y;z\n" + lines("%r;%r;%r\n", POINTS).replace(".", ","),
    "numbered.txt": lines("%d %r %r %r\n", np.column_stack([np.arange(700), POINTS])),
    "numbered_in_another_order.txt": lines("%d %r %r %r\n", np.column_stack([RNG.permutation(700) + 5, POINTS])),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_read_in_blocks(tmp_path, in_blocks, name):
    text = TABLES[name]
    (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    np.testing.assert_array_equal(read_shape(tmp_path / name).points, POINTS)


def test_first_numbers_that_number_no_rows(tmp_path, in_blocks):
    """They repeat, which is told far behind the first row."""
    first = np.append(np.arange(5, 704), 5)
    (tmp_path / "a.txt").write_text(lines("%d %r %r %r\n", np.column_stack([first, POINTS])))
    np.testing.assert_array_equal(read_shape(tmp_path / "a.txt").points[:, 0], first)


@pytest.mark.parametrize("name", ["a.xyz", "a.csv", "a.obj", "a.off", "a.ply"])
def test_a_fault_behind_the_first_block_is_quoted(tmp_path, in_blocks, name):
    whole = {"a.xyz": TEXT, "a.csv": TEXT.replace(" ", ","), "a.obj": MESHES["plain.obj"]}
    text = {**whole, "a.off": MESHES["plain.off"], "a.ply": MESHES["plain.ply"]}[name]
    value = repr(POINTS[650, 1].item())
    assert text.count(value) == 1
    (tmp_path / name).write_text(text.replace(value, "oops"))
    with pytest.raises(ShapeError, match=r"oops.* should hold numbers"):
        read_shape(tmp_path / name)
    (tmp_path / name).write_text(text.replace(value, "1 \0"))
    with pytest.raises(ShapeError, match=r"binary data"):
        read_shape(tmp_path / name)


def written_alike(name, n):
    """A file of so many points in six decimals, and of nearly as many faces."""
    points = RNG.normal(size=(n, 3)).round(6)
    faces = np.stack([np.arange(n - 10) + step for step in (0, 4, 9)], axis=1)
    facet = "facet normal 0 0 1\nouter loop\n" + 3 * "vertex %r %r %r\n" + "endloop\nendfacet\n"

    def rows():
        return lines("%r %r %r\n", points) + lines("3 %d %d %d\n", faces)

    return {
        "a.xyz": lambda: lines("%r %r %r\n", points),
        "a.csv": lambda: lines("%r,%r,%r\n", points),
        "a.obj": lambda: obj(points, faces),
        "a.off": lambda: f"OFF\n{n} {n - 10} 0\n{rows()}",
        "a.ply": lambda: PLY.format(n, n - 10) + rows(),
        "a_number_a_line.off": lambda: f"OFF {n} {n - 10} 0\n{rows()}".replace(" ", "\n"),
        "a.stl": lambda: "solid\n" + lines(facet, points[faces].reshape(-1, 9)),
    }[name]()


@pytest.mark.parametrize("name", ["a.xyz", "a.csv", "a.obj", "a.off", "a.ply", "a_number_a_line.off", "a.stl"])
def test_memory_is_at_most_twice_the_file(tmp_path, monkeypatch, name):
    """Beside what a block takes. Numbers of six decimals are about as long as the eight bytes that they become."""
    monkeypatch.setattr(text_lines, "_BLOCK", 2**12)
    monkeypatch.setattr(text_lines, "_LINES", 2**8)
    (tmp_path / name).write_text(written_alike(name, 50))
    read_shape(tmp_path / name)  # what it imports is no part
    text = written_alike(name, 20_000)
    (tmp_path / name).write_text(text)
    tracemalloc.start()
    try:
        read_shape(tmp_path / name)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 2 * len(text) + 500_000


def test_shapes_keep_what_they_are_given_apart():
    """Only arrays that a reader gave are not copied."""
    points = POINTS.copy()
    shape = Shape(points, FACES)
    points[:] = 0
    assert shape.points.any()


def test_many_polygons_are_as_each_alone():
    """Stars of many sizes, some with points on their edges, spikes, and corners twice, one after the other."""
    rng = np.random.default_rng(1)
    rings = []
    for number in range(400):
        n = rng.integers(3, 12)
        angle = (np.arange(n) + rng.random(n) * 0.9) * 2 * np.pi / n
        ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1) * (0.2 + rng.random((n, 1)))
        if number % 4 == 1:
            ring = np.stack([ring, (ring + np.roll(ring, -1, axis=0)) / 2], axis=1).reshape(-1, 3)
        if number % 4 == 2:
            ring = np.concatenate([ring, ring[-1:], (ring[-2:-1] + ring[-1:]) / 2])
        if number % 4 == 3:
            ring = np.repeat(ring, 1 + (np.arange(n) == 1), axis=0)
        rings.append(ring + rng.normal(size=3))
    points, sizes = np.concatenate(rings), np.array([len(ring) for ring in rings])
    alone = [triangulate(ring, np.array([len(ring)]), np.arange(len(ring))) for ring in rings]
    assert sum((found != fans(np.array([len(ring)]))).any() for found, ring in zip(alone, rings, strict=True)) > 200
    expected = np.concatenate([found + start for found, start in zip(alone, np.cumsum(sizes) - sizes, strict=True)])
    np.testing.assert_array_equal(triangulate(points, sizes, np.arange(len(points))), expected)


def test_concave_polygons_whose_corners_are_no_points_stay_as_they_are():
    ring = np.array([[4, 1, 0], [1, 1, 0], [1, 4, 0], [0, 4, 0], [0, 0, 0], [4, 0, 0]], float)
    for wrong in (-1, 99):
        corners = np.array([0, 1, 2, 3, 4, 5, 0, 1, 2, 3, 4, wrong])
        triangles = triangulate(ring, np.array([6, 6]), corners)
        np.testing.assert_array_equal(triangles[4:], fans(np.array([6])) + 6)
        assert (triangles[:4] != fans(np.array([6]))).any()
