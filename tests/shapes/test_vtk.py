"""Surfaces of VTK's grids: over the file's own points, whatever the cells."""

import re

import numpy as np
import pytest

from homolog.core.errors import ShapeError
from homolog.shapes import check, read_shape, write_shape
from homolog.shapes.formats.vtk_process import reason

pytest.importorskip("vtkmodules")
import meshio
import pyvista
from vtkmodules.vtkIOLegacy import vtkPolyDataWriter, vtkUnstructuredGridWriter

# By whether they write a grid.
WRITERS = (vtkPolyDataWriter, vtkUnstructuredGridWriter)

# What these hold may end the process that reads it.
DAMAGED = (
    "test_counts_of_legacy_files",
    "test_damaged_words_before_an_array_are_one_line",
    "test_elements_that_do_not_end_cost_no_more_than_their_number",
    "test_entities_of_xml_that_expand_are_refused_in_our_words",
)


@pytest.fixture(autouse=True)
def _whole_files_are_read_here(request):
    if request.function.__name__ not in DAMAGED:
        request.getfixturevalue("readers_here")


# A cube of side 2 as five tetrahedra.
CUBE = 2.0 * np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
TETRAHEDRA = np.array([[0, 3, 5, 6], [1, 0, 3, 5], [2, 3, 0, 6], [4, 5, 6, 0], [7, 6, 5, 3]])
EDGES = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]


def with_middles(points, cells, edges):
    """Cells with a point on the middle of each edge, shared where cells share the edge."""
    points, cells, number = list(points), cells.tolist(), {}
    for cell in cells:
        for a, b in edges:
            key = tuple(sorted((cell[a], cell[b])))
            if key not in number:
                number[key] = len(points)
                points.append((points[key[0]] + points[key[1]]) / 2)
            cell.append(number[key])
    return np.array(points), np.array(cells)


def surface_is_closed(path, area, n_used):
    shape = read_shape(path)
    report = check(shape)
    assert report.area == pytest.approx(area)
    assert report.n_boundary_loops == 0
    assert len(np.unique(shape.faces)) == n_used
    return shape


@pytest.mark.parametrize("suffix", [".vtu", ".vtk"])
def test_quadratic_tetrahedra(tmp_path, suffix):
    points, cells = with_middles(CUBE, TETRAHEDRA, EDGES)
    meshio.Mesh(points, [("tetra10", cells)]).write(tmp_path / f"a{suffix}")
    shape = surface_is_closed(tmp_path / f"a{suffix}", 24, 26)
    np.testing.assert_array_equal(shape.points, points)
    assert shape.n_faces == 12 * 4


def test_middles_that_leave_their_edges_bend_the_surface(tmp_path):
    points, cells = with_middles(CUBE, TETRAHEDRA, EDGES)
    round_points = points - 1
    round_points /= np.linalg.norm(round_points, axis=1, keepdims=True)
    meshio.Mesh(round_points, [("tetra10", cells)]).write(tmp_path / "a.vtu")
    shape = read_shape(tmp_path / "a.vtu")
    # All points of the surface lie on a sphere; its area is below the sphere's, above that of the cube in it.
    assert 8 < check(shape).area < 4 * np.pi


HEXAHEDRON_EDGES = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
BOX = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float)
WEDGE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]], float)
WEDGE_EDGES = [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)]
PYRAMID = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1]], float)
PYRAMID_EDGES = [(0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4)]


@pytest.mark.parametrize(
    ("kind", "points", "edges", "area"),
    [
        (25, BOX, HEXAHEDRON_EDGES, 6),
        (26, WEDGE, WEDGE_EDGES, 1 + 2 + np.sqrt(2)),
        (27, PYRAMID, PYRAMID_EDGES, 1 + 1 + np.sqrt(2)),
    ],
)
def test_other_quadratic_cells(tmp_path, kind, points, edges, area):
    points, cells = with_middles(points, np.arange(len(points))[None], edges)
    pyvista.UnstructuredGrid(np.append(len(points), cells[0]), np.array([kind]), points).save(tmp_path / "a.vtu")
    surface_is_closed(tmp_path / "a.vtu", area, len(points))


def test_two_quadratic_hexahedra_share_a_face(tmp_path):
    both = np.concatenate([BOX, BOX[[1, 2, 5, 6]] + [1, 0, 0]])
    cells = np.array([[0, 1, 2, 3, 4, 5, 6, 7], [1, 8, 9, 2, 5, 10, 11, 6]])
    points, cells = with_middles(both, cells, HEXAHEDRON_EDGES)
    meshio.Mesh(points, [("hexahedron20", cells)]).write(tmp_path / "a.vtu")
    surface_is_closed(tmp_path / "a.vtu", 10, len(points))


@pytest.mark.parametrize(("kind", "n"), [("quad8", 8), ("quad9", 9), ("triangle6", 6), ("triangle7", 7)])
def test_quadratic_faces(tmp_path, kind, n):
    square, triangle = BOX[:4], BOX[[0, 1, 3]]
    corners = square if kind.startswith("quad") else triangle
    middles = (corners + np.roll(corners, -1, axis=0)) / 2
    points = np.concatenate([corners, middles, [corners.mean(axis=0)]])[:n]
    types = {"quad8": 23, "quad9": 28, "triangle6": 22, "triangle7": 34}
    grid = pyvista.UnstructuredGrid(np.array([n, *range(n)]), np.array([types[kind]]), points)
    grid.save(tmp_path / "a.vtu")
    shape = read_shape(tmp_path / "a.vtu")
    report = check(shape)
    assert report.area == pytest.approx(1 if kind.startswith("quad") else 0.5)
    assert report.n_boundary_loops == 1 and report.n_clean_points == n
    # All look up, as the face does.
    assert np.all(np.cross(*np.diff(shape.points[shape.faces], axis=1).transpose(1, 0, 2))[:, 2] > 0)


def test_linear_and_quadratic_cells_in_one_grid(tmp_path):
    points, cells = with_middles(CUBE, TETRAHEDRA, EDGES)
    meshio.Mesh(points, [("tetra10", cells[:4]), ("tetra", TETRAHEDRA[4:])]).write(tmp_path / "a.vtu")
    assert check(read_shape(tmp_path / "a.vtu")).area == pytest.approx(24)


ANY_NUMBER = {
    # Kind, nodes, and the area that it adds beside a cube whose face x = 1 it may share.
    "polyhedron": (42, [6, *(n for f in ([1, 2, 6, 5], [20, 22, 23, 21], [1, 5, 22, 20]) for n in (4, *f))], 4),
    "polygon": (7, [20, 21, 23, 22], 1),
    "strip": (6, [20, 21, 22, 23], 1),
    "quadratic polygon": (36, [20, 21, 23, 22, 24, 25, 26, 27], 1),
    "points": (1, [20], 0),
    "quadratic edge": (21, [20, 21, 24], 0),
}
ANY_NUMBER["polyhedron"][1].extend(n for f in ([2, 21, 23, 6], [1, 20, 21, 2], [5, 6, 23, 22]) for n in (4, *f))


@pytest.mark.parametrize(("kind", "nodes", "area"), ANY_NUMBER.values(), ids=ANY_NUMBER)
@pytest.mark.parametrize("quadratic", [True, False])
def test_cells_of_any_number_of_corners(tmp_path, kind, nodes, area, quadratic):
    """Beside quadratic cells, and beside linear ones."""
    box, cells = with_middles(BOX, np.arange(8)[None], HEXAHEDRON_EDGES)
    square = np.array([[2, 0, 0], [2, 1, 0], [2, 0, 1], [2, 1, 1]], float)
    middles = np.array([[2, 0.5, 0], [2, 1, 0.5], [2, 0.5, 1], [2, 0, 0.5]])
    cube = [20, *cells[0]] if quadratic else [8, *range(8)]
    points = np.concatenate([box, square, middles])
    grid = pyvista.UnstructuredGrid(
        np.array([*cube, len(nodes), *nodes]), np.array([25 if quadratic else 12, kind]), points
    )
    grid.save(tmp_path / "a.vtu")
    shape = read_shape(tmp_path / "a.vtu")
    assert check(shape).area == pytest.approx(6 + area)
    np.testing.assert_array_equal(shape.points, points)


def test_cells_of_higher_order_are_refused(tmp_path):
    grid = pyvista.UnstructuredGrid(
        np.array([10, *range(10)]), np.array([69]), np.random.default_rng(0).random((10, 3))
    )
    grid.save(tmp_path / "a.vtu")
    with pytest.raises(ShapeError, match=r"vtkLagrangeTriangle are not read; export it with linear cells alone$"):
        read_shape(tmp_path / "a.vtu")


def test_the_content_says_which_kind_a_file_holds(tmp_path, make):
    """Whatever its suffix says."""
    write_shape(tmp_path / "a.vtp", make.blob(1))
    write_shape(tmp_path / "a.vtk", make.blob(1))
    for source, name in (("a.vtp", "b.vtu"), ("a.vtp", "b.vtk"), ("a.vtk", "b.vtp")):
        (tmp_path / name).write_bytes((tmp_path / source).read_bytes())
        np.testing.assert_array_equal(read_shape(tmp_path / name).faces, make.blob(1).faces)
    (tmp_path / "c.vtu").write_text('<?xml version="1.0"?>\n<VTKFile type="ImageData"></VTKFile>')
    with pytest.raises(ShapeError, match="holds a data set ImageData, but PolyData or UnstructuredGrid is needed"):
        read_shape(tmp_path / "c.vtu")


def test_strips(tmp_path):
    text = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 5 double\n"
    text += "0 0 0\n1 0 0\n0 1 0\n1 1 0\n0 2 0\nTRIANGLE_STRIPS 1 6\n5 0 1 2 3 4\n"
    (tmp_path / "a.vtk").write_text(text)
    np.testing.assert_array_equal(read_shape(tmp_path / "a.vtk").faces, [[0, 1, 2], [1, 3, 2], [2, 3, 4]])


@pytest.mark.parametrize("n", [1, 64, 65, 256, 1000])
@pytest.mark.parametrize("mark", [b" ", b"\n"])
def test_blanks_at_the_end(tmp_path, make, n, mark):
    """VTK's own reader waits forever where there are 256."""
    write_shape(tmp_path / "a.vtk", make.blob(1))
    (tmp_path / "b.vtk").write_bytes((tmp_path / "a.vtk").read_bytes() + n * mark)
    np.testing.assert_array_equal(read_shape(tmp_path / "b.vtk").faces, make.blob(1).faces)


def piece(kind, counts, arrays):
    """An XML file of one piece: its counts, and its arrays of text by section and name."""
    names = " ".join(f'NumberOf{name}="{count}"' for name, count in counts.items())
    sections = "".join(
        f"<{section}>"
        + "".join(
            f'<DataArray type="Int32" {name} format="ascii">{values}</DataArray>' for name, values in held.items()
        )
        + f"</{section}>"
        for section, held in arrays.items()
    )
    return f'<VTKFile type="{kind}" version="0.1"><{kind}><Piece {names}>{sections}</Piece></{kind}></VTKFile>'


@pytest.mark.parametrize(("kind", "cells"), [("PolyData", "Polys"), ("UnstructuredGrid", "Cells")])
@pytest.mark.parametrize(
    ("n_points", "n_cells", "found"), [(4, 3, ""), (4, 2, "2 {}, but holds 3"), (3, 3, "3 points")]
)
def test_pieces_that_hold_more_than_they_count_are_refused(tmp_path, kind, cells, n_points, n_cells, found):
    points = {'NumberOfComponents="3"': "0 0 0 1 0 0 0 1 0 0 0 1"}
    held = {'Name="connectivity"': "0 1 2 0 1 3 0 2 3", 'Name="offsets"': "3 6 9"}
    if kind == "UnstructuredGrid":
        held['Name="types"'] = "5 5 5"
    text = piece(kind, {"Points": n_points, cells: n_cells}, {"Points": points, cells: held})
    path = tmp_path / "a.vtp"
    path.write_text(text)
    if not found:
        assert read_shape(path).n_faces == 3
        return
    with pytest.raises(ShapeError, match=rf"a\.vtp .*a piece of it announces {found.format(cells.lower())}"):
        read_shape(path)


@pytest.mark.parametrize("suffix", [".vtu", ".vtk", ".vtp"])
def test_lines_beside_triangles_are_noted(tmp_path, suffix):
    data = pyvista.PolyData(CUBE, faces=[3, 0, 1, 2, 3, 1, 2, 3], lines=[2, 0, 1, 3, 4, 5, 6])
    (data.cast_to_unstructured_grid() if suffix == ".vtu" else data).save(tmp_path / f"a{suffix}")
    shape = read_shape(tmp_path / f"a{suffix}")
    assert shape.n_faces == 2
    assert [(note.rule, note.count) for note in shape.notes] == [("lines", 2)]


def written(path, data, mode, *, compressed=False, raw=False):
    """What VTK writes of a data set, with words of eight bytes where it is compressed."""
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

    writer = vtkXMLPolyDataWriter() if path.suffix == ".vtp" else vtkXMLUnstructuredGridWriter()
    writer.SetInputData(data)
    writer.SetFileName(str(path))
    getattr(writer, f"SetDataModeTo{mode}")()
    writer.SetEncodeAppendedData(not raw)
    writer.SetBlockSize(1024)
    if compressed:
        writer.SetHeaderTypeToUInt64()
        writer.SetByteOrderToBigEndian()
    else:
        writer.SetCompressorTypeToNone()
        writer.SetHeaderTypeToUInt32()
    writer.Write()
    return path.read_bytes()


@pytest.mark.parametrize("mode", ["Ascii", "Binary", "Appended"])
@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize("suffix", [".vtp", ".vtu"])
def test_other_counts_than_the_arrays_hold_are_refused(tmp_path, mode, compressed, raw, suffix):
    """VTK itself passes over what is more, so that faces and points would be lost."""
    ball = pyvista.Icosphere(nsub=2)
    path = tmp_path / f"a{suffix}"
    cells = "Polys" if suffix == ".vtp" else "Cells"
    data = ball if suffix == ".vtp" else ball.cast_to_unstructured_grid()
    content = written(path, data, mode, compressed=compressed, raw=raw)
    if raw or mode == "Ascii":
        assert (read_shape(path).n_points, read_shape(path).n_faces) == (162, 320)
    for name, count in (("Points", 162), (cells, 320)):
        entry = re.search(rb"NumberOf%s=\"\s*%d" % (name.encode(), count), content)[0]
        for other in (count - 1, count + 1, 0):
            path.write_bytes(content.replace(entry, b'NumberOf%s="%d' % (name.encode(), other)))
            said = f"announces {other} {name.lower()}, but holds {count}; correct the count"
            with pytest.raises(ShapeError, match=said):
                read_shape(path)


def test_damaged_words_before_an_array_are_one_line(tmp_path):
    content = written(tmp_path / "a.vtu", pyvista.Icosphere(nsub=1).cast_to_unstructured_grid(), "Appended")
    start = content.index(b"_", content.index(b"<AppendedData")) + 1
    for word in (b"!!!!!!!!", b"====", b"AAAAAA==", b"//////8=", b"<"):
        (tmp_path / "a.vtu").write_bytes(content[:start] + word + content[start + len(word) :])
        with pytest.raises(ShapeError) as error:
            read_shape(tmp_path / "a.vtu")
        assert str(error.value).isprintable()
    offsets = list(re.finditer(rb'offset="(\d+)"', content))
    for entry, other in ((offsets[0], b"1"), (offsets[1], b"9" * 30), (offsets[-2], b"0")):
        (tmp_path / "a.vtu").write_bytes(content[: entry.start(1)] + other + content[entry.end(1) :])
        with pytest.raises(ShapeError) as error:
            read_shape(tmp_path / "a.vtu")
        assert str(error.value).isprintable()


def test_elements_that_do_not_end_cost_no_more_than_their_number(tmp_path):
    for text in ("<Piece>", "<Piece ", "<DataArray ", "<AppendedData ", "<AppendedData>" + " " * 1000):
        (tmp_path / "a.vtp").write_text(f'<VTKFile type="PolyData">{text * 30_000}</VTKFile>')
        with pytest.raises(ShapeError):
            read_shape(tmp_path / "a.vtp")


@pytest.fixture(params=[(False, False), (False, True), (True, False), (True, True)])
def legacy_file(tmp_path, request):
    """A cube of 12 triangles as VTK writes it, as text or binary, as poly data or as a grid."""
    is_binary, is_grid = request.param
    data = pyvista.Cube().triangulate()
    data.clear_data()
    data = data.cast_to_unstructured_grid() if is_grid else data
    (write := WRITERS[is_grid]()).SetInputData(data)
    write.SetFileVersion(42)
    write.SetFileName(str(tmp_path / "a.vtk"))
    (write.SetFileTypeToBinary if is_binary else write.SetFileTypeToASCII)()
    write.Write()
    return tmp_path / "a.vtk", is_binary == is_grid


def test_a_mark_before_a_legacy_file_changes_nothing(tmp_path, legacy_file):
    path, _ = legacy_file
    assert read_shape(path).n_faces == 12
    (tmp_path / "c.vtk").write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    np.testing.assert_array_equal(read_shape(tmp_path / "c.vtk").faces, read_shape(path).faces)


def test_counts_of_legacy_files(tmp_path, legacy_file):
    """VTK reads by one of the two counts of cells, and drops or makes up what the other one says."""
    path, all_of_them = legacy_file
    content = path.read_bytes()
    assert content.count(b" 12 48\n") == 1
    wrong = (b"11 48", b"13 48", b"12 47", b"12 44", b"12 49", b"12 52", b"6 24")
    for counts in wrong if all_of_them else wrong[1:3]:  # each is read by a process of its own
        (tmp_path / "b.vtk").write_bytes(content.replace(b" 12 48\n", b" %s\n" % counts))
        with pytest.raises(ShapeError, match=r"b\.vtk could not be read as VTK: "):
            read_shape(tmp_path / "b.vtk")


def test_entities_of_xml_that_expand_are_refused_in_our_words(tmp_path):
    entities = "".join(f'<!ENTITY a{n} "{f"&a{n - 1};" * 10}">' for n in range(1, 9))
    head = f'<?xml version="1.0"?><!DOCTYPE l [<!ENTITY a0 "{"a" * 32}">{entities}]>'
    (tmp_path / "a.vtp").write_text(f'{head}<VTKFile type="PolyData">&a8;</VTKFile>')
    with pytest.raises(ShapeError, match=r"a\.vtp .*: the entities of its XML would expand to too much; "):
        read_shape(tmp_path / "a.vtp")


def test_what_vtk_says_is_cut_between_words():
    said = reason("ERROR: In vtkReader.cxx, line 1\nvtkReader (0x5f): " + "the header is damaged " * 9)
    assert said == "the header is damaged " * 3 + "the header ..."
