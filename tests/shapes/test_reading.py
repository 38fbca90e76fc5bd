"""Every point keeps its place in the file, whatever the format says besides."""

import base64
import json

import numpy as np
import pytest

from homolog.core.errors import ShapeError
from homolog.shapes import read_shape

POINTS = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [9, 9, 9]]  # the last one is in no face
QUAD_AND_TRIANGLE = [[0, 1, 2], [0, 2, 3], [0, 1, 4]]


def lines(rows, pattern="{}"):
    return "".join(pattern.format(" ".join(map(str, row))) + "\n" for row in rows)


def put(folder, name, content):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def assert_shape(shape, points=POINTS, faces=QUAD_AND_TRIANGLE):
    np.testing.assert_array_equal(shape.points, points)
    if faces is None:
        assert shape.faces is None
    else:
        np.testing.assert_array_equal(shape.faces, faces)


OFF_BODY = lines(POINTS) + "4 0 1 2 3\n3 0 1 4 255 0 0\n"


@pytest.mark.parametrize(
    "head",
    [
        "OFF\n6 2 0\n",
        "OFF 6 2 0\n",
        "OFF6 2 0\n",
        "OFF\n# by hand\n\n6 2 # counts\n",
        "COFF\n6 2 0\n",
        "NOFF\r\n6 2 0\r\n",
    ],
)
def test_off(tmp_path, head):
    assert_shape(read_shape(put(tmp_path, "a.OFF", head + OFF_BODY)))


def test_off_without_faces_is_a_cloud(tmp_path):
    assert_shape(read_shape(put(tmp_path, "a.off", "OFF\n6 0 0\n" + lines(POINTS))), faces=None)


OBJ_FACES = {
    "plain": "f 1 2 3 4\nf 1 2 5\n",
    "textured": "f 1/1 2/2 3/3 4/4\nf 1/3 2/1 5/2\n",
    "normals": "f 1//1 2//2 3//1 4//2\nf 1//2 2//1 5//1\n",
    "both": "f 1/1/2 2/2/1 3/3/2 4/4/1\nf 1/4/2 2/3/2 5/1/1\n",
    "backward": "f -6 -5 -4 -3\nf -6 -5 -2\n",
    "backward with all": "f -6/-4/-2 -5/-3/-1 -4/-2/-2 -3/-1/-1\nf -6/-4/-2 -5/-3/-1 -2/-1/-1\n",
    "grouped": "usemtl red\nf 1 2 3 4\no second\ng part\ns 1\nusemtl blue\nf 1 2 5 # a comment\n",
    "continued": "f 1 2 \\\n3 4\nf 1 2 5\n",
}


@pytest.mark.parametrize("faces", OBJ_FACES.values(), ids=OBJ_FACES)
def test_obj_seams_and_groups_never_split_or_reorder(tmp_path, faces):
    extra = "mtllib ../../outside.mtl\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\nvn 1 0 0\n"
    text = extra + lines(POINTS, "v {} 0.5 0.5 0.5") + faces
    assert_shape(read_shape(put(tmp_path, "a.obj", text)))


def test_obj_backward_indices_count_from_their_own_line(tmp_path):
    text = lines(POINTS[:4], "v {}") + "f -4 -3 -2 -1\n" + lines(POINTS[4:], "v {}") + "f 1 2 -2\n"
    assert_shape(read_shape(put(tmp_path, "a.obj", text)))


def test_obj_invalid_indices_are_kept_as_out_of_range(tmp_path):
    text = lines(POINTS, "v {}") + "f 1 2 3\nf 1 2 99\nf -99 1 2\n"
    faces = read_shape(put(tmp_path, "a.obj", text)).faces
    np.testing.assert_array_equal(faces, [[0, 1, 2], [0, 1, 98], [-1, 0, 1]])


@pytest.mark.parametrize("face", ["f 0 1 2", "f 3 2 0", "f 1/1 0/2 2/3", "f 1 2 3 0", "f -1 0 1"])
def test_obj_that_counts_from_zero_is_refused(tmp_path, face):
    text = lines(POINTS, "v {}") + f"f 1 2 3\n{face}\nf 1 2 3\n"
    with pytest.raises(ShapeError, match=rf"a\.obj could not be read as OBJ: the face '{face}' names point 0, but OBJ"):
        read_shape(put(tmp_path, "a.obj", text))


def ply(kind, faces, *, body, n=6, m=2):
    listing = f"element face {m}\nproperty uchar flag\nproperty list uchar {faces} vertex_indices\n" if faces else ""
    head = f"ply\nformat {kind} 1.0\ncomment TextureFile ../out.png\nelement vertex {n}\n"
    head += "property double x\nproperty float quality\nproperty double y\nproperty double z\n"
    return head.encode() + listing.encode() + b"element junk 0\nproperty int a\nend_header\n" + body


def ply_binary_body(order, polygons):
    vertex = np.zeros(6, [("x", order + "f8"), ("q", order + "f4"), ("y", order + "f8"), ("z", order + "f8")])
    vertex["x"], vertex["y"], vertex["z"] = np.array(POINTS).T
    faces = b"".join(bytes([7, len(p)]) + np.array(p, order + "i4").tobytes() for p in polygons)
    return vertex.tobytes() + faces


@pytest.mark.parametrize(("kind", "order"), [("binary_little_endian", "<"), ("binary_big_endian", ">")])
def test_ply_binary_with_mixed_polygons(tmp_path, kind, order):
    content = ply(kind, "int", body=ply_binary_body(order, [[0, 1, 2, 3], [0, 1, 4]]))
    assert_shape(read_shape(put(tmp_path, "a.ply", content)))


@pytest.mark.parametrize(("kind", "order"), [("binary_little_endian", "<"), ("binary_big_endian", ">")])
def test_ply_binary_with_triangles_alone(tmp_path, kind, order):
    content = ply(kind, "int", m=3, body=ply_binary_body(order, QUAD_AND_TRIANGLE))
    assert_shape(read_shape(put(tmp_path, "a.ply", content)))


def test_ply_text(tmp_path):
    rows = [[x, 0.5, y, z] for x, y, z in POINTS]
    content = ply("ascii", "uint", body=(lines(rows) + "7 4 0 1 2 3\n7 3 0 1 4\n").encode())
    assert_shape(read_shape(put(tmp_path, "a.ply", content)))
    assert_shape(read_shape(put(tmp_path, "b.ply", content.replace(b"\n", b"\r\n"))))


def test_ply_texture_coordinates_never_split_points(tmp_path):
    head = "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\nproperty float z\n"
    head += "element face 2\nproperty list uchar int vertex_index\n"
    head += "property list uchar float texcoord\nend_header\n"
    body = lines(POINTS) + "4 0 1 2 3 8 0 0 1 0 1 1 0 1\n3 0 1 4 6 0.3 0.1 0.2 0 0 1\n"
    assert_shape(read_shape(put(tmp_path, "a.ply", head + body)))


def test_ply_binary_with_other_lists_beside_the_corners(tmp_path):
    head = ply("binary_little_endian", "int", body=b"").replace(
        b"property list uchar int", b"property list ushort float texcoord\nproperty list uchar int"
    )
    faces = b""
    for polygon in ([0, 1, 2, 3], [0, 1, 4]):
        texture = np.zeros(2 * len(polygon), "<f4")
        faces += b"\7" + np.uint16(len(texture)).tobytes() + texture.tobytes()
        faces += bytes([len(polygon)]) + np.array(polygon, "<i4").tobytes()
    assert_shape(read_shape(put(tmp_path, "a.ply", head + ply_binary_body("<", []) + faces)))


def test_ply_without_faces_is_a_cloud(tmp_path):
    content = ply("binary_little_endian", None, body=ply_binary_body("<", []))
    assert_shape(read_shape(put(tmp_path, "a.ply", content)), faces=None)


TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
# As an STL numbers them: by first appearance.
CORNERS = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 1]], float)
WELDED = [[0, 1, 2], [0, 2, 3], [2, 1, 3], [0, 3, 1]]


def stl_text():
    facets = ""
    for face in np.array(POINTS, float)[[0, 1, 3, 4]][TETRAHEDRON]:
        facets += "facet normal 0 0 0\nouter loop\n" + lines(face, "vertex {}") + "endloop\nendfacet\n"
    return f"solid a name\n{facets}endsolid a name\n"


def stl_binary():
    facets = np.zeros(4, [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    facets["v"] = np.array(POINTS, float)[[0, 1, 3, 4]][TETRAHEDRON]
    return b"solid but binary".ljust(80) + np.uint32(4).tobytes() + facets.tobytes()


@pytest.mark.parametrize("content", [stl_text(), stl_binary()], ids=["text", "binary"])
def test_stl_is_welded(tmp_path, content):
    assert_shape(read_shape(put(tmp_path, "a.stl", content)), CORNERS, WELDED)


def gltf_tree(uri=None):
    """A quad placed by a parent that turns and a child that moves, and the triangle placed as it is."""
    turn = [0, 0, np.sqrt(0.5), np.sqrt(0.5)]
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 2]}],
        "nodes": [
            {"children": [1], "rotation": turn},
            {"mesh": 0, "translation": [1, 2, 3], "scale": [2, 2, 2]},
            {"mesh": 1},
        ],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]},
            {"primitives": [{"attributes": {"POSITION": 2}, "indices": 3}]},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 6, "type": "SCALAR"},
            {"bufferView": 2, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 3, "componentType": 5125, "count": 3, "type": "SCALAR"},
        ],
    }
    blocks = [
        np.array(POINTS[:4], "<f4").tobytes(),
        np.array([0, 1, 2, 0, 2, 3], "<u4").tobytes(),
        np.array(POINTS[3:], "<f4").tobytes(),
        np.array([2, 1, 0], "<u4").tobytes(),
    ]
    starts = np.cumsum([0, *map(len, blocks)]).tolist()
    tree["bufferViews"] = [
        {"buffer": 0, "byteOffset": s, "byteLength": len(b)} for s, b in zip(starts, blocks, strict=False)
    ]
    tree["buffers"] = [{"byteLength": starts[-1]}]
    if uri is not None:
        tree["buffers"][0]["uri"] = uri
    return tree, b"".join(blocks)


def glb(tree, data):
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = np.uint32(len(text)).tobytes() + b"JSON" + text + np.uint32(len(data)).tobytes() + b"BIN\0" + data
    return b"glTF" + np.array([2, 12 + len(chunks)], "<u4").tobytes() + chunks


def assert_scene(shape):
    quad = np.array(POINTS[:4], float) * 2 + [1, 2, 3]
    turned = np.stack([-quad[:, 1], quad[:, 0], quad[:, 2]], axis=1)
    parts = [(turned, [[0, 1, 2], [0, 2, 3]]), (np.array(POINTS[3:], float), [[2, 1, 0]])]
    # glTF leaves the order of the nodes to the reader, but not the order within a mesh.
    for order in (parts, parts[::-1]):
        if np.allclose(shape.points[: len(order[0][0])], order[0][0], atol=1e-6):
            np.testing.assert_allclose(shape.points, np.concatenate([p for p, _ in order]), atol=1e-6)
            faces = np.concatenate([order[0][1], np.add(order[1][1], len(order[0][0]))])
            np.testing.assert_array_equal(shape.faces, faces)
            return
    raise AssertionError(shape.points)


def test_glb_merges_the_scene_with_its_transforms(tmp_path):
    assert_scene(read_shape(put(tmp_path, "a.glb", glb(*gltf_tree()))))


def test_gltf_with_its_buffer_beside_or_inside(tmp_path):
    tree, data = gltf_tree("my%20data.bin")
    put(tmp_path, "my data.bin", data)
    assert_scene(read_shape(put(tmp_path, "a.gltf", json.dumps(tree))))
    tree, data = gltf_tree("data:application/octet-stream;base64," + base64.b64encode(gltf_tree()[1]).decode())
    assert_scene(read_shape(put(tmp_path, "b.gltf", json.dumps(tree))))


def test_vtk_legacy_text_with_polygons(tmp_path):
    head = "# vtk DataFile Version 3.0\nby hand\nASCII\nDATASET POLYDATA\nPOINTS 6 double\n"
    text = head + lines(POINTS) + "POLYGONS 2 9\n4 0 1 2 3\n3 0 1 4\n"
    shape = read_shape(put(tmp_path, "a.vtk", text))
    np.testing.assert_array_equal(shape.points, POINTS)
    # A quad may be split along either diagonal.
    assert sorted(map(tuple, np.sort(shape.faces)))[-1] in {(0, 2, 3), (1, 2, 3)}
    assert shape.n_faces == 3
    cloud = read_shape(put(tmp_path, "b.vtk", head + lines(POINTS)))
    assert_shape(cloud, faces=None)


def test_vtk_volume_gives_its_surface_over_all_points(tmp_path):
    text = "# vtk DataFile Version 3.0\ntetrahedra\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 6 double\n"
    text += lines([[9, 9, 9], [0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
    text += "CELLS 2 10\n4 1 2 3 4\n4 2 3 4 5\nCELL_TYPES 2\n10\n10\n"
    shape = read_shape(put(tmp_path, "a.vtk", text))
    assert shape.n_points == 6
    surface = {(1, 2, 3), (1, 2, 4), (1, 3, 4), (2, 3, 5), (2, 4, 5), (3, 4, 5)}
    assert set(map(tuple, np.sort(shape.faces))) == surface


TABLES = {
    "blanks": "0 0 0\n1 0 0\n 1  1 0 \n0 1 0\n0 0 1\n9 9 9\n",
    "commas": "0,0,0\n1,0,0\n1,1,0\n0,1,0\n0,0,1\n9,9,9\n",
    "semicolons": "0;0;0\n1;0;0\n1;1;0\n0;1;0\n0;0;1\n9;9;9\n",
    "tabs": "0\t0\t0\n1\t0\t0\n1\t1\t0\n0\t1\t0\n0\t0\t1\n9\t9\t9\n",
    "windows": "x,y,z\r\n0,0,0\r\n1,0,0\r\n1,1,0\r\n0,1,0\r\n0,0,1\r\n9,9,9\r\n",
    "byte order mark": "\ufeff0,0,0\n1,0,0\n1,1,0\n0,1,0\n0,0,1\n9,9,9\n",
    "comments": "# some points\n\n0 0 0\n1 0 0 # second\n1 1 0\n0 1 0\n\n0 0 1\n9 9 9\n",
    "named": "id,Z,label,X,Y\n1,0,a,0,0\n2,0,b,1,0\n3,0,c,1,1\n4,0,d,0,1\n5,1,e,0,0\n6,9,f,9,9\n",
    "named in a comment": "# z x y\n0 0 0\n0 1 0\n0 1 1\n0 0 1\n1 0 0\n9 9 9\n",
    "capitals and blanks": 'id, Z , "X" ,Y\n1,0,0,0\n2,0,1,0\n3,0,1,1\n4,0,0,1\n5,1,0,0\n6,9,9,9\n',
    "units": "id,x [mm],y (mm),z_mm\n1,0,0,0\n2,1,0,0\n3,1,1,0\n4,0,1,0\n5,0,0,1\n6,9,9,9\n",
    "units and blanks": "id x [mm] y [mm] z [mm]\n1 0 0 0\n2 1 0 0\n3 1 1 0\n4 0 1 0\n5 0 0 1\n6 9 9 9\n",
    "positions": "t,pos_x,Position.Y,z_coord\n1,0,0,0\n2,1,0,0\n3,1,1,0\n4,0,1,0\n5,0,0,1\n6,9,9,9\n",
    "paraview": '"v","Points:0","Points:1","Points:2"\n1,0,0,0\n2,1,0,0\n3,1,1,0\n4,0,1,0\n5,0,0,1\n6,9,9,9\n',
    "cloudcompare": "//X Y Z R\n0 0 0 1\n1 0 0 2\n1 1 0 3\n0 1 0 4\n0 0 1 5\n9 9 9 6\n",
    "bare names first": "pos_x,z,y,x\n1,0,0,0\n2,0,0,1\n3,0,1,1\n4,0,1,0\n5,1,0,0\n6,9,9,9\n",
    "velocities": "vx,x,vy,y,vz,z\n5,0,5,0,5,0\n5,1,5,0,5,0\n5,1,5,1,5,0\n5,0,5,1,5,0\n5,0,5,0,5,1\n5,9,5,9,5,9\n",
    "a blank header over commas": "id x y z\n1,0,0,0\n2,1,0,0\n3,1,1,0\n4,0,1,0\n5,0,0,1\n6,9,9,9\n",
    "columns: in a comment": "# columns: id, x, y, z\n1 0 0 0\n2 1 0 0\n3 1 1 0\n4 0 1 0\n5 0 0 1\n6 9 9 9\n",
    "part in a comment": "# id x y z\n1,0,0,0,a\n2,1,0,0,a\n3,1,1,0,a\n4,0,1,0,a\n5,0,0,1,a\n6,9,9,9,a\n",
    "a remark": "# x and y and z in metres, of 2019\n0 0 0 1\n1 0 0 2\n1 1 0 3\n0 1 0 4\n0 0 1 5\n9 9 9 6\n",
    "a remark with numbers": "# 6 points of 2019\n0 0 0 1\n1 0 0 2\n1 1 0 3\n0 1 0 4\n0 0 1 5\n9 9 9 6\n",
    "other names": "a,b,c\n0,0,0\n1,0,0\n1,1,0\n0,1,0\n0,0,1\n9,9,9\n",
    "quoted": '"x","y","z"\n"0","0","0"\n1,0,0\n1,1,0\n0,1,0\n0,0,1\n9,9,9\n',
    "more columns": "0 0 0 7 red\n1 0 0 7 red\n1 1 0 7 red\n0 1 0 7 red\n0 0 1 7 red\n9 9 9 7 red\n",
}


@pytest.mark.parametrize("suffix", [".csv", ".txt", ".XYZ"])
@pytest.mark.parametrize("text", TABLES.values(), ids=TABLES)
def test_tables(tmp_path, suffix, text):
    assert_shape(read_shape(put(tmp_path, "a" + suffix, text)), faces=None)


def test_tables_keep_nan_and_infinity_in_place(tmp_path):
    shape = read_shape(put(tmp_path, "a.csv", "0,0,0\nnan,0,0\n1,0,0\n0,inf,0\n1,1,0\n1,1,1\n"))
    assert shape.n_points == 6
    np.testing.assert_array_equal(np.isfinite(shape.points).all(axis=1), [True, False, True, False, True, True])


@pytest.mark.parametrize("dtype", ["f4", ">f8", "i2", "u1"])
def test_npy_of_any_real_type_and_order(tmp_path, dtype):
    np.save(tmp_path / "a.npy", np.asfortranarray(np.array(POINTS, dtype)))
    assert_shape(read_shape(tmp_path / "a.npy"), faces=None)


@pytest.mark.parametrize("key", ["points", "vertices"])
def test_npz_keys(tmp_path, key):
    np.savez(tmp_path / "a.npz", **{key: np.array(POINTS), "faces": np.array(QUAD_AND_TRIANGLE, "u4"), "other": 1})
    assert_shape(read_shape(tmp_path / "a.npz"))
    np.savez(tmp_path / "b.npz", **{key: np.array(POINTS, float)})
    assert_shape(read_shape(tmp_path / "b.npz"), faces=None)


def test_pcd_text(tmp_path):
    head = "# .PCD v0.7\nVERSION 0.7\nFIELDS i x y z\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n"
    head += "WIDTH 6\nHEIGHT 1\n"
    text = head + "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 6\nDATA ascii\n" + lines([[5, *p] for p in POINTS])
    assert_shape(read_shape(put(tmp_path, "a.pcd", text)), faces=None)


def test_home_folder_and_names(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    put(tmp_path, "a.xyz", TABLES["blanks"])
    assert read_shape("~/a.xyz").name == "a.xyz"
