"""Files as other programs write them: read where nothing is lost, and said to the user where something is left out."""

import numpy as np
import pytest

from homolog.core.errors import ShapeError
from homolog.shapes import Shape, as_shape, check, read_shape, write_shape

POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [9, 9, 9]], float)
FACES = np.array([[0, 1, 2], [0, 2, 3], [0, 1, 4]])


def put(folder, name, content):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def rows(values, pattern="{}"):
    return "".join(pattern.format(" ".join(map(str, row))) + "\n" for row in values)


def notes(shape):
    return {f.rule: (f.count, f.action) for f in check(shape).findings if f in shape.notes}


def is_cloud(shape):
    np.testing.assert_array_equal(shape.points, POINTS)
    return shape.faces is None


OFF_FACES = rows(FACES, "3 {}")


OFF_HEADS = [
    *("OFF\n6\n3\n0\n", "OFF 6 3\n", "6 3 0\n", "OFF # x\n6\n3\n\n0\n", "STCNOFF\n6 3 0\n", "off\n6 3 0\n"),
    *("OFF\n6 3\n0\n", "OFF\n6\n3 0\n", "OFF\n6\n3\n", "nOFF\n3\n6 3 0\n", "nOFF 3\n6 3\n", "CnOFF\n# x\n3\n6\n3\n0\n"),
]


@pytest.mark.parametrize("head", OFF_HEADS)
def test_off_headers(tmp_path, head):
    shape = read_shape(put(tmp_path, "a.off", head + rows(POINTS) + OFF_FACES))
    np.testing.assert_array_equal(shape.points, POINTS)
    np.testing.assert_array_equal(shape.faces, FACES)


def test_off_with_four_coordinates(tmp_path):
    weights = np.array([[1], [2], [4], [0.5], [1], [1]])
    four = np.concatenate([POINTS * weights, weights], axis=1)
    shape = read_shape(put(tmp_path, "a.off", "4OFF\n6 3 0\n" + rows(four) + OFF_FACES))
    np.testing.assert_array_equal(shape.points, POINTS)


@pytest.mark.parametrize("head", ["OFF\n", "4OFF\n"])
def test_off_whose_line_breaks_mean_nothing(tmp_path, head):
    four = np.concatenate([POINTS, np.ones((6, 1))], axis=1) if "4" in head else POINTS
    numbers = f"6 3 0 {rows(four)} {OFF_FACES}".split()
    for width in (1, 7, 100):
        lines = [" ".join(numbers[first : first + width]) for first in range(3, len(numbers), width)]
        shape = read_shape(put(tmp_path, "a.off", head + "6 3 0\n" + "\n".join(lines)))
        np.testing.assert_array_equal(shape.points, POINTS)
        np.testing.assert_array_equal(shape.faces, FACES)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"OFF BINARY\n" + bytes(60), "it is a binary OFF"),
        (b"# x\nCOFF binary\n" + bytes(60), "it is a binary OFF"),
        ("nOFF\n4\n6 3 0\n" + rows(POINTS, "{} 1"), "have 4 coordinates, but three are needed"),
        ("HOFF\n6 3 0\n" + rows(POINTS), "does not start with OFF, .*, but with 'HOFF'"),
        ("5 6 oops\n" + rows(POINTS), "but with '5 6 oops'"),
    ],
)
def test_off_that_is_not_read_has_a_true_reason(tmp_path, content, reason):
    with pytest.raises(ShapeError, match=reason):
        read_shape(put(tmp_path, "a.off", content))


VERTEX = "property float x\nproperty float y\nproperty float z\n"


@pytest.mark.parametrize("more", ["3 0 1 3\n", "3 0 1 3\n\n3 1 2 3\n", "rubbish\n"])
@pytest.mark.parametrize("head", ["OFF\n", "COFF\n", ""])
def test_off_with_more_lines_than_its_header_counts_is_refused(tmp_path, head, more):
    text = f"{head}6 3 0\n{rows(POINTS)}{OFF_FACES}"
    assert read_shape(put(tmp_path, "a.off", text + "\n \n# the end\n")).n_faces == 3
    n_more = len(more.split("\n\n"))
    with pytest.raises(ShapeError, match=rf"a\.off .*: {n_more} lines? follows? .* announces \(6 points, 3 faces\)"):
        read_shape(put(tmp_path, "a.off", text + more))


def test_off_with_more_numbers_than_its_header_counts_is_refused(tmp_path):
    numbers = f"{rows(POINTS)}{OFF_FACES}3 0 1 3".replace("\n", " ")
    with pytest.raises(ShapeError, match="announces 6 points and 3 faces, but its lines do not hold these"):
        read_shape(put(tmp_path, "a.off", f"OFF\n6 3 0\n{numbers}\n"))


def ply(order, elements, body, comment="comment x"):
    return f"ply\nformat {order} 1.0\n{comment}\n{elements}end_header\n".encode() + body


@pytest.mark.parametrize(("order", "mark"), [("binary_little_endian", "<"), ("binary_big_endian", ">")])
@pytest.mark.parametrize("sizes", [[2] * 6, [0, 1, 2, 3, 0, 1], [5, 0, 0, 1, 0, 0]], ids=["alike", "mixed", "falling"])
@pytest.mark.parametrize("place", ["before", "between", "behind"])
def test_ply_vertices_with_lists(tmp_path, order, mark, sizes, place):
    """As photogrammetry writes them: the views of each point, and their weights."""
    views, weights = "property list uchar uint views\n", "property list uchar float weights\n"
    scalars = "".join(f"property double {axis}\n" for axis in "xyz") + "property uchar red\n"
    if place == "before":
        properties = views + weights + scalars
    elif place == "between":
        properties = views + scalars + weights
    else:
        properties = scalars + views + weights
    body = b""
    for n, point in zip(sizes, POINTS, strict=True):
        some = {
            "views": bytes([n]) + np.arange(n, dtype=mark + "u4").tobytes(),
            "weights": bytes([n]) + np.ones(n, mark + "f4").tobytes(),
            "scalars": point.astype(mark + "f8").tobytes() + b"\7",
        }
        names = {"before": ["views", "weights", "scalars"], "between": ["views", "scalars", "weights"]}
        body += b"".join(some[name] for name in names.get(place, ["scalars", "views", "weights"]))
    body += b"".join(b"\3" + face.astype(mark + "i4").tobytes() for face in FACES)
    elements = f"element vertex 6\n{properties}element face 3\nproperty list uchar int vertex_indices\n"
    shape = read_shape(put(tmp_path, "a.ply", ply(order, elements, body)))
    np.testing.assert_array_equal(shape.points, POINTS)
    np.testing.assert_array_equal(shape.faces, FACES)
    # Without faces the vertices are the last thing in the file.
    alone = elements.partition("element face")[0]
    np.testing.assert_array_equal(read_shape(put(tmp_path, "b.ply", ply(order, alone, body[:-39]))).points, POINTS)
    for kinds, n_missing in ((elements, 3), (alone, 40)):
        with pytest.raises(ShapeError, match="ends before the last element"):
            read_shape(put(tmp_path, "c.ply", ply(order, kinds, body[:-n_missing])))


def test_ply_with_old_line_ends_and_capitals(tmp_path):
    elements = f"element vertex 6\n{VERTEX.upper().replace('PROPERTY FLOAT', 'property float')}"
    text = ply("ascii", elements, rows(POINTS).encode())
    assert is_cloud(read_shape(put(tmp_path, "a.ply", text.replace(b"\n", b"\r"))))


@pytest.mark.parametrize("comment", ["comment before end_header by me", "comment end_header", "obj_info end_header"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("padding", [0, 2**16 - 30, 2**16 - 200])
def test_ply_header_ends_at_a_line_of_its_own(tmp_path, comment, end, padding):
    """Also where that line lies at the end of what is read at a time."""
    head = ["ply", "format ascii 1.0", comment, "comment " + "x" * padding, "element vertex 6"]
    head += [*(f"property float {axis}" for axis in "xyz"), "end_header \t", *rows(POINTS).splitlines()]
    assert is_cloud(read_shape(put(tmp_path, "a.ply", (end.join(head) + end).encode())))


def test_ply_lines_beyond_the_last_element_are_refused(tmp_path):
    text = ply("ascii", f"element vertex 6\n{VERTEX}", (rows(POINTS) + OFF_FACES).encode())
    with pytest.raises(ShapeError, match=r"3 lines follow the elements that its header announces \(6 vertex\)"):
        read_shape(put(tmp_path, "a.ply", text))


def test_ply_bytes_beyond_the_last_element_are_noted(tmp_path):
    content = ply("binary_little_endian", f"element vertex 6\n{VERTEX}", POINTS.astype("<f4").tobytes())
    assert notes(read_shape(put(tmp_path, "a.ply", content + b"\n"))) == {}
    shape = read_shape(put(tmp_path, "b.ply", content + bytes(7)))
    assert notes(shape)["bytes after the last element"][0] == 7


def test_ply_edges_are_noted(tmp_path):
    elements = f"element vertex 6\n{VERTEX}\nelement edge 2\nproperty int vertex1\nproperty int vertex2\n"
    shape = read_shape(put(tmp_path, "a.ply", ply("ascii", elements, (rows(POINTS) + "0 1\n1 2\n").encode())))
    assert notes(shape)["lines"][0] == 2


def test_pcd_bytes_beyond_the_last_point_are_noted(tmp_path):
    pytest.importorskip("pypcd4")
    head = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 6\nHEIGHT 1\n"
    head += "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 6\nDATA binary\n"
    content = head.encode() + POINTS.astype("<f4").tobytes()
    assert is_cloud(read_shape(put(tmp_path, "a.pcd", content))) and notes(read_shape(tmp_path / "a.pcd")) == {}
    shape = read_shape(put(tmp_path, "b.pcd", content + POINTS[:2].astype("<f4").tobytes()))
    assert is_cloud(shape) and notes(shape)["bytes after the last point"][0] == 24


STL_FACETS = np.zeros(3, [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
STL_FACETS["v"] = POINTS[FACES]


def stl(count, more=b"", title=b"solid of a program"):
    return title.ljust(80) + np.uint32(count).tobytes() + STL_FACETS.tobytes() + more


@pytest.mark.parametrize("title", [b"solid of a program", b"another"])
def test_stl_binary_with_bytes_after_its_triangles(tmp_path, title):
    for count in (3, 0, 2**32 - 1):
        shape = read_shape(put(tmp_path, "a.stl", stl(count, title=title)))
        assert shape.n_faces == 3 and not shape.notes
        shape = read_shape(put(tmp_path, "a.stl", stl(count, b"\0\1", title)))
        assert shape.n_faces == 3 and notes(shape)["bytes after the last triangle"][0] == 2
    with pytest.raises(ShapeError, match="has 100 bytes too many for the 1 triangles"):
        read_shape(put(tmp_path, "a.stl", stl(1, title=title)))
    with pytest.raises(ShapeError, match="cannot hold the 4 triangles"):
        read_shape(put(tmp_path, "a.stl", stl(4, title=title)))


@pytest.mark.parametrize("end", ["endsolid x\n", "end solid x\n", "", "END SOLID", "endsolid\n\0\0"])
def test_stl_text_with_any_end(tmp_path, end):
    facets = ""
    for face in POINTS[FACES]:
        facets += "facet normal 0 0 0\nouter loop\n" + rows(face, "vertex {}") + "endloop\nendfacet\n"
    assert read_shape(put(tmp_path, "a.stl", "solid x\n" + facets + end)).n_faces == 3
    with pytest.raises(ShapeError, match="last triangle"):
        read_shape(put(tmp_path, "a.stl", "solid x\n" + facets.removesuffix("endfacet\n") + end))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-32"])
def test_stl_text_with_a_byte_order_mark(tmp_path, encoding):
    corners = "".join(f"vertex {x} {y} {z}\n" for x, y, z in POINTS[:3])
    text = "solid x\nfacet normal 0 0 1\nouter loop\n" + corners + "endloop\nendfacet\nendsolid x\n"
    text += text.replace("1.0", "2.0")
    np.testing.assert_array_equal(read_shape(put(tmp_path, "a.stl", text.encode(encoding))).points[:3], POINTS[:3])


HEADERS = {
    "a.ply": "ply\nformat ascii 1.0\nelement vertex 6\n" + rows("xyz", "property float {}") + "end_header\n",
    "a.pcd": "VERSION .7\nFIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 6\nHEIGHT 1\nPOINTS 6\nDATA ascii\n",
    "a.vtk": "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 6 float\n",
}


@pytest.mark.parametrize("name", HEADERS)
def test_a_header_behind_a_byte_order_mark(tmp_path, name):
    text = HEADERS[name] + rows(POINTS)
    np.testing.assert_array_equal(read_shape(put(tmp_path, name, text.encode("utf-8-sig"))).points, POINTS)
    with pytest.raises(ShapeError, match=r"it is UTF-16 text, but UTF-8 is needed; save it as UTF-8$"):
        read_shape(put(tmp_path, name, text.encode("utf-16")))


def decimal_commas(index, mark):
    lines = [index.format(number) + mark.join(map(str, point)) for number, point in enumerate(POINTS)]
    return "\n".join(lines).replace(".", ",") + "\n"


NUMBERED = {
    "a count first": "6\n" + rows(POINTS),
    "chemists'": "6\nwater\n" + rows(POINTS, "C {}"),
    "chemists', no comment": "6\n\n" + rows(POINTS, "C {}"),
    "chemists', numbers": "6\n1 2 3\n" + rows(POINTS, "C {}"),
    "chemists', a mark": "6\n# made up\n" + rows(POINTS, "C {}"),
    "an index of R": '"x" "y" "z"\n' + "".join(f'"{i}" {rows([p])}' for i, p in enumerate(POINTS, 1)),
    "an index of pandas": ",x,y,z\n" + "".join(f"{i},{','.join(map(str, p))}\n" for i, p in enumerate(POINTS)),
    "an index and other names": ",a,b,c\n" + "".join(f"{i},{','.join(map(str, p))}\n" for i, p in enumerate(POINTS)),
    "numbers for names": ",0,1,2\n" + "".join(f"{i},{','.join(map(str, p))}\n" for i, p in enumerate(POINTS)),
    "numbers for names, no index": "0,1,2\n" + "".join(f"{','.join(map(str, p))}\n" for p in POINTS),
    "an index without names": "".join(f"{i} {rows([p])}" for i, p in enumerate(POINTS)),
    "an index from 1": "".join(f"{i} {rows([p])}" for i, p in enumerate(POINTS, 1)),
    "names of points": "".join(f"P{i}, {', '.join(map(str, p))}\n" for i, p in enumerate(POINTS)),
    "names with commas": "".join(f'"P, {i}",{",".join(map(str, p))}\n' for i, p in enumerate(POINTS)),
    "another column": "".join(f"{' '.join(map(str, p))} {i}\n" for i, p in enumerate(POINTS)),
    "an index in any order": "".join(
        f"{i} {rows([p + 0.5])}" for i, p in zip((9, 2, 40, 7, 1, 3), POINTS - 0.5, strict=True)
    ),
    "elements by number": "6\nwater\n" + "".join(f"{i % 3} {rows([p])}" for i, p in enumerate(POINTS)),
    "decimal commas": "x;y;z\n" + "".join(";".join(map(str, p)).replace(".", ",") + "\n" for p in POINTS),
    "decimal commas, an index": ";X;Y;Z\n" + decimal_commas("{};", ";"),
    "decimal commas and tabs": decimal_commas("", "\t"),
    "decimal commas and blanks": decimal_commas("", "  "),
    "what separates cells": "sep=;\nx;y;z\n" + decimal_commas("", ";"),
    "a count and names": "6\nx y z\n" + rows(POINTS),
    "a title": "skull\n" + rows(POINTS),
    "a title of two words, and names": "my skull\n" + rows(POINTS, "name {}"),
    "names that lost their beginning": "y,z\n" + rows(POINTS, "name {}").replace(" ", ","),
    "quotes behind blanks": "i,name,x,y,z\n"
    + rows(POINTS, '1,#"a,b"#{}').replace(" ", ",").replace("#", " ").replace('" ', '",'),
    "a comma at the end": "x,y,z\n" + "".join(f"{','.join(map(str, p))},\n" for p in POINTS),
}


@pytest.mark.parametrize("text", NUMBERED.values(), ids=NUMBERED)
@pytest.mark.parametrize("suffix", [".xyz", ".csv", ".txt"])
def test_tables_with_counts_and_indices(tmp_path, text, suffix):
    assert is_cloud(read_shape(put(tmp_path, "a" + suffix, text)))


def test_a_column_that_is_left_out_is_noted(tmp_path):
    shape = read_shape(put(tmp_path, "a.xyz", NUMBERED["an index without names"]))
    assert "names or numbers the rows" in notes(shape)["first column"][1]


@pytest.mark.parametrize(
    ("head", "pattern", "count", "taken"),
    [
        ("", "{} 7", 1, "the first three"),
        ("", "{} 0 0 1 0.5", 4, "the first three"),
        ("x y z intensity\n", "{} 7", 1, "x, y, z"),
        ("i pos_x pos_y pos_z\n", "0.5 {}", 1, "pos_x, pos_y, pos_z"),
        ("", "name {} 8 9", 2, "the next three"),
    ],
)
def test_columns_beside_the_coordinates_are_noted(tmp_path, head, pattern, count, taken):
    shape = read_shape(put(tmp_path, "a.xyz", head + rows(POINTS, pattern)))
    assert is_cloud(shape)
    found, action = notes(shape)["other columns"]
    assert found == count and f"the coordinates are {taken}; if they are not, name" in action


def test_three_columns_leave_nothing_out(tmp_path):
    assert notes(read_shape(put(tmp_path, "a.xyz", rows(POINTS)))) == {}
    assert notes(read_shape(put(tmp_path, "a.csv", "x,y,z\n" + rows(POINTS).replace(" ", ",")))) == {}


@pytest.mark.parametrize(
    "encoding", ["utf-8-sig", "utf-16", "utf-32", "utf-16-le", "utf-16-be", "utf-32-le", "utf-32-be"]
)
def test_tables_with_a_byte_order_mark(tmp_path, encoding):
    mark = "\ufeff" if encoding[-2:] in ("le", "be") else ""
    assert is_cloud(read_shape(put(tmp_path, "a.txt", (mark + rows(POINTS)).encode(encoding))))


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("x,y\n1.5,2.5\n2,3\n", "its columns are named x, y; a z is missing"),
        ("z pos_x\n1.5 2.5\n", "its columns are named z, pos_x; a y is missing"),
        (",x,y\n0,1.5,2.5\n1,2,3\n", "its columns are named x, y; a z is missing"),
        ("x|y\n1.5|2.5\n", "its columns are named x, y; a z is missing"),
        ("x\n1.5\n", "its columns are named x; y and z are missing"),
        ("1.5,2.5\n3.5,4.5\n", "its first row '1.5,2.5' has 2 values, but three columns are needed"),
        ("1.5 2.5\n3.5 4.5\n", "its first row '1.5 2.5' has 2 values, but three columns are needed"),
        ("1.5~2.5~3.5\n" * 2, "the line '1.5~2.5~3.5' is one value, but x, y and z are needed, separated by commas"),
    ],
)
def test_tables_of_too_few_columns_say_what_is_missing(tmp_path, table, said):
    with pytest.raises(ShapeError) as caught:
        read_shape(put(tmp_path, "a.csv", table))
    assert said in str(caught.value)


@pytest.mark.parametrize("head", ["", "x|y|z\n", "x | y | z\n", "sep=|\n"])
@pytest.mark.parametrize("point", [".", ","])
def test_tables_that_bars_separate(tmp_path, head, point):
    cells = "".join(" | ".join(map(str, row)) + "\n" for row in POINTS).replace(".", point)
    assert is_cloud(read_shape(put(tmp_path, "a.csv", head + cells)))


def test_a_bar_within_a_name_separates_nothing(tmp_path):
    assert is_cloud(read_shape(put(tmp_path, "a.csv", rows(POINTS, "left|up {}").replace(" ", ","))))


def test_rows_without_coordinates_stay_points(tmp_path):
    for text in ("x,y,z\n,,\n", "x;y;z\nNA;NA;NA\n", "i,x,y,z\n7,,,\n"):
        mark, index = text[1], "1" + text[1] if text[0] == "i" else ""
        table = text + "".join(index + mark.join(map(str, p)) + "\n" for p in POINTS)
        shape = read_shape(put(tmp_path, "a.csv", table))
        assert np.isnan(shape.points[0]).all()
        np.testing.assert_array_equal(shape.points[1:], POINTS)


def test_whole_coordinates_are_no_index(tmp_path):
    """Only rows with decimal places show that the first column is another thing than x."""
    whole = rows([[i, 2, 3, 4] for i in (9, 2, 40, 7)])
    assert read_shape(put(tmp_path, "a.xyz", whole)).points[0].tolist() == [9, 2, 3]


def test_a_count_that_does_not_fit_is_refused(tmp_path):
    for count in (5, 7, 10**30):
        with pytest.raises(ShapeError, match=f"announces {count} points, but 6 lines follow"):
            read_shape(put(tmp_path, "a.xyz", f"{count}\n" + rows(POINTS)))


@pytest.mark.parametrize(
    ("head", "pattern"),
    [
        ("r theta phi\n", "{}"),
        ("# r theta phi\n", "{}"),
        ("x y height\n", "{}"),
        (",r,theta,phi\n", "n,{}"),
        ("r,theta,phi\n", "n,{}"),
    ],
)
def test_three_columns_of_other_names_are_noted(tmp_path, head, pattern):
    text = rows(POINTS, pattern)
    shape = read_shape(put(tmp_path, "a.csv", head + (text.replace(" ", ",") if "," in pattern else text)))
    assert is_cloud(shape)
    names = ", ".join(head.strip("#, \n").replace(",", " ").split())
    count, action = notes(shape)["columns of other names"]
    assert count == 3 and action.startswith(f"{names} are taken as x, y and z")


def test_numbers_are_no_other_names(tmp_path):
    """As pandas numbers columns."""
    assert notes(read_shape(put(tmp_path, "a.csv", "0,1,2\n" + rows(POINTS + 0.5).replace(" ", ",")))) == {}


@pytest.mark.parametrize("points", ["points", "vertices", "verts", "V", "xyz", "pos", "coords"])
@pytest.mark.parametrize("faces", ["faces", "triangles", "tris", "F", "face", "tri", "polys"])
def test_npz_keys(tmp_path, points, faces):
    np.savez(tmp_path / "a.npz", **{points: POINTS, faces: FACES})
    shape = read_shape(tmp_path / "a.npz")
    np.testing.assert_array_equal(shape.faces, FACES)
    assert not shape.notes


def test_npz_arrays_that_are_left_out_are_named(tmp_path):
    np.savez(tmp_path / "a.npz", points=POINTS, edges=FACES, weights=np.ones(6))
    shape = read_shape(tmp_path / "a.npz")
    assert shape.faces is None
    assert "edges, weights are not points or faces" in notes(shape)["arrays left out"[:6]][1]


def test_npz_of_one_array(tmp_path):
    np.savez(tmp_path / "a.npz", POINTS)
    assert is_cloud(read_shape(tmp_path / "a.npz"))
    np.savez(tmp_path / "a.npz", Verts=POINTS)
    assert is_cloud(read_shape(tmp_path / "a.npz"))


@pytest.mark.parametrize("name", ["faces", "TRIS", "labels", "normals", "arr_1"])
@pytest.mark.parametrize("further", [{}, {"f": FACES}, {"colours": POINTS}])
def test_npz_without_a_name_of_points(tmp_path, name, further):
    """An array that stands alone may be anything, and so may an unnamed one beside others."""
    np.savez(tmp_path / "a.npz", **{name: POINTS}, **further)
    with pytest.raises(ShapeError) as caught:
        read_shape(tmp_path / "a.npz")
    found = ", ".join(sorted([name, *further]))
    assert f"it holds {found}, but an array of points is needed, named one of points, vertices, verts, v," in str(
        caught.value
    )
    assert "faces are named one of faces, triangles, tris, f," in str(caught.value)


def test_npz_with_several_arrays_of_a_kind_says_which_was_chosen(tmp_path):
    arrays = {"v": POINTS + 1, "vertices": POINTS, "F": FACES[:1], "faces": FACES, "edges": FACES}
    np.savez(tmp_path / "a.npz", **arrays)
    shape = read_shape(tmp_path / "a.npz")
    np.testing.assert_array_equal(shape.points, POINTS)
    np.testing.assert_array_equal(shape.faces, FACES)
    found = notes(shape)
    assert found.keys() == {"other arrays of points", "other arrays of faces", "arrays"}
    assert "the points are those of vertices, not of v;" in found["other arrays of points"][1]
    assert "the faces are those of faces, not of F;" in found["other arrays of faces"][1]
    assert found["arrays"][1].endswith("edges are not points or faces")
    np.savez(tmp_path / "a.npz", v=POINTS, V=POINTS + 1)
    shape = read_shape(tmp_path / "a.npz")
    np.testing.assert_array_equal(shape.points, POINTS)
    assert "the points are those of v, not of V;" in notes(shape)["other arrays of points"][1]


def test_columns_of_arrays_that_are_left_out_are_noted(tmp_path):
    six = np.hstack([POINTS, POINTS + 1])
    np.save(tmp_path / "a.npy", six)
    np.savez(tmp_path / "a.npz", points=six)
    for name in ("a.npy", "a.npz"):
        shape = read_shape(tmp_path / name)
        assert is_cloud(shape)
        count, action = notes(shape)["other columns"]
        assert count == 3 and "the coordinates are the first three" in action


def test_truth_values_are_no_coordinates(tmp_path):
    np.save(tmp_path / "a.npy", POINTS > 0)
    np.savez(tmp_path / "a.npz", points=POINTS > 0)
    for name in ("a.npy", "a.npz"):
        with pytest.raises(ShapeError, match="holds truth values"):
            read_shape(tmp_path / name)


def test_faces_as_columns_are_refused(tmp_path):
    """They would be read as three polygons."""
    faces = np.tile(FACES, (3, 1)).T
    np.savez(tmp_path / "a.npz", pos=POINTS, face=faces)
    with pytest.raises(ShapeError, match=r"faces has shape \(3, 9\), but must have shape \(n, 3\)"):
        read_shape(tmp_path / "a.npz")
    with pytest.raises(ShapeError, match=r"faces have shape \(3, 9\), but must have shape \(m, 3\)"):
        as_shape((POINTS, faces))


@pytest.mark.parametrize("face", [[0, 1, 0.5], [0, 1, np.nan]])
def test_npz_faces_that_are_no_indices_name_the_path(tmp_path, face):
    np.savez(tmp_path / "a.npz", points=POINTS, faces=np.array([face]))
    with pytest.raises(ShapeError) as caught:
        read_shape(tmp_path / "a.npz")
    assert str(caught.value).startswith(f"{tmp_path / 'a.npz'} could not be read as NPZ: faces hold {face[2]}")


def test_npz_with_quadrilaterals(tmp_path):
    np.savez(tmp_path / "a.npz", points=POINTS, faces=[[0, 1, 2, 3]])
    assert check(read_shape(tmp_path / "a.npz")).area == pytest.approx(1)


@pytest.mark.parametrize("kind", ["<f8", "<f2", ">f4", ">i2", "u1", "<u8"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_npz_numbers_of_any_type(tmp_path, kind, order):
    for faces in ([[0, 1, 2], [0, 1, 4]], [[0, 1, 2, 3]]):
        np.savez(tmp_path / "a.npz", points=np.asarray(POINTS, order=order), faces=np.array(faces, kind, order=order))
        shape = read_shape(tmp_path / "a.npz")
        np.testing.assert_array_equal(shape.points, POINTS)
        assert check(shape).area == pytest.approx(1)


def test_faces_that_count_from_one(tmp_path):
    np.savez(tmp_path / "a.npz", points=POINTS[:5], faces=FACES + 1)
    text = f"OFF\n5 3 0\n{rows(POINTS[:5])}{rows(FACES + 1, '3 {}')}"
    for path in (tmp_path / "a.npz", put(tmp_path, "a.off", text)):
        with pytest.raises(ShapeError, match="faces seem to count points from 1"):
            read_shape(path)


@pytest.mark.parametrize("space", ["RAS", "LPS"])
def test_axes_that_slicer_names(tmp_path, space):
    said = f"3D Slicer output. SPACE={space}"
    elements = f"element vertex 6\n{VERTEX}"
    content = ply("binary_little_endian", elements, POINTS.astype("<f4").tobytes(), f"comment {said}")
    vtk = f"# vtk DataFile Version 3.0\n{said}\nASCII\nDATASET POLYDATA\nPOINTS 6 double\n{rows(POINTS)}"
    obj = f"# {said}\n{rows(POINTS, 'v {}')}{rows(FACES + 1, 'f {}')}"
    paths = [put(tmp_path, "a.ply", content), put(tmp_path, "a.obj", obj), put(tmp_path, "a.vtk", vtk)]
    for path in (*paths, put(tmp_path, "a.stl", stl(3, title=said.encode()))):
        shape = read_shape(path)
        assert shape.space == space
        assert any(space in f.action for f in check(shape).findings)
    assert read_shape(put(tmp_path, "b.obj", obj.replace("SPACE", "space"))).space is None


def test_obj_keeps_marks_out_of_its_numbers(tmp_path):
    text = rows(POINTS, "V {} # a point") + "usemtl Material #1\n" + rows(FACES + 1, "f {} # of the front")
    np.testing.assert_array_equal(read_shape(put(tmp_path, "a.obj", text)).faces, FACES)


def test_obj_lines_and_free_forms_are_noted(tmp_path):
    text = rows(POINTS, "v {}") + rows(FACES + 1, "f {}")
    assert notes(read_shape(put(tmp_path, "a.obj", text))) == {}
    shape = read_shape(put(tmp_path, "a.obj", text + "l 1 2 3\nl 2 3\ncurv 0 1 1 2\nsurf 0 1 0 1 1 2 3 4\np 1\n"))
    np.testing.assert_array_equal(shape.faces, FACES)
    assert {rule: count for rule, (count, _) in notes(shape).items()} == {
        "lines": 2,
        "free-form curves and surfaces": 2,
    }


@pytest.mark.parametrize("gap", ["\\\n", "\\ \n", "\\\t \r\n", "\\ \n \\ \n"])
@pytest.mark.parametrize("before", [0, 2**20 - 26, 2**20 - 25, 2**20 - 24, 2**20 - 23])
def test_obj_lines_that_go_on(tmp_path, gap, before):
    """Also where a block of text ends within the end of a line."""
    text = "#" * before + "\nv 0 0 0\nv 1 0 0\nf 1 2 " + gap + "3\n# C:\\ \nv 0 1 0\n# C:\\\nv 0 0 1\n"
    shape = read_shape(put(tmp_path, "a.obj", text))
    np.testing.assert_array_equal(shape.points, [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    np.testing.assert_array_equal(shape.faces, [[0, 1, 2]])


def test_obj_faces_of_older_programs(tmp_path):
    text = rows(POINTS, "v {}") + rows(FACES + 1, "fo {}")
    np.testing.assert_array_equal(read_shape(put(tmp_path, "a.obj", text)).faces, FACES)


def test_stl_is_written_with_normals(tmp_path):
    write_shape(tmp_path / "a.stl", Shape(POINTS, [*FACES.tolist(), [0, 0, 1]]))
    facets = np.frombuffer((tmp_path / "a.stl").read_bytes(), STL_FACETS.dtype, offset=84)
    np.testing.assert_allclose(facets["n"], [[0, 0, 1], [0, 0, 1], [0, -1, 0], [0, 0, 0]])
