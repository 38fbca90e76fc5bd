"""Whatever a file holds, reading it gives a shape or one clear line: no noise, no huge allocation."""

import base64
import bz2
import gzip
import io
import json
import logging
import lzma
import os
import pickle
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from homolog.core.errors import MissingExtraError, ShapeError
from homolog.shapes import Shape, read_shape, readable_suffixes, register_format, writable_suffixes, write_shape
from homolog.shapes.formats import registry

MESH = Shape(
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]],
    [[0, 1, 2], [0, 1, 3], [1, 2, 4], [2, 3, 4], [0, 2, 3], [1, 3, 4]],
)
MESH_FORMATS = [s for s in writable_suffixes() if s not in (".xyz", ".txt", ".csv", ".npy", ".pcd")]
BILLION = 10**9


def refused(path, *words):
    """The one line that refuses a file, which must hold all the words."""
    with pytest.raises(ShapeError) as caught:
        read_shape(path)
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 400 + 2 * len(str(path))
    assert path.name in message
    assert "ShapeError" not in message
    for word in words:
        assert word in message, message
    return message


def put(folder, name, content):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def zipped(content):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a", content)
    return stream.getvalue()


@pytest.fixture(autouse=True)
def no_noise(capfd, caplog):
    """Nothing may be printed or logged beside the error."""
    with caplog.at_level(logging.WARNING):
        yield
    out, err = capfd.readouterr()
    assert (out, err, caplog.records) == ("", "", [])


@pytest.fixture
def little_memory():
    """Let an allocation of gigabytes fail, so that a reader that trusts a header is found out."""
    resource = pytest.importorskip("resource")
    statm = Path("/proc/self/statm")
    if not statm.exists():
        pytest.skip("the memory in use cannot be told here")
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    used = int(statm.read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + 1_500_000_000, hard))
    yield
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def test_missing_folder_and_unknown(tmp_path):
    refused(tmp_path / "none.ply", "does not exist")
    (tmp_path / "folder.ply").mkdir()
    refused(tmp_path / "folder.ply", "folder")
    message = refused(put(tmp_path, "a.docx", "x"), "'.docx'")
    assert all(suffix in message for suffix in readable_suffixes())
    refused(put(tmp_path, "ply", "x"), "no suffix")
    (tmp_path / "scans").mkdir()
    refused(tmp_path / "scans", "scans is a folder")
    refused(tmp_path / "nowhere", "does not exist")
    refused(tmp_path / ("long" * 100 + ".ply"))


def test_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.ply")
    refused(tmp_path / "pipe.ply", "not an ordinary file")


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may read everything")
def test_forbidden(tmp_path):
    put(tmp_path, "a.ply", "x").chmod(0)
    refused(tmp_path / "a.ply", "Permission denied")


@pytest.mark.parametrize("suffix", readable_suffixes())
def test_empty(tmp_path, suffix):
    refused(put(tmp_path, "a" + suffix, b""), "is empty")


RUBBISH = {
    "zeros": bytes(500),
    "binary": np.random.default_rng(0).bytes(4000),
    "words": b"the quick brown fox\njumps over the lazy dog\n" * 9,
    "blank lines": b"\n \n\n",
    "one line": b"x",
    "comment": b"# nothing\n",
    "json": b"[" * 100_000,
    "latin": "naïve café\n".encode("latin-1") * 9,
}


@pytest.mark.parametrize("suffix", readable_suffixes())
@pytest.mark.parametrize("content", RUBBISH.values(), ids=RUBBISH)
def test_rubbish(tmp_path, suffix, content):
    refused(put(tmp_path, "a" + suffix, content), suffix[1:].upper())


@pytest.mark.parametrize("suffix", readable_suffixes())
@pytest.mark.parametrize("start", [b"ply\n", b"OFF\n", b"glTF", b"solid\n", b"# vtk DataFile Version 3.0\n", b"PK\3\4"])
def test_rubbish_after_the_right_start(tmp_path, suffix, start):
    refused(put(tmp_path, "a" + suffix, start + RUBBISH["binary"]))
    refused(put(tmp_path, "b" + suffix, start + RUBBISH["words"]))


@pytest.mark.parametrize("share", [0.05, 0.3, 0.6, 0.9])
@pytest.mark.parametrize("suffix", [s for s in MESH_FORMATS if s != ".obj"])
def test_cut_off_mesh(tmp_path, suffix, share):
    write_shape(tmp_path / f"whole{suffix}", MESH)
    content = (tmp_path / f"whole{suffix}").read_bytes()
    refused(put(tmp_path, "a" + suffix, content[: int(share * len(content))]))


@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
@pytest.mark.parametrize("suffix", [".ply", ".npy", ".npz", ".pcd", ".glb", ".vtk", ".vtp", ".vtu", ".off"])
def test_cut_off_cloud(tmp_path, suffix, share):
    write_shape(tmp_path / f"whole{suffix}", MESH.as_cloud())
    content = (tmp_path / f"whole{suffix}").read_bytes()
    refused(put(tmp_path, "a" + suffix, content[: int(share * len(content))]))


def test_cut_off_within_a_line(tmp_path):
    whole = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n"
    refused(put(tmp_path, "a.obj", whole[:-3]), "'f 1 2'", "fewer than three corners")
    refused(put(tmp_path, "b.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv 2 3"), "'v 2 3'")
    refused(put(tmp_path, "c.csv", "0,0,0\n1,0,0\n0,1,0\n0,0,1\n2,3"), "'2,3'")
    facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    refused(put(tmp_path, "d.stl", "solid\n" + 3 * facet + facet[:-40]), "cut off")
    refused(put(tmp_path, "e.stl", "solid\n" + 3 * facet + facet[:-9]), "cut off")


def facets(*sizes):
    """Text of facets with so many vertices."""
    vertices = ["vertex 0 0 0\n", "vertex 1 0 0\n", "vertex 1 1 0\n", "vertex 0 1 0\n"]
    bodies = ["".join(vertices[:size]) for size in sizes]
    return "solid\n" + "".join(f"facet normal 0 0 1\nouter loop\n{body}endloop\nendfacet\n" for body in bodies)


@pytest.mark.parametrize(
    ("sizes", "which", "found"),
    [([4], 1, 4), ([3, 4, 4, 4], 2, 4), ([3, 4, 2], 2, 4), ([2, 4], 1, 2), ([3] * 5000 + [0, 3], 5001, 0)],
)
def test_facets_that_are_no_triangles(tmp_path, sizes, which, found):
    refused(put(tmp_path, "a.stl", facets(*sizes)), f"its facet {which} has {found} vertices", "must have three")


def test_links_that_lead_nowhere(tmp_path):
    (tmp_path / "loop.ply").symlink_to(tmp_path / "loop.ply")
    refused(tmp_path / "loop.ply", "is a link that leads to itself")
    (tmp_path / "gone.ply").symlink_to(tmp_path / "none.ply")
    refused(tmp_path / "gone.ply", "is a link to nothing")
    put(tmp_path, "file.ply", "x")
    refused(tmp_path / "file.ply" / "a.ply", "does not exist")


HUGE = 10**23


@pytest.mark.parametrize(
    ("name", "content"),
    {
        "a.obj": f"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 {HUGE}\n",
        "b.obj": f"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1/1 2/2 -{HUGE}/3\n",
        "a.off": f"OFF\n{HUGE} 1 0\n0 0 0\n",
        "b.off": f"OFF\n4 1 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 {HUGE}\n",
        "c.off": f"OFF\n4 1 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 {'9' * 5000}\n",
    }.items(),
)
def test_whole_numbers_that_are_too_large(tmp_path, name, content):
    message = refused(put(tmp_path, name, content), "holds a number that is too large, of more than 64 bits")
    assert "should hold whole numbers" not in message


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("x,y,z\n1,2,3\n" + '"1,000","2,000",3\n', '"1,000","2,000",3'),
        ("1 2 3\n4 5 6\n7 8 1_0\n", "7 8 1_0"),
        ("1 2 3\n" * 20_000 + "4 5 0x1\n", "4 5 0x1"),
    ],
)
def test_a_line_that_holds_no_numbers_is_quoted(tmp_path, text, line):
    refused(put(tmp_path, "a.csv", text), f"the line {line!r} should hold numbers")


COMPRESSIONS = {"gzip": gzip.compress, "bzip2": bz2.compress, "xz": lzma.compress, "zip": zipped}


@pytest.mark.parametrize("suffix", readable_suffixes())
@pytest.mark.parametrize("kind", COMPRESSIONS)
def test_compressed_files_are_told(tmp_path, suffix, kind):
    if suffix not in writable_suffixes() or (suffix, kind) == (".npz", "zip"):
        pytest.skip("there is none")
    shape = MESH if suffix in MESH_FORMATS else MESH.as_cloud()
    write_shape(tmp_path / f"whole{suffix}", shape)
    content = COMPRESSIONS[kind]((tmp_path / f"whole{suffix}").read_bytes())
    refused(put(tmp_path, "a" + suffix, content), f"it is compressed ({kind}); unpack it first")


def test_a_format_of_ones_own_may_be_compressed(tmp_path, monkeypatch):
    def read(path):
        raise ValueError("its reader says why")

    monkeypatch.setattr(registry, "_FORMATS", dict(registry._FORMATS))
    register_format(".tri", read=read)
    refused(put(tmp_path, "a.tri", gzip.compress(b"x")), "its reader says why")


def ply_head(kind, points, faces, faces_type="int"):
    head = f"ply\nformat {kind} 1.0\nelement vertex {points}\n"
    head += "property float x\nproperty float y\nproperty float z\n"
    return (head + f"element face {faces}\nproperty list {faces_type} int vertex_indices\nend_header\n").encode()


FOUR = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "<f4").tobytes()
FOUR_LINES = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
PCD = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {n}\nHEIGHT 1\n"
PCD += "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA {kind}\n"
VTK = "# vtk DataFile Version 3.0\nx\n{kind}\nDATASET POLYDATA\n"
VTP = """<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian"><PolyData>
<Piece NumberOfPoints="{n}" NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="0"
NumberOfPolys="{m}"><Points>
<DataArray type="Float32" NumberOfComponents="3" format="ascii">0 0 0 1 0 0 0 1 0 0 0 1</DataArray>
</Points></Piece></PolyData></VTKFile>"""


def npy_head(shape, dtype="<f8"):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": dtype, "fortran_order": False, "shape": shape})
    return stream.getvalue()


def gltf(count=4, placed=1, indices=None, uri=None):
    buffer = {"byteLength": 48} | ({"uri": uri} if uri else {})
    accessor = {"componentType": 5126, "count": count, "type": "VEC3"}
    primitive = {"attributes": {"POSITION": 0}, "mode": 0}
    return {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": list(range(placed))}],
        "nodes": [{"mesh": 0}] * placed,
        "meshes": [{"primitives": [primitive]}],
        "accessors": [accessor if uri is None else accessor | {"bufferView": 0}],
        "bufferViews": [{"buffer": 0, "byteLength": 48}] if uri else [],
        "buffers": [buffer] if uri else [],
    }


def glb(tree):
    text = json.dumps(tree).encode()
    return b"glTF" + np.array([2, 20 + len(text)], "<u4").tobytes() + np.uint32(len(text)).tobytes() + b"JSON" + text


BOLD_CLAIMS = {
    "points.off": f"OFF\n{BILLION} 1 0\n{FOUR_LINES}",
    "faces.off": f"OFF\n4 {BILLION} 0\n{FOUR_LINES}3 0 1 2\n",
    "corners.off": f"OFF\n4 1 0\n{FOUR_LINES}{BILLION} 0 1 2\n",
    "negative.off": f"OFF\n-4 1 0\n{FOUR_LINES}",
    "huge.off": f"OFF\n{10**30} 1 0\n{FOUR_LINES}",
    "points_text.ply": ply_head("ascii", BILLION, 0) + FOUR_LINES.encode(),
    "points.ply": ply_head("binary_little_endian", BILLION, 0) + FOUR,
    "more_points.ply": ply_head("binary_little_endian", 40, 0) + FOUR,
    "faces.ply": ply_head("binary_little_endian", 4, BILLION) + FOUR,
    "corners.ply": ply_head("binary_little_endian", 4, 1) + FOUR + np.int32(BILLION).tobytes() + FOUR,
    "negative_corners.ply": ply_head("binary_little_endian", 4, 1) + FOUR + np.int32(-1).tobytes() + FOUR,
    "corners_text.ply": ply_head("ascii", 4, 1) + f"{FOUR_LINES}{BILLION} 0 1 2\n".encode(),
    "facets.stl": b" " * 80 + np.uint32(BILLION).tobytes() + bytes(100),
    "points.npy": npy_head((BILLION, 3)) + FOUR,
    "shape.npy": npy_head((2**62, 2**62)) + FOUR,
    "points_text.pcd": PCD.format(n=BILLION, kind="ascii") + FOUR_LINES,
    "points.pcd": PCD.format(n=BILLION, kind="binary").encode() + FOUR,
    "compressed.pcd": PCD.format(n=BILLION, kind="binary_compressed").encode() + FOUR,
    "sizes.pcd": PCD.format(n=4, kind="binary_compressed").encode() + np.array([48, 4 * BILLION], "<u4").tobytes(),
    "points_text.vtk": VTK.format(kind="ASCII") + f"POINTS {BILLION} float\n{FOUR_LINES}",
    "points.vtk": (VTK.format(kind="BINARY") + f"POINTS {BILLION} float\n").encode() + FOUR,
    "faces.vtk": VTK.format(kind="ASCII") + f"POINTS 4 float\n{FOUR_LINES}POLYGONS {BILLION} {4 * BILLION}\n3 0 1 2\n",
    "points.vtp": VTP.format(n=BILLION, m=0),
    "faces.vtp": VTP.format(n=4, m=BILLION),
    "count.glb": glb(gltf(count=BILLION)),
    "count.gltf": json.dumps(gltf(count=BILLION)),
    "buffer.gltf": json.dumps(gltf() | {"buffers": [{"byteLength": BILLION, "uri": "data:x;base64,AAAA"}]}),
    "length.glb": glb(gltf())[:8] + np.uint32(4 * BILLION).tobytes() + glb(gltf())[12:],
}


@pytest.mark.parametrize("name", BOLD_CLAIMS)
def test_header_that_claims_too_much(tmp_path, name, little_memory):
    message = refused(put(tmp_path, name, BOLD_CLAIMS[name]))
    assert "memory" not in message


def test_scene_that_places_a_mesh_too_often(tmp_path, little_memory):
    tree = gltf(count=30_000, placed=10_000)
    refused(put(tmp_path, "a.gltf", json.dumps(tree)), "300000000 points")


def test_scene_that_places_a_mesh_often_is_read_up_to_the_bound(tmp_path, monkeypatch):
    content = base64.b64encode(np.random.default_rng(0).random((40, 3)).astype("<f4").tobytes()).decode()
    tree = gltf(count=40, placed=500, uri=f"data:;base64,{content}")
    tree["buffers"][0]["byteLength"] = tree["bufferViews"][0]["byteLength"] = 480
    assert read_shape(put(tmp_path, "a.gltf", json.dumps(tree))).n_points == 20_000
    monkeypatch.setenv("HOMOLOG_EXPANSION_MB", "1")
    refused(tmp_path / "a.gltf", "20000 points", "HOMOLOG_EXPANSION_MB")


def test_compressed_vtk_that_would_fill_the_memory(tmp_path, little_memory):
    for suffix in (".vtp", ".vtu"):
        write_shape(tmp_path / f"whole{suffix}", MESH)
        content = (tmp_path / f"whole{suffix}").read_bytes()
        promised = content.replace(b'NumberOfPoints="5"', b'NumberOfPoints="%d"' % (BILLION // 10))
        assert promised != content
        refused(put(tmp_path, "a" + suffix, promised), "HOMOLOG_EXPANSION_MB")


def test_blanks_cost_no_more_than_their_number(tmp_path):
    """Regular expressions that look at each blank from each blank before it would take minutes."""
    blanks = " " * 120_000
    refused(put(tmp_path, "a.csv", f"x{blanks}y,b,c,d\n" + "1,2,3,4\n" * 9))
    refused(put(tmp_path, "b.csv", "x [" * 60_000 + "\n" + "1,2,3,4\n" * 9))
    refused(put(tmp_path, "c.csv", f"x;y;z\n3;1;{blanks}\n" + "1;2;3\n" * 9))
    refused(put(tmp_path, "d.csv", f"x;y;z\n3;1;{blanks}NA{blanks}x\n" + "1;2;3\n" * 9))
    refused(put(tmp_path, "a.pcd", f"SIZE{blanks[:90_000]}x\nPOINTS 1\nDATA binary\n"), "no header")
    refused(put(tmp_path, "b.pcd", f"SIZE 4{blanks[:90_000]}x\nPOINTS 1\nDATA binary\n"), "no header")
    refused(put(tmp_path, "a.ply", b"ply " + b"\n" * 200_000 + b"end_heade"), "no header")
    refused(put(tmp_path, "a.vtk", f"# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\n{blanks}x 1 1 x" * 3))
    refused(put(tmp_path, "a.vtp", '<VTKFile type="PolyData">' + f"NumberOfPoints{blanks}=" * 3 + "</VTKFile>"))
    refused(put(tmp_path, "a.obj", FOUR_LINES.replace("0 ", "v 0 ", 1) + "f " + "/" * 500_000 + "\n"))


@pytest.mark.parametrize("kind", ["ascii", "binary", "binary_compressed"])
@pytest.mark.parametrize("n_points", [0, 1, 4])
def test_pcd_points_of_billions_of_values(tmp_path, kind, n_points, little_memory):
    head = PCD.format(n=n_points, kind=kind).replace("COUNT 1 1 1", f"COUNT 1 1 {4 * BILLION}")
    refused(put(tmp_path, "a.pcd", head.encode() + np.array([48, 48], "<u4").tobytes() + FOUR), "announces")


def test_counts_of_billions_of_digits(tmp_path):
    """Python refuses to read numbers of so many digits in its own words."""
    digits = "9" * 5000
    refused(put(tmp_path, "a.pcd", PCD.format(n=digits, kind="ascii") + FOUR_LINES), "announces")
    refused(put(tmp_path, "a.vtk", VTK.format(kind="ASCII") + f"POINTS {digits} float\n{FOUR_LINES}"), "announces")
    refused(put(tmp_path, "a.vtp", VTP.format(n=digits, m=0)))
    refused(put(tmp_path, "a.off", f"OFF\n{digits} 1 0\n{FOUR_LINES}"))
    refused(put(tmp_path, "a.ply", ply_head("ascii", digits, 0) + FOUR_LINES.encode()))
    refused(put(tmp_path, "a.xyz", f"{digits}\n{FOUR_LINES}"))
    refused(put(tmp_path, "a.gltf", json.dumps(gltf()).replace('"count": 4', f'"count": {digits}')))


def test_a_name_with_a_tilde_is_no_home_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_shape(tmp_path / "~x.ply", MESH)
    assert read_shape("~x.ply").n_points == MESH.n_points


def test_names_with_line_breaks_stay_on_one_line(tmp_path):
    path = put(tmp_path, "a\nb\x1b[31m.off", "OFF\n1 0 0\n")
    with pytest.raises(ShapeError, match=r"a\\nb\\x1b\[31m.off") as caught:
        read_shape(path)
    assert str(caught.value).isprintable()


def test_archive_that_would_fill_the_memory(tmp_path, little_memory):
    with (
        zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("points.npy", "w") as file,
    ):
        file.write(npy_head((16_000_000, 3)))
        for _ in range(48):
            file.write(bytes(8_000_000))
    refused(tmp_path / "a.npz", "points.npy", "HOMOLOG_EXPANSION_MB")


def test_points_as_columns_are_refused(tmp_path):
    np.save(tmp_path / "lying.npy", np.random.default_rng(0).random((3, 50)))
    refused(tmp_path / "lying.npy", "shape (3, 50)", "must have shape (n, 3)")


class Bomb:
    def __reduce__(self):
        return os.system, ("echo exploded",)


def test_no_code_in_arrays_runs(tmp_path):
    objects = np.array([[Bomb(), 0, 0]] * 4, dtype=object)
    np.save(tmp_path / "a.npy", objects, allow_pickle=True)
    refused(tmp_path / "a.npy", "object")
    np.savez(tmp_path / "a.npz", points=objects)
    refused(
        tmp_path / "a.npz", "points.npy holds values of type object, but real numbers are needed; save it as numbers"
    )
    refused(put(tmp_path, "b.npy", pickle.dumps(Bomb())))
    refused(put(tmp_path, "b.npz", pickle.dumps(Bomb())))


def test_arrays_of_the_wrong_kind(tmp_path):
    def npy(array):
        np.save(tmp_path / "a.npy", array)
        return tmp_path / "a.npy"

    def npz(**arrays):
        np.savez(tmp_path / "a.npz", **arrays)
        return tmp_path / "a.npz"

    points = np.eye(5, 3)
    refused(npy(points + 1j), "complex128")
    refused(npy(np.array([["a", "b", "c"]] * 4)), "<U1")
    refused(npy(np.zeros(4, [("x", "f4"), ("y", "f4")])))
    refused(npy(points.ravel()), "(15,)")
    refused(npy(points[:, :2]), "(5, 2)")
    refused(npy(np.zeros((3, 3))), "3 usable points")
    refused(npz(cloud=points, weight=points), "cloud, weight", "named one of points, vertices")
    refused(npz(points=points, faces=points + 0.5), "whole numbers")
    refused(npz(points=points, faces=np.zeros((2, 2), int)), "faces has shape (2, 2)")
    refused(npz(points=points, faces=np.array(1)), "faces has shape ()")
    refused(npz(points=points, faces=np.arange(9)), "faces has shape (9,)")
    refused(npz(points=points, faces=np.arange(12).reshape(4, 3) % 5 > 2), "truth values")
    refused(npz(points=points, faces=np.arange(4) + 0.5), "faces has shape (4,)")
    refused(npz(points=points, faces=np.array([[0, 1, 2, 3.5]])), "faces has shape (1, 4)")
    refused(npz(points=points, faces=np.array([[0, 1, 2, np.inf]])), "faces has shape (1, 4)")
    refused(npz(points=points, faces=np.array([[0, 1, 2]]).astype("M8[s]")), "datetime64[s]")
    refused(npz(points=points.reshape((5, 3) + (1,) * 40)), "points has shape (5, 3, 1, 1")
    refused(npy(np.zeros(4, [("x" * 300, "f4")])), "values of type [('xxx")


@pytest.mark.parametrize("suffix", [".csv", ".xyz", ".txt"])
def test_tables_with_cells_that_are_no_numbers(tmp_path, suffix):
    refused(put(tmp_path, "a" + suffix, "0 0 0\n1 0 0\n0 1 oops\n0 0 1\n1 1 1\n"), "'0 1 oops'")
    refused(put(tmp_path, "b" + suffix, "x,y,z\n0,0,0\n1,0,0\n0,,1\n0,0,1\n1,1,1\n"), "'0,,1'")
    refused(put(tmp_path, "c" + suffix, "0 0\n1 0\n0 1\n1 1\n"), "'0 0'", "2 values")
    refused(put(tmp_path, "d" + suffix, "1.000,5;0,0;1,0\n" * 4), "numbers")
    refused(put(tmp_path, "e" + suffix, "x,y,z\n"), "0 usable points")


@pytest.mark.parametrize(
    ("header", "named"),
    [
        ("id,lat,lon,height", "id, lat, lon, height"),
        ("id,x,y,height", "id, x, y, height"),
        ("x,y,z,x,y,z", "x, y, z, x, y, z"),
        ("pos_x,x [mm],y,z", "pos_x, x[mm], y, z"),
        ("label,nx,ny,nz", "label, nx, ny, nz"),
        ("# id;lat;lon;height", "id, lat, lon, height"),
        ("# fields: a b c d", "a, b, c, d"),
    ],
)
@pytest.mark.parametrize("suffix", [".csv", ".xyz", ".txt"])
def test_tables_whose_coordinates_cannot_be_told(tmp_path, suffix, header, named):
    numbers = np.random.default_rng(0).random((9, named.count(",") + 1))
    rows = [",".join(map(str, row)) for row in numbers.tolist()]
    refused(put(tmp_path, "a" + suffix, "\n".join([header, *rows])), f"its columns are named {named};", "x, y, z")


def test_too_few_or_equal_points(tmp_path):
    refused(put(tmp_path, "a.xyz", "0 0 0\n1 0 0\n0 1 0\n"), "3 usable points", "4")
    refused(put(tmp_path, "b.xyz", "0 0 0\n1 0 0\n0 1 0\nnan 0 0\n"), "3 usable points")
    refused(put(tmp_path, "c.xyz", "1 2 3\n" * 9), "equal")
    refused(put(tmp_path, "d.off", "OFF\n4 1 0\n" + FOUR_LINES + "3 0 1 4\n"), "none of its faces")


def test_sizes_inside_compressed_data_do_no_harm(tmp_path):
    """VTK trusts them, and ends the process that it runs in."""
    write_shape(tmp_path / "a.vtp", MESH)
    content = (tmp_path / "a.vtp").read_bytes()
    start = content.index(b"_", content.index(b"<AppendedData")) + 1
    blocks = base64.b64encode(np.array([2**31 - 1, 2**31 - 1, 2**31 - 1, 9], "<u4").tobytes()[:15])
    refused(put(tmp_path, "b.vtp", content[:start] + blocks + content[start + len(blocks) :]))


def test_vtk_cells_beyond_the_points(tmp_path):
    text = VTK.format(kind="ASCII") + f"POINTS 4 float\n{FOUR_LINES}POLYGONS 1 4\n3 0 1 987654321\n"
    refused(put(tmp_path, "a.vtk", text), "points that it does not hold")


def test_references_outside_the_folder_are_refused(tmp_path):
    inside = tmp_path / "inside"
    inside.mkdir()
    put(tmp_path, "secret.bin", FOUR)
    (inside / "link.bin").symlink_to(tmp_path / "secret.bin")
    for uri in ["../secret.bin", str(tmp_path / "secret.bin"), "link.bin", "%2e%2e/secret.bin"]:
        refused(put(inside, "a.gltf", json.dumps(gltf(uri=uri))), "outside its own folder")
    refused(put(inside, "b.gltf", json.dumps(gltf(uri="http://localhost/x.bin"))), "outside its own folder")
    refused(put(inside, "c.gltf", json.dumps(gltf(uri="none.bin"))), "not beside it")


def test_wrong_kinds_within_a_format(tmp_path):
    refused(
        put(tmp_path, "a.vtk", "# vtk DataFile Version 3.0\nx\nASCII\nDATASET STRUCTURED_POINTS\n"),
        "STRUCTURED_POINTS",
    )
    draco = gltf() | {"extensionsRequired": ["KHR_draco_mesh_compression"]}
    refused(put(tmp_path, "b.glb", glb(draco)), "KHR_draco_mesh_compression", "without compression")
    strips = ply_head("ascii", 4, 0).replace(b"element face", b"element tristrips") + FOUR_LINES.encode()
    refused(put(tmp_path, "c.ply", strips), "triangle strips")
    refused(
        put(tmp_path, "d.ply", ply_head("ascii", 4, 0).replace(b" z", b" w") + FOUR_LINES.encode()),
        "property z",
    )
    refused(put(tmp_path, "e.obj", "f 1 2 3\n"), "no points")
    refused(put(tmp_path, "f.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 x\n"), "whole numbers")
    refused(
        put(tmp_path, "g.pcd", PCD.format(n=4, kind="ascii").replace("x y z", "x y w") + FOUR_LINES),
        "field z",
    )


def test_memory_and_depth_become_one_line(tmp_path, monkeypatch):
    for error in (MemoryError(), RecursionError("too\ndeep")):

        def fail(path, error=error):
            raise error

        monkeypatch.setattr(registry, "_FORMATS", dict(registry._FORMATS))
        register_format(".ply", read=fail)
        refused(put(tmp_path, "a.ply", "x"), "could not be read as PLY")


@pytest.mark.parametrize(
    ("suffix", "module", "package", "extra"),
    [(".pcd", "pypcd4", "pypcd4", "pcd"), (".vtp", "vtkmodules", "vtk", "vtk")],
)
def test_missing_package_names_its_extra(tmp_path, monkeypatch, suffix, module, package, extra):
    write_shape(tmp_path / f"a{suffix}", MESH.as_cloud())
    for name in [name for name in sys.modules if name.split(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=rf"the package {package}, .*homolog\[{extra}\]"):
        read_shape(tmp_path / f"a{suffix}")
    with pytest.raises(MissingExtraError, match=rf"the package {package}, .*homolog\[{extra}\]"):
        write_shape(tmp_path / f"b{suffix}", MESH.as_cloud())
    assert not (tmp_path / f"b{suffix}").exists()


@pytest.mark.process
@pytest.mark.parametrize("suffix", [".vtk", ".vtp", ".ply", ".glb", ".stl"])
def test_nothing_on_stderr_of_a_fresh_process(tmp_path, suffix):
    """Some libraries set up their logging when they are first imported."""
    path = put(tmp_path, "a" + suffix, RUBBISH["words"])
    code = "import sys\nfrom homolog.shapes import read_shape\nfrom homolog.core.errors import ShapeError\n"
    code += "try:\n    read_shape(sys.argv[1])\nexcept ShapeError:\n    print('refused')\n"
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr, done.returncode) == ("refused\n", "", 0)


def test_cells_that_are_too_long(tmp_path):
    said = "is no row of a table (it has a cell of more than 131072 characters); correct or remove it"
    refused(put(tmp_path, "a.csv", "name,x,y,z\n" + "a" * 200_000 + ",1,2,3\n" + "b,1,2,3\n" * 9), said)
