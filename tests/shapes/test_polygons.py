"""Polygons become triangles over their own corners that cover them once, whatever their form."""

import meshio
import numpy as np
import pytest

from homolog.shapes import Shape, check, face_areas, read_shape
from homolog.shapes.polygons import fans, strips, triangulate

# An L of area 7; from none of its corners but one does a fan stay inside.
L = np.array([[4, 1, 0], [1, 1, 0], [1, 4, 0], [0, 4, 0], [0, 0, 0], [4, 0, 0]], float)
SOLID = np.concatenate([L, np.add(L, [0, 0, 1])])
SOLID_FACES = [
    [5, 4, 3, 2, 1, 0],
    [6, 7, 8, 9, 10, 11],
    *([i, (i + 1) % 6, 6 + (i + 1) % 6, 6 + i] for i in range(6)),
]
SOLID_AREA = 2 * 7 + 16


def area(points, triangles):
    return face_areas(points, triangles).sum()


def signed_area(ring):
    return np.cross(ring, np.roll(ring, -1, axis=0)).sum(axis=0)[2] / 2


def outline(triangles):
    """The edges of triangles that have no partner, as they run."""
    edges = [tuple(edge) for edge in np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])]
    assert len(set(edges)) == len(edges)
    return {(a, b) for a, b in edges if (b, a) not in edges}


@pytest.mark.parametrize("start", range(6))
@pytest.mark.parametrize("turned", [False, True])
def test_concave_polygon_from_any_corner_and_either_side(make, start, turned):
    ring = np.roll(L[::-1] if turned else L, start, axis=0) @ make.rotation(3).T * 1e3 + 1e5
    triangles = triangulate(ring, np.array([6]), np.arange(6))
    assert area(ring, triangles) == pytest.approx(7e6)
    assert outline(triangles) == {(i, (i + 1) % 6) for i in range(6)}


def test_concave_quadrilateral():
    arrow = np.array([[0, 0, 0], [2, -1, 0], [0, 3, 0], [-2, -1, 0]], float)
    for start in range(4):
        ring = np.roll(arrow, start, axis=0)
        assert area(ring, triangulate(ring, np.array([4]), np.arange(4))) == pytest.approx(6)


def test_random_stars_with_points_on_their_edges():
    """The surface must stay joined to neighbours that use them."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        n = rng.integers(5, 40)
        angle = (np.arange(n) + rng.random(n) * 0.9) * 2 * np.pi / n
        corners = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1) * (0.2 + rng.random((n, 1)))
        ring = np.stack([corners, (corners + np.roll(corners, -1, axis=0)) / 2], axis=1).reshape(-1, 3)
        triangles = triangulate(ring, np.array([2 * n]), np.arange(2 * n))
        assert len(triangles) == 2 * n - 2
        assert area(ring, triangles) == pytest.approx(signed_area(ring))
        assert outline(triangles) == {(i, (i + 1) % (2 * n)) for i in range(2 * n)}


@pytest.mark.parametrize("repeated", range(6))
def test_points_in_one_place_stay_corners(repeated):
    """Ears leave them out."""
    ring = np.insert(L, repeated, L[repeated], axis=0)
    triangles = triangulate(ring, np.array([7]), np.arange(7))
    assert area(ring, triangles) == pytest.approx(7)
    assert outline(triangles) == {(i, (i + 1) % 7) for i in range(7)}


@pytest.mark.parametrize("start", range(12))
def test_outlines_that_turn_back_on_themselves(start):
    """Every corner twice, and spikes without width, wherever they begin."""
    spiky = np.array([[0, 0, 0], [4, 0, 0], [4, 4, 0], [2, 4, 0], [2, 7, 0], [2, 5, 0], [2, 4, 0], [0, 4, 0]], float)
    for ring, expected in ((np.repeat(L, 2, axis=0), 7), (spiky, 16), (np.append(L, L[:1], axis=0), 7)):
        n = len(ring)
        ring = np.roll(ring, start, axis=0)
        triangles = triangulate(ring, np.array([n]), np.arange(n))
        assert area(ring, triangles) == pytest.approx(expected)
        assert outline(triangles) == {(i, (i + 1) % n) for i in range(n)}


@pytest.mark.parametrize("start", range(10))
def test_a_hole_that_a_bridge_leads_to(make, start):
    outside, inside = [[0, 0, 0], [6, 0, 0], [6, 6, 0], [0, 6, 0]], [[2, 2, 0], [2, 4, 0], [4, 4, 0], [4, 2, 0]]
    ring = np.roll(np.array([*outside, outside[0], *inside, inside[0]], float), start, axis=0) @ make.rotation(5).T
    triangles = triangulate(ring, np.array([10]), np.arange(10))
    assert area(ring, triangles) == pytest.approx(36 - 4)
    assert outline(triangles) == {(i, (i + 1) % 10) for i in range(10)}


def test_convex_polygons_keep_their_fans_and_their_order():
    points = np.random.default_rng(0).random((9, 3))
    sizes = np.array([3, 2, 0, 4, 1])
    angle = np.arange(7) * 2 * np.pi / 7
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    np.testing.assert_array_equal(triangulate(ring, np.array([7]), np.arange(7)), fans(np.array([7])))
    np.testing.assert_array_equal(fans(sizes), [[0, 1, 2], [5, 6, 7], [5, 7, 8]])
    assert len(triangulate(points, sizes, np.arange(10) % 9)) == 3


def test_polygons_beyond_repair_give_as_many_triangles_and_no_error():
    line = np.stack([np.arange(6.0), np.zeros(6), np.zeros(6)], axis=1)
    bow = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1, 0], [2, 2, 0], [0.2, 0.1, 0]], float)
    broken = L.copy()
    broken[2] = np.nan
    for ring in (line, bow, broken, np.zeros((6, 3)), L[[0, 1, 2, 3, 3, 3]]):
        assert triangulate(ring, np.array([6]), np.arange(6)).shape == (4, 3)
    assert triangulate(L, np.array([6]), np.array([0, 1, 99, 3, 4, -1])).shape == (4, 3)


def test_strips_turn_every_other_triangle():
    np.testing.assert_array_equal(strips(np.array([5, 2, 3])), [[0, 1, 2], [1, 3, 2], [2, 3, 4], [7, 8, 9]])


def off(path):
    rows = [
        *(" ".join(map(str, point)) for point in SOLID),
        *(f"{len(f)} {' '.join(map(str, f))}" for f in SOLID_FACES),
    ]
    path.write_text(f"OFF\n12 {len(SOLID_FACES)} 0\n" + "\n".join(rows))


def obj(path):
    rows = [f"v {x} {y} {z}" for x, y, z in SOLID] + ["f " + " ".join(str(i + 1) for i in f) for f in SOLID_FACES]
    path.write_text("\n".join(rows))


def ply(path):
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 12\nproperty double x\nproperty double y\n"
    head += f"property double z\nelement face {len(SOLID_FACES)}\nproperty list uchar int vertex_indices\nend_header\n"
    body = SOLID.tobytes() + b"".join(bytes([len(f)]) + np.array(f, "<i4").tobytes() for f in SOLID_FACES)
    path.write_bytes(head.encode() + body)


def vtk(path):
    text = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 12 double\n"
    text += "\n".join(" ".join(map(str, point)) for point in SOLID)
    text += f"\nPOLYGONS {len(SOLID_FACES)} {sum(len(f) + 1 for f in SOLID_FACES)}\n"
    path.write_text(text + "\n".join(f"{len(f)} {' '.join(map(str, f))}" for f in SOLID_FACES) + "\n")


def vtu(path):
    pytest.importorskip("vtkmodules")
    cells = [("polygon", np.array(SOLID_FACES[:2])), ("quad", np.array(SOLID_FACES[2:]))]
    meshio.Mesh(SOLID, cells).write(path)


@pytest.mark.parametrize("write", [off, obj, ply, vtk, vtu])
def test_every_format_triangulates_alike(tmp_path, write):
    path = tmp_path / f"a.{write.__name__}"
    write(path)
    shape = read_shape(path)
    np.testing.assert_array_equal(shape.points, SOLID)
    report = check(shape)
    assert report.area == pytest.approx(SOLID_AREA)
    assert report.n_boundary_loops == 0
    assert {f.rule for f in report.findings} == set()
    assert isinstance(shape, Shape) and shape.n_faces == 20
