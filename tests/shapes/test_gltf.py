"""glTF as its specification has it: accessors, primitives, scenes, instances, morph targets and skins."""

import base64
import json
from urllib.parse import quote

import numpy as np
import pytest

from homolog.core.errors import ArgumentError, ShapeError
from homolog.shapes import check, files_of_shape, read_shape, write_shape

POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1]], "<f4")
FACES = np.array([[0, 1, 2], [0, 2, 3], [0, 1, 4]], "<u2")
CODES = {"<i1": 5120, "|i1": 5120, "|u1": 5121, "<i2": 5122, "<u2": 5123, "<u4": 5125, "<f4": 5126}
TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class File:
    """A glTF that is put together array by array."""

    def __init__(self):
        self.buffer = b""
        self.tree = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": []}
        self.tree |= {"meshes": [{"primitives": []}], "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}], "scene": 0}

    def view(self, array, **more):
        self.buffer += bytes(-len(self.buffer) % 4)
        entry = {"buffer": 0, "byteOffset": len(self.buffer), "byteLength": array.nbytes}
        self.buffer += array.tobytes()
        self.tree["bufferViews"].append(entry | more)
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, array, **more):
        array = np.asarray(array)
        width = 1 if array.ndim == 1 else array.shape[1]
        entry = {"componentType": CODES[array.dtype.str], "count": len(array), "type": TYPES[width]}
        self.tree["accessors"].append(entry | {"bufferView": self.view(array)} | more)
        return len(self.tree["accessors"]) - 1

    def primitive(self, points=POINTS, indices=None, mesh=0, **more):
        entry = {"attributes": {"POSITION": points if isinstance(points, int) else self.accessor(points)}}
        if indices is not None:
            entry["indices"] = self.accessor(np.ravel(indices))
        self.tree["meshes"][mesh]["primitives"].append(entry | more)
        return entry

    def put(self, folder, **changes):
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.buffer).decode()
        tree = self.tree | {"buffers": [{"byteLength": len(self.buffer), "uri": uri}]} | changes
        (folder / "a.gltf").write_text(json.dumps(tree))
        return folder / "a.gltf"


@pytest.fixture
def file():
    return File()


def is_plain(shape):
    np.testing.assert_allclose(shape.points, POINTS, atol=1e-6)
    np.testing.assert_array_equal(shape.faces, FACES)


@pytest.mark.parametrize(("dtype", "largest"), [("<i2", 32767), ("|i1", 127), ("<u2", 65535), ("|u1", 255)])
def test_normalized_positions(tmp_path, file, dtype, largest):
    position = file.accessor((POINTS * largest).astype(dtype), normalized=True)
    file.primitive(position, FACES)
    is_plain(read_shape(file.put(tmp_path)))


def test_whole_numbers_that_are_not_normalized(tmp_path, file):
    file.primitive(file.accessor(POINTS.astype("<i2")), FACES)
    is_plain(read_shape(file.put(tmp_path)))


def test_lowest_normalized_number_is_minus_one(tmp_path, file):
    points = np.array([[-128, 0, 0], [127, 0, 0], [0, 127, 0], [0, 0, 127]], "|i1")
    file.primitive(file.accessor(points, normalized=True), mode=0)
    assert read_shape(file.put(tmp_path)).points[0, 0] == -1


def test_strides(tmp_path, file):
    interleaved = np.concatenate([POINTS, np.full_like(POINTS, 7)], axis=1).astype("<f4")
    view = file.view(interleaved, byteStride=24)
    file.tree["accessors"].append({"bufferView": view, "componentType": 5126, "count": 5, "type": "VEC3"})
    file.primitive(0, FACES)
    is_plain(read_shape(file.put(tmp_path)))


@pytest.mark.parametrize("base", [True, False])
def test_sparse_accessors(tmp_path, file, base):
    """A few rows replace those of a view, or zeros."""
    which, values = file.view(np.array([1, 3], "<u2")), file.view(np.array([[5, 0, 0], [0, 6, 0]], "<f4"))
    sparse = {"indices": {"bufferView": which, "componentType": 5123}, "values": {"bufferView": values}, "count": 2}
    entry = {"componentType": 5126, "count": 5, "type": "VEC3", "sparse": sparse}
    file.tree["accessors"].append(entry | ({"bufferView": file.view(POINTS)} if base else {}))
    file.primitive(0, FACES)
    expected = POINTS.copy() if base else np.zeros_like(POINTS)
    expected[[1, 3]] = [[5, 0, 0], [0, 6, 0]]
    if base:
        np.testing.assert_array_equal(read_shape(file.put(tmp_path)).points, expected)
    else:
        file.primitive(POINTS)
        np.testing.assert_array_equal(read_shape(file.put(tmp_path)).points[:5], expected)


def test_fans_strips_and_lines(tmp_path, file):
    square = file.accessor(POINTS)
    file.primitive(square, np.array([0, 1, 2, 3], "<u2"), mode=6)
    file.primitive(square, np.array([0, 1, 3, 2], "<u4"), mode=5)
    file.primitive(square, np.array([0, 1, 4], "|u1"))
    file.primitive(square, np.array([0, 4], "<u2"), mode=1)
    shape = read_shape(file.put(tmp_path))
    # All four share their points, so that these come once.
    np.testing.assert_array_equal(shape.points, POINTS)
    np.testing.assert_array_equal(shape.faces, [[0, 1, 2], [0, 2, 3], [0, 1, 3], [1, 2, 3], [0, 1, 4]])
    assert [(f.rule, f.count) for f in shape.notes] == [("primitives of lines", 1)]


def test_points_alone_are_a_cloud_and_beside_triangles_stay_points(tmp_path, file):
    file.primitive(mode=0)
    assert read_shape(file.put(tmp_path)).faces is None
    file.primitive(POINTS + 3, FACES)
    shape = read_shape(file.put(tmp_path))
    assert shape.n_points == 10
    np.testing.assert_array_equal(shape.faces, FACES + 5)


def test_scenes(tmp_path, file):
    """The active one, or the first; nodes in no scene are left out, with a word."""
    file.primitive(POINTS, FACES)
    nodes = [{"mesh": 0}, {"mesh": 0, "translation": [5, 0, 0]}]
    scenes = [{"nodes": [0]}, {"nodes": [1]}]
    for changes, shift in (({"scene": 1}, 5), ({"scene": 0}, 0)):
        shape = read_shape(file.put(tmp_path, nodes=nodes, scenes=scenes, **changes))
        np.testing.assert_array_equal(shape.points, np.add(POINTS, [shift, 0, 0]))
        assert [(f.rule, f.count) for f in shape.notes] == [("meshes outside the scene or hidden", 1)]
    del file.tree["scene"]
    is_plain(read_shape(file.put(tmp_path, nodes=nodes, scenes=scenes)))
    del file.tree["scenes"]
    assert read_shape(file.put(tmp_path, nodes=nodes)).n_points == 10


def test_instances(tmp_path, file):
    file.primitive(POINTS, FACES)
    turn = np.array([[0, 0, 0, 32767], [0, 0, 32767, 0]], "<i2")
    attributes = {
        "TRANSLATION": file.accessor(np.array([[0, 0, 0], [4, 0, 0]], "<f4")),
        "ROTATION": file.accessor(turn, normalized=True),
        "_ID": file.accessor(np.array([1, 2], "<f4")),
    }
    node = {"mesh": 0, "scale": [2, 2, 2], "extensions": {"EXT_mesh_gpu_instancing": {"attributes": attributes}}}
    shape = read_shape(file.put(tmp_path, nodes=[node]))
    half_turn = POINTS * [-1, -1, 1] + [4, 0, 0]
    np.testing.assert_allclose(shape.points, 2 * np.concatenate([POINTS, half_turn]), atol=1e-3)
    np.testing.assert_array_equal(shape.faces, np.concatenate([FACES, FACES + 5]))


def test_morph_targets(tmp_path, file):
    """The node's weights, or else the mesh's; without any the mesh is as it is."""
    up, right = (file.accessor(np.tile(np.array(d, "<f4"), (5, 1))) for d in ([0, 2, 0], [1, 0, 0]))
    file.primitive(POINTS, FACES, targets=[{"POSITION": up}, {"POSITION": right}, {"NORMAL": up}])
    is_plain(read_shape(file.put(tmp_path)))
    file.tree["meshes"][0]["weights"] = [0.5, 0, 1]
    np.testing.assert_array_equal(read_shape(file.put(tmp_path)).points, np.add(POINTS, [0, 1, 0]))
    shape = read_shape(file.put(tmp_path, nodes=[{"mesh": 0, "weights": [0, 3]}]))
    np.testing.assert_array_equal(shape.points, np.add(POINTS, [3, 0, 0]))


def skinned(file, weights=((255, 0, 0, 0),) * 5):
    primitive = file.primitive(POINTS, FACES)
    primitive["attributes"]["JOINTS_0"] = file.accessor(np.tile(np.array([0, 1, 0, 0], "|u1"), (5, 1)))
    primitive["attributes"]["WEIGHTS_0"] = file.accessor(np.array(weights, "|u1"), normalized=True)
    file.tree["skins"] = [{"joints": [1, 2]}]
    quarter = [-np.sqrt(0.5), 0, 0, np.sqrt(0.5)]
    file.tree["nodes"] = [
        {"mesh": 0, "skin": 0, "scale": [100, 100, 100]},
        {"rotation": quarter},
        {"translation": [0, 0, 9]},
    ]
    file.tree["scenes"] = [{"nodes": [0, 1, 2]}]


def test_skins(tmp_path, file):
    """Joints pose the mesh, and the transform of its own node is ignored."""
    skinned(file)
    shape = read_shape(file.put(tmp_path))
    np.testing.assert_allclose(shape.points, POINTS[:, [0, 2, 1]] * [1, 1, -1], atol=1e-6)
    assert [f.rule for f in shape.notes] == ["skinned meshes"] and "posed" in shape.notes[0].action
    rest = read_shape(file.put(tmp_path), pose="rest")
    is_plain(rest)
    assert "at rest" in rest.notes[0].action
    with pytest.raises(ArgumentError, match="pose is 'T', but must be one of posed, rest"):
        read_shape(file.put(tmp_path), pose="T")


def test_weights_of_a_skin_blend_and_bind_matrices_count(tmp_path, file):
    skinned(file, [(0, 255, 0, 0), (51, 204, 0, 0), (0, 0, 0, 0), (0, 102, 0, 0), (255, 0, 0, 0)])
    binds = np.array([np.eye(4), np.eye(4)], "<f4")
    binds[1, 3, 2] = -4.0  # matrices lie in columns: the second joint was bound at z = 4
    file.tree["skins"][0]["inverseBindMatrices"] = file.accessor(binds.reshape(2, 16))
    shape = read_shape(file.put(tmp_path))
    turned, moved = POINTS[:, [0, 2, 1]] * [1, 1, -1], np.add(POINTS, [0, 0, 5])
    # Shares that do not add up to one are scaled; a point that no joint moves stays.
    expected = [moved[0], 0.2 * turned[1] + 0.8 * moved[1], POINTS[2], moved[3], turned[4]]
    np.testing.assert_allclose(shape.points, expected, atol=1e-6)


def test_mirrors_turn_triangles_round(tmp_path, file):
    file.primitive(POINTS, FACES)
    shape = read_shape(file.put(tmp_path, nodes=[{"mesh": 0, "scale": [-1, 1, 1]}]))
    np.testing.assert_array_equal(shape.faces, FACES[:, [0, 2, 1]])


@pytest.mark.parametrize("where", ["extensionsRequired", "extensionsUsed"])
def test_draco_is_one_clear_line(tmp_path, file, where):
    name = "KHR_draco_mesh_compression"
    bare = {"componentType": 5126, "count": 5, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 1]}
    file.tree["accessors"] += [bare]
    file.primitive(0, extensions={name: {"bufferView": file.view(POINTS), "attributes": {"POSITION": 0}}})
    with pytest.raises(ShapeError, match=f"compressed with {name}; export it without compression"):
        read_shape(file.put(tmp_path, **{where: [name]}))


def test_draco_beside_plain_numbers_is_read(tmp_path, file):
    name = "KHR_draco_mesh_compression"
    file.primitive(POINTS, FACES, extensions={name: {"bufferView": 0, "attributes": {"POSITION": 0}}})
    is_plain(read_shape(file.put(tmp_path, extensionsUsed=[name])))


def test_meshopt_buffers_without_content(tmp_path, file):
    file.primitive(POINTS, FACES)
    path = file.put(tmp_path)
    tree = json.loads(path.read_text())
    tree["buffers"] += [{"byteLength": 60}]
    tree["bufferViews"][0]["buffer"] = 1
    path.write_text(json.dumps(tree))
    with pytest.raises(ShapeError, match="its buffer 1 holds nothing; the file is cut off or damaged"):
        read_shape(path)
    path.write_text(json.dumps(tree | {"extensionsUsed": ["EXT_meshopt_compression"]}))
    with pytest.raises(ShapeError, match="compressed with EXT_meshopt_compression"):
        read_shape(path)


def test_version_one(tmp_path, file):
    file.primitive(POINTS, FACES)
    for changes in ({"asset": {"version": "1.0"}}, {"asset": {}, "meshes": {"a": {}}, "accessors": {}}):
        with pytest.raises(ShapeError, match=r"it is glTF 1.*, but glTF 2 is needed"):
            read_shape(file.put(tmp_path, **changes))
    (tmp_path / "a.glb").write_bytes(b"glTF" + np.array([1, 40, 20, 0], "<u4").tobytes() + bytes(20))
    with pytest.raises(ShapeError, match="it is glTF 1, but glTF 2 is needed"):
        read_shape(tmp_path / "a.glb")


def chunk(kind, content, length=None):
    return np.array([len(content) if length is None else length, kind], "<u4").tobytes() + content


def binary(tmp_path, *chunks, more=0, end=b""):
    """A GLB of chunks, whose header announces so many bytes more than they have, and bytes behind its end."""
    length = 12 + sum(map(len, chunks)) + more
    content = b"glTF" + np.array([2, length], "<u4").tobytes() + b"".join(chunks) + end
    (tmp_path / "a.glb").write_bytes(content)
    return tmp_path / "a.glb"


JSON, BIN, OTHER = 0x4E4F534A, 0x004E4942, 0x12345678


@pytest.fixture
def chunks(file):
    """The JSON of a plain file, and its buffer."""
    file.primitive(POINTS, FACES)
    tree = json.dumps(file.tree | {"buffers": [{"byteLength": len(file.buffer)}]}).encode()
    return tree + b" " * (-len(tree) % 4), file.buffer


def test_chunks_of_other_kinds_are_passed_over(tmp_path, chunks):
    head, body = chunk(JSON, chunks[0]), chunk(BIN, chunks[1])
    others = chunk(OTHER, b"other"), chunk(JSON, chunks[0])
    for found in ([head, body], [head, *others, body], [head, body, *others], [head, body, chunk(BIN, bytes(60))]):
        shape = read_shape(binary(tmp_path, *found))
        is_plain(shape)
        assert not shape.notes
    is_plain(read_shape(binary(tmp_path, chunk(JSON, chunks[0] + bytes(4)), body)))
    is_plain(read_shape(binary(tmp_path, head, chunk(BIN, chunks[1] + bytes(3)))))
    # A length of the whole that is too small loses nothing.
    for more in (-4, -len(body), -12 - len(head + body)):
        is_plain(read_shape(binary(tmp_path, head, body, more=more)))


def test_bytes_after_the_end_are_noted(tmp_path, chunks):
    for end in (b"more", bytes(100), b"glTF" + bytes(30)):
        shape = read_shape(binary(tmp_path, chunk(JSON, chunks[0]), chunk(BIN, chunks[1]), end=end))
        is_plain(shape)
        assert [(note.rule, note.count) for note in shape.notes] == [("bytes after its end", len(end))]


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda head, body: [chunk(BIN, body), chunk(JSON, head)], "first chunk is not JSON"),
        (lambda head, body: [chunk(OTHER, head), chunk(BIN, body)], "first chunk is not JSON"),
        (lambda head, body: [chunk(JSON, head)], "its buffer 0 holds nothing"),
        (lambda head, body: [chunk(JSON, head), chunk(OTHER, body)], "its buffer 0 holds nothing"),
        (lambda head, body: [chunk(JSON, head), chunk(BIN, body, len(body) + 4)], "a chunk announces 82 bytes, but 78"),
        (lambda head, body: [chunk(JSON, head), chunk(BIN, body, 2**32 - 1)], "a chunk announces 4294967295 bytes"),
        (lambda head, body: [chunk(JSON, head, 10**6), chunk(BIN, body)], "a chunk announces 1000000 bytes"),
        (lambda head, body: [chunk(JSON, head), chunk(BIN, body, 20)], "a buffer ends after 20 bytes, too early"),
        (lambda head, body: [chunk(JSON, head, 20), chunk(BIN, body)], "a chunk announces|no valid JSON"),
        (lambda head, body: [chunk(JSON, head + body)], "no valid JSON"),
        (lambda head, body: [b"JSON"], "it has only 16 bytes"),
        (lambda head, body: [], "it has only 12 bytes"),
    ],
)
def test_chunks_that_do_not_fit(tmp_path, chunks, make, reason):
    with pytest.raises(ShapeError, match=reason):
        read_shape(binary(tmp_path, *make(*chunks)))


@pytest.mark.parametrize(
    ("kind", "number", "changes", "reason"),
    [
        ("accessors", 0, {"bufferView": -1}, "number -1 of its bufferViews, but has 2"),
        ("accessors", 0, {"bufferView": 9}, "number 9 of its bufferViews, but has 2"),
        ("bufferViews", 0, {"buffer": -1}, "number -1 of its buffers, but has 1"),
        ("bufferViews", 0, {"byteStride": 4}, "rows of accessor 0 take 12 bytes, but begin every 4"),
        ("accessors", 0, {"type": "VEC4"}, "holds 'VEC4' where VEC3 is needed"),
        ("accessors", 1, {"type": "VEC3"}, "holds 'VEC3' where SCALAR is needed"),
        ("accessors", 1, {"componentType": 5126, "count": 4}, "indices are not whole numbers from 0"),
        ("nodes", 0, {"mesh": -1}, "number -1 of its meshes, but has 1"),
        ("nodes", 0, {"mesh": 3}, "number 3 of its meshes, but has 1"),
        ("nodes", 0, {"mesh": True}, "entry nodes.0.mesh is True, but must be a whole number"),
        ("nodes", 0, {"children": [-1]}, "number -1 of its nodes, but has 1"),
        ("nodes", 0, {"matrix": [1] * 12}, "node 0 has a matrix of 12 numbers, but must have 16"),
        ("nodes", 0, {"rotation": [0, 0, 1]}, "node 0 has a rotation of 3 numbers, but must have 4"),
        ("nodes", 0, {"scale": [1, 1]}, "node 0 has a scale of 2 numbers, but must have 3"),
        ("nodes", 0, {"translation": []}, "node 0 has a translation of 0 numbers, but must have 3"),
        ("nodes", 0, {"scale": 2}, "node 0 has the scale 2, but must have 3 numbers"),
        (
            "nodes",
            0,
            {"translation": [0, "1", 0]},
            r"node 0 has the translation \[0, '1', 0\], but must have 3 numbers",
        ),
        ("accessors", 0, {"componentType": 5}, "accessor 0 has the componentType 5, but must have one of 5120, 5121"),
        ("accessors", 0, {"type": "MAT7"}, "holds 'MAT7' where VEC3 is needed"),
        ("accessors", 0, {"count": "5"}, "its entry accessors.0.count is '5', but must be a whole number"),
        ("accessors", 0, {"sparse": 1}, "its entry accessors.0.sparse is 1, but must be a table"),
        ("bufferViews", 0, {"byteLength": None}, "its entry bufferViews.0.byteLength is None, but must be a number"),
        ("nodes", 0, {"children": 1}, "its entry nodes.0.children is 1, but must be a list"),
        ("meshes", 0, {"primitives": {}}, "its entry meshes.0.primitives is {}, but must be a list"),
        *(
            (
                "meshes",
                0,
                {"primitives": [{"attributes": found}]},
                f"primitives.0.attributes{name}, but must be {needed}",
            )
            for found, name, needed in (
                ("POSITION", " is 'POSITION'", "a table"),
                ({"POSITION": "0"}, ".POSITION is '0'", "a whole number"),
                ({"POSITION": 0, "NORMAL": [1]}, r".NORMAL is \[1\]", "a whole number"),
            )
        ),
        ("scenes", 0, {"nodes": [-1]}, "number -1 of its nodes, but has 1"),
        ("meshes", 0, {"primitives": [{"attributes": {"POSITION": 1}}]}, "holds 'SCALAR' where VEC3 is needed"),
        ("meshes", 0, {"primitives": [{"attributes": {"POSITION": -2}}]}, "number -2 of its accessors, but has 2"),
        *(
            ("meshes", 0, {"primitives": [{"attributes": {"POSITION": 0}, "mode": mode}]}, said)
            for mode, said in (
                (7, r"primitive mode 7 does not exist \(0 to 6\)"),
                (-1, "primitive mode -1 does not exist"),
                ("4", "entry meshes.0.primitives.0.mode is '4', but must be a whole number"),
                ([], "entry meshes.0.primitives.0.mode is .*, but"),
            )
        ),
    ],
)
def test_references_that_lead_nowhere(tmp_path, file, kind, number, changes, reason):
    """A negative number leads nowhere as well, though Python would count it from the end."""
    file.primitive(POINTS, FACES)
    file.tree[kind][number] |= changes
    with pytest.raises(ShapeError, match=reason):
        read_shape(file.put(tmp_path))


def test_a_stride_of_zero_is_none(tmp_path, file):
    file.primitive(POINTS, FACES)
    file.tree["bufferViews"][0]["byteStride"] = 0
    is_plain(read_shape(file.put(tmp_path)))


@pytest.mark.parametrize("base", [np.array([0, -1, 1], "<i2"), np.array([0, 1, 2], "<f4")])
def test_sparse_indices_that_are_none(tmp_path, file, base):
    number = file.accessor(POINTS)
    entries = {"indices": file.view(base), "values": file.view(POINTS[:3])}
    sparse = {name: {"bufferView": view} for name, view in entries.items()} | {"count": 3}
    sparse["indices"]["componentType"] = CODES[base.dtype.str]
    file.tree["accessors"][number]["sparse"] = sparse
    file.primitive(number, FACES)
    with pytest.raises(ShapeError, match="indices are not whole numbers from 0"):
        read_shape(file.put(tmp_path))


@pytest.mark.parametrize(
    ("kind", "number", "changes"),
    [
        ("accessors", 0, {"byteOffset": 48}),
        ("accessors", 0, {"byteOffset": -12}),
        ("accessors", 0, {"bufferView": 9}),
        ("accessors", 0, {"componentType": 5}),
        ("bufferViews", 0, {"byteLength": 5000}),
        ("bufferViews", 0, {"byteOffset": -4}),
        ("bufferViews", 0, {"byteStride": 4000}),
        ("nodes", 0, {"children": [0]}),
        ("nodes", 0, {"mesh": 3}),
    ],
)
def test_damage_is_one_line(tmp_path, file, kind, number, changes):
    file.primitive(POINTS, FACES)
    file.tree[kind][number] |= changes
    with pytest.raises(ShapeError, match=r"a\.gltf could not be read as GLTF") as caught:
        read_shape(file.put(tmp_path))
    assert "\n" not in str(caught.value)


def test_two_meshes_of_one_character_fit(tmp_path, file):
    """Of two skinned meshes one lies under a node that is scaled: viewers show both in one place."""
    skinned(file)
    file.tree["nodes"] += [{"mesh": 0, "skin": 0}]
    file.tree["scenes"] = [{"nodes": [0, 1, 2, 3]}]
    shape = read_shape(file.put(tmp_path))
    np.testing.assert_allclose(shape.points[:5], shape.points[5:])
    assert check(shape).extent == pytest.approx(np.sqrt(3))


def test_buffers_in_files_beside_and_below(tmp_path, file):
    file.primitive(POINTS, FACES)
    (tmp_path / "parts").mkdir()
    for uri, name in (
        ("my%20b.bin", "my b.bin"),
        ("b c.bin", "b c.bin"),
        ("d%20e.bin", "d%20e.bin"),
        *[("parts/b.bin",) * 2],
    ):
        (tmp_path / name).write_bytes(file.buffer)
        path = file.put(tmp_path, buffers=[{"byteLength": len(file.buffer), "uri": uri}])
        is_plain(read_shape(path))
        assert files_of_shape(path) == (path, tmp_path / name)
    for uri in ("../b.bin", "parts/../../b.bin", "https://example.org/b.bin"):
        with pytest.raises(ShapeError, match="outside its own folder"):
            read_shape(file.put(tmp_path, buffers=[{"byteLength": len(file.buffer), "uri": uri}]))


def test_embedded_buffers_without_base64(tmp_path, file):
    file.primitive(POINTS, FACES)
    uri = "data:application/octet-stream," + quote(file.buffer)
    is_plain(read_shape(file.put(tmp_path, buffers=[{"byteLength": len(file.buffer), "uri": uri}])))


def test_the_content_says_whether_it_is_binary(tmp_path, file, make):
    file.primitive(POINTS, FACES)
    is_plain(read_shape(file.put(tmp_path).rename(tmp_path / "b.glb")))
    write_shape(tmp_path / "c.glb", make.blob(1))
    np.testing.assert_array_equal(
        read_shape((tmp_path / "c.glb").rename(tmp_path / "c.gltf")).faces, make.blob(1).faces
    )


@pytest.mark.parametrize("name", ["EXT_meshopt_compression", "KHR_meshopt_compression"])
@pytest.mark.parametrize("where", ["extensionsRequired", "extensionsUsed"])
def test_meshopt_is_one_clear_line(tmp_path, file, name, where):
    """Its buffers without content may be of any size."""
    file.primitive(POINTS, FACES)
    file.tree["bufferViews"][0] |= {"buffer": 1, "extensions": {name: {"buffer": 0, "byteLength": 9}}}
    own = json.loads(file.put(tmp_path).read_text())["buffers"]
    empty = {"byteLength": 10**6, "extensions": {name: {"fallback": True}}}
    with pytest.raises(ShapeError, match=f"compressed with {name}; export it without compression"):
        read_shape(file.put(tmp_path, buffers=[*own, empty], **{where: [name]}))


def test_draco_that_holds_the_triangles_alone(tmp_path, file):
    name = "KHR_draco_mesh_compression"
    file.primitive(POINTS, FACES, extensions={name: {"bufferView": 0, "attributes": {"POSITION": 0}}})
    del file.tree["accessors"][1]["bufferView"]
    with pytest.raises(ShapeError, match=f"compressed with {name}"):
        read_shape(file.put(tmp_path, extensionsUsed=[name]))


def test_what_viewers_do_not_show(tmp_path, file):
    """Nodes that are hidden, with all below them, and primitives without points."""
    file.primitive(POINTS, FACES)
    hidden = {"children": [2], "extensions": {"KHR_node_visibility": {"visible": False}}}
    file.tree["meshes"][0]["primitives"].append({"attributes": {}})
    nodes = [{"mesh": 0}, hidden, {"mesh": 0, "translation": [9, 0, 0]}]
    shape = read_shape(file.put(tmp_path, nodes=nodes, scenes=[{"nodes": [0, 1]}]))
    is_plain(shape)
    assert {note.rule: note.count for note in shape.notes} == {
        "primitives without points": 1,
        "meshes outside the scene or hidden": 1,
    }


@pytest.mark.parametrize("name", ["EXT_made_up", "MSFT_lod", "KHR_gaussian_splatting", "KHR_made_up_of_texturesque"])
def test_extensions_that_are_required_and_unknown_are_refused(tmp_path, file, name):
    file.primitive(POINTS, FACES)
    is_plain(read_shape(file.put(tmp_path, extensionsUsed=[name])))
    with pytest.raises(ShapeError, match=f"it needs the extension {name}, which is not read"):
        read_shape(file.put(tmp_path, extensionsRequired=["KHR_materials_unlit", name]))


@pytest.mark.parametrize(
    "name",
    [
        *(
            "KHR_materials_unlit",
            "KHR_texture_basisu",
            "EXT_texture_webp",
            "KHR_texture_transform",
            "KHR_lights_punctual",
        ),
        *("KHR_mesh_quantization", "KHR_node_visibility", "EXT_mesh_gpu_instancing", "KHR_animation_pointer"),
        *("KHR_materials_pbrSpecularGlossiness", "MSFT_texture_dds", "KHR_xmp_json_ld", "EXT_lights_image_based"),
    ],
)
def test_required_extensions_that_move_no_point_are_read(tmp_path, file, name):
    file.primitive(POINTS, FACES)
    is_plain(read_shape(file.put(tmp_path, extensionsRequired=[name])))


@pytest.mark.parametrize(
    ("asset", "reason"),
    [
        ({"version": "2.0", "minVersion": "2.1"}, r"needs at least glTF 2\.1 \(asset\.minVersion\), but 2\.0 is read"),
        ({"version": "3.0"}, r"it is glTF 3\.0, but glTF 2 is needed"),
        ({}, r"does not say its version of glTF, asset\.version"),
        ([], r"does not say its version of glTF, asset\.version"),
        ({"version": "2.1"}, ""),
        ({"version": "2.0", "minVersion": "2.0"}, ""),
    ],
)
def test_versions(tmp_path, file, asset, reason):
    file.primitive(POINTS, FACES)
    path = file.put(tmp_path, asset=asset)
    if not reason:
        is_plain(read_shape(path))
        return
    with pytest.raises(ShapeError, match=reason):
        read_shape(path)


def skin_of_one_joint(file, joint, count=5):
    """A mesh of one joint, whose rows refer to a joint."""
    file.primitive(POINTS, FACES)["attributes"].update(
        JOINTS_0=file.accessor(np.full((count, 4), joint, "|u1")),
        WEIGHTS_0=file.accessor(np.tile(np.array([1, 0, 0, 0], "<f4"), (count, 1))),
    )
    file.tree |= {"skins": [{"joints": [1]}], "nodes": [{"mesh": 0, "skin": 0}, {}], "scenes": [{"nodes": [0, 1]}]}
    return file


def refused(path, said):
    with pytest.raises(ShapeError) as caught:
        read_shape(path)
    assert said in str(caught.value)
    assert "leads nowhere" not in str(caught.value)


def test_joints_that_a_skin_has_not(tmp_path, file):
    refused(skin_of_one_joint(file, 9).put(tmp_path), "a mesh refers to joint 9 of its skin 0, which has 1;")


def test_a_skin_of_other_points(tmp_path, file):
    refused(skin_of_one_joint(file, 0, count=3).put(tmp_path), "a skin has 3 rows for 5 points;")


def test_a_morph_target_of_other_points(tmp_path, file):
    file.primitive(POINTS, FACES, targets=[{"POSITION": file.accessor(POINTS[:3])}])
    file.tree["meshes"][0]["weights"] = [1]
    refused(file.put(tmp_path), "a morph target has 3 rows for 5 points;")


def test_sparse_rows_that_an_accessor_has_not(tmp_path, file):
    sparse = {
        "count": 1,
        "indices": {"bufferView": file.view(np.array([5], "<u2")), "componentType": 5123},
        "values": {"bufferView": file.view(POINTS[:1])},
    }
    file.primitive(file.accessor(POINTS, sparse=sparse), FACES)
    refused(file.put(tmp_path), "its sparse accessor 0 replaces row 5, but has 5 rows;")


def test_no_accessors_at_all(tmp_path, file):
    file.primitive(0)
    file.tree.pop("accessors")
    refused(file.put(tmp_path), "it refers to number 0 of its accessors, but has 0;")
