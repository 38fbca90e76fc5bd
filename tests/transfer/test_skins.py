"""Skins: read from glTF as its rules have them, carried, and written so that they move the target."""

import base64
import json

import numpy as np
import pytest
import trimesh

from homolog.core.errors import ArgumentError, DataError, ShapeError
from homolog.shapes import Shape, read_shape
from homolog.shapes.formats.gltf import Gltf, parts
from homolog.transfer import Animation, Skin, SurfaceProjector, Track, Transfer, read_skin, write_glb


def rigid(turn, position):
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = turn, position
    return frame


@pytest.fixture
def skinned(make):
    """A blob with a spine of three joints along y, and two loose ones; five in all, so that one is too many."""
    shape = make.blob(3)
    heights = np.array([-1.05, 0.03, 0.97, 0.45, -0.33])
    frames = np.stack([rigid(make.rotation(number), [0.05 * number, y, 0.0]) for number, y in enumerate(heights)])
    weights = np.exp(-4 * (shape.points[:, 1, None] - heights) ** 2)
    weights /= weights.sum(axis=1, keepdims=True)
    return shape, Skin(("hip", "spine", "head", "left", "right"), np.array([-1, 0, 1, 1, 1]), frames, weights)


def largest_four(weights):
    kept = weights * (weights.argsort(axis=1).argsort(axis=1) >= weights.shape[1] - 4)
    return kept / kept.sum(axis=1, keepdims=True)


def test_a_file_goes_round(skinned, tmp_path):
    shape, skin = skinned
    write_glb(tmp_path / "a.glb", SurfaceProjector(shape), skin=skin)
    found = read_skin(tmp_path / "a.glb", read_shape(tmp_path / "a.glb"))
    assert found.names == skin.names
    np.testing.assert_array_equal(found.parents, skin.parents)
    np.testing.assert_allclose(found.frames, skin.frames, atol=1e-5)
    np.testing.assert_allclose(found.weights, largest_four(skin.weights), atol=1e-6)
    assert len(trimesh.load(tmp_path / "a.glb", force="mesh").vertices) == shape.n_points


def test_a_written_skin_leaves_the_mesh_as_it_is(skinned, tmp_path):
    """By glTF's rules: each vertex is moved by its joints' places in the scene times their inverse binds."""
    shape, skin = skinned
    write_glb(tmp_path / "a.glb", SurfaceProjector(shape), skin=skin)
    file = Gltf(tmp_path / "a.glb")
    (entry,) = file.header["skins"]
    binds = file.accessor(entry["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
    moves = np.stack([file.world(joint) for joint in entry["joints"]]) @ binds
    np.testing.assert_allclose(moves, np.tile(np.eye(4), (5, 1, 1)), atol=1e-5)
    attributes = file.header["meshes"][0]["primitives"][0]["attributes"]
    weights, joints = file.accessor(attributes["WEIGHTS_0"]), file.accessor(attributes["JOINTS_0"])
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-6)
    assert weights.shape == joints.shape == (shape.n_points, 4) and joints.max() < 5
    assert sorted(file.header["scenes"][0]["nodes"]) == [0, 5]


def test_a_skin_goes_along(skinned, make, matched, tmp_path):
    """To a copy that is turned and twice as large: joints are where they were in it."""
    shape, skin = skinned
    turn = make.rotation(9)
    other = Shape(2.0 * shape.points @ turn.T + [1.0, 2.0, 3.0], shape.faces)
    same = np.arange(shape.n_points)
    carried = Transfer(matched(shape, other, same, same)).skin(skin)
    np.testing.assert_allclose(carried.weights, largest_four(skin.weights), atol=1e-4)
    np.testing.assert_allclose(carried.frames[:, :3, :3], turn @ skin.frames[:, :3, :3], atol=1e-4)
    expected = 2.0 * skin.frames[:, :3, 3] @ turn.T + [1.0, 2.0, 3.0]
    np.testing.assert_allclose(carried.frames[:, :3, 3], expected, atol=1e-3)
    assert carried.names == skin.names


def test_every_point_moves_with_the_body(skinned, make, matched):
    shape, skin = skinned
    same = np.arange(shape.n_points)
    lost = np.where(shape.points[:, 1] > 0.9, -1, same)
    carried = Transfer(matched(shape, shape, lost, lost)).skin(skin)
    np.testing.assert_allclose(carried.weights.sum(axis=1), 1.0)
    assert ((carried.weights > 0).sum(axis=1) <= 4).all()
    cloud = Transfer(matched(shape, shape.as_cloud(), same, same))
    with pytest.raises(ArgumentError, match="no faces"):
        cloud.skin(skin)
    with pytest.raises(DataError, match="dozen"):
        few = np.where(same < 8, same, -1)
        Transfer(matched(shape, shape, few, few)).skin(skin)


def posed(path, time):
    """The points of a file at a key of its animations: its nodes are set as the channels have them."""
    file = Gltf(path)
    for animation in file.header["animations"]:
        for channel in animation["channels"]:
            sampler = animation["samplers"][channel["sampler"]]
            times, values = file.accessor(sampler["input"])[:, 0], file.accessor(sampler["output"])
            place = channel["target"]
            file.nodes[place["node"]][place["path"]] = [float(np.interp(time, times, column)) for column in values.T]
    return np.concatenate([part.points for part in parts(file)])


def test_animations_go_along(skinned, make, matched, tmp_path):
    """To a copy that is turned and twice as large: it moves as the source does, turned and twice as far."""
    shape, skin = skinned
    times = np.array([0.0, 0.5, 1.25])
    quaternions = np.random.default_rng(0).standard_normal((2, 3, 4))
    quaternions /= np.linalg.norm(quaternions, axis=2, keepdims=True)
    moves = (
        Track("rotation", times, quaternions[0], 0),
        Track("translation", times, np.array([[0, 0, 0], [0.3, 0.2, 0.1], [0, 1, 0]]), 0),
        Track("rotation", times, quaternions[1], 2),
        Track("translation", times, np.array([[0, 1, 0], [0, 1.2, 0], [0.1, 1, 0]]), 1),
        Track("scale", times, np.array([[1, 1, 1], [1, 1.5, 1], [2, 2, 2]]), 4, steps=True),
    )
    skin = Skin(skin.names, skin.parents, skin.frames, skin.weights, (Animation("dance", moves),))
    turn, same = make.rotation(9), np.arange(shape.n_points)
    other = Shape(2.0 * shape.points @ turn.T + [1.0, 2.0, 3.0], shape.faces)
    carried = Transfer(matched(shape, other, same, same)).skin(skin)
    write_glb(tmp_path / "a.glb", SurfaceProjector(shape), skin=skin)
    write_glb(tmp_path / "b.glb", SurfaceProjector(other), skin=carried)
    for time in times:
        expected = 2.0 * posed(tmp_path / "a.glb", time) @ turn.T + [1.0, 2.0, 3.0]
        np.testing.assert_allclose(posed(tmp_path / "b.glb", time), expected, atol=5e-3)
    assert np.ptp(posed(tmp_path / "a.glb", 0.5) - shape.points, axis=0).max() > 0.3
    found = read_skin(tmp_path / "b.glb", read_shape(tmp_path / "b.glb"))
    (animation,) = found.animations
    assert animation.name == "dance"
    assert [(track.path, track.joint, track.steps) for track in animation.tracks] == [
        ("translation", 0, False),
        ("rotation", 0, False),
        ("translation", 1, False),
        ("rotation", 2, False),
        ("scale", 4, True),
    ]


def test_animations_of_nodes_around_the_joints(tmp_path):
    """Nodes above the joints and between them are left out of the skeleton; the joints move as they did in all."""
    path = by_hand(tmp_path)
    content = json.loads(path.read_text())
    values = {
        (0, "rotation"): [[0, 0, 0, 1], [0.6, 0, 0, 0.8]],
        (3, "translation"): [[5, 0, 0], [0, 9, 0]],
        (3, "scale"): [[1, 1, 1], [2, 2, 2]],
        (4, "rotation"): [[0, 0, 1, 0], [0, 0.6, 0, -0.8]],
    }
    keys = np.array([0.5, 2.0], "<f4")
    numbers = [keys, *(np.array(rows, "<f4") for rows in values.values())]
    body = b"".join(array.tobytes() for array in numbers)
    content["buffers"].append({"byteLength": len(body), "uri": "data:;base64," + base64.b64encode(body).decode()})
    samplers, channels, start = [], [], 0
    for number, array in enumerate(numbers):
        view = {"buffer": 1, "byteOffset": start, "byteLength": array.nbytes}
        start += array.nbytes
        content["bufferViews"].append(view)
        kind = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[array.size // 2]
        accessor = {"bufferView": len(content["bufferViews"]) - 1, "componentType": 5126, "count": 2, "type": kind}
        content["accessors"].append(accessor)
        if number:
            node, what = [*values][number - 1]
            samplers.append({"input": 5, "output": 5 + number})
            channels.append({"sampler": number - 1, "target": {"node": node, "path": what}})
    content["animations"] = [{"channels": channels, "samplers": samplers}]
    path.write_text(json.dumps(content))
    shape = read_shape(path)
    skin = read_skin(path, shape)
    write_glb(tmp_path / "again.glb", SurfaceProjector(shape), skin=skin)
    assert skin.animations[0].name == "animation 0"
    for time in (0.5, 2.0):
        # The first point has two joints, and they are bound anew where they lie.
        np.testing.assert_allclose(posed(tmp_path / "again.glb", time)[1:], posed(path, time)[1:], atol=1e-5)
    assert np.linalg.norm(posed(path, 2.0) - posed(path, 0.5)) > 0.1


def by_hand(folder, **changes):
    """A square under a node that is turned and scaled; weights as whole numbers, and a node between two joints."""
    parts = [
        np.array([[0, 0, 0], [100, 0, 0], [100, 100, 0], [0, 100, 50]], "<f4"),
        np.array([0, 1, 2, 0, 2, 3], "<u2"),
        np.array([[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0]], "u1"),
        np.array([[51, 204, 0, 0], [255, 0, 0, 0], [255, 0, 0, 0], [0, 255, 0, 0]], "u1"),
        # In columns: the mesh in centimetres to joints at (0, 0, 0) and at 100 centimetres along x.
        np.array([np.eye(4).T.ravel(), rigid(np.eye(3), [-100, 0, 0]).T.ravel()], "<f4"),
    ]
    buffer, views = b"", []
    for part in parts:
        views.append({"buffer": 0, "byteOffset": len(buffer), "byteLength": part.nbytes})
        buffer += part.tobytes() + bytes(-part.nbytes % 4)
    kinds = [(5126, 4, "VEC3"), (5123, 6, "SCALAR"), (5121, 4, "VEC4"), (5121, 4, "VEC4"), (5126, 2, "MAT4")]
    accessors = [
        {"bufferView": number, "componentType": code, "count": count, "type": type_}
        for number, (code, count, type_) in enumerate(kinds)
    ]
    accessors[0] |= {"min": [0, 0, 0], "max": [100, 100, 50]}
    accessors[3]["normalized"] = True
    attributes = {"POSITION": 0, "JOINTS_0": 2, "WEIGHTS_0": 3}
    uri = "data:application/octet-stream;base64," + base64.b64encode(buffer).decode()
    content = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(buffer), "uri": uri}],
        "bufferViews": views,
        "accessors": accessors,
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 1}]}],
        "skins": [{"joints": [2, 4], "inverseBindMatrices": 4}],
        "nodes": [
            {"children": [1, 2], "scale": [0.01, 0.01, 0.01], "rotation": [0, 0, np.sqrt(0.5), np.sqrt(0.5)]},
            {"mesh": 0, "skin": 0},
            {"name": "root", "children": [3]},
            {"name": "between", "children": [4]},
            {"translation": [7, 7, 7]},
        ],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    }
    (folder / "hand.gltf").write_text(json.dumps(content | changes))
    return folder / "hand.gltf"


def test_a_file_made_by_hand(tmp_path):
    """The second joint lies elsewhere than where the mesh was bound: points, and joints, are where it carries them."""
    path = by_hand(tmp_path)
    shape = read_shape(path)
    moved = [-0.07, 0.07, 0.07]
    np.testing.assert_allclose(shape.points[1], moved, atol=1e-6)
    # The first point is moved by four fifths of the way to (7, 7, 7) - (100, 0, 0).
    np.testing.assert_allclose(shape.points[0], 0.8 * np.array([-0.07, 7 / 100 - 1, 0.07]), atol=1e-6)
    np.testing.assert_allclose(shape.points[2], [-1, 1, 0], atol=1e-6)
    skin = read_skin(path, shape)
    assert skin.names == ("root", "joint 4")
    np.testing.assert_array_equal(skin.parents, [-1, 0])
    np.testing.assert_allclose(skin.frames[:, :3, 3], [[0, 0, 0], moved], atol=1e-6)
    np.testing.assert_allclose(skin.frames[0, :3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-6)
    np.testing.assert_allclose(skin.weights, [[0.2, 0.8], [0, 1], [1, 0], [1, 0]], atol=1e-6)


def test_files_without_a_skin(tmp_path, make):
    path = by_hand(tmp_path, skins=[], nodes=[{"mesh": 0}])
    assert read_skin(path, read_shape(path)) is None
    assert read_skin(tmp_path / "a.obj", make.blob(1)) is None


@pytest.mark.parametrize(
    "changes",
    [
        {"skins": []},
        {"skins": [{"joints": [2, 99], "inverseBindMatrices": 4}]},
        {"skins": [{"joints": [2], "inverseBindMatrices": 4}]},
        {"skins": [{"joints": [2, 4], "inverseBindMatrices": 77}]},
    ],
)
def test_damaged_skins(tmp_path, changes):
    path = by_hand(tmp_path, **changes)
    with pytest.raises(ShapeError, match=r"hand\.gltf could not be read"):
        read_shape(path)
    shape = read_shape(path, pose="rest")
    with pytest.raises(DataError, match="export it again") as raised:
        read_skin(path, shape)
    assert "\n" not in str(raised.value)


def test_nodes_in_a_circle(tmp_path):
    path = by_hand(tmp_path)
    shape = read_shape(path)
    content = json.loads(path.read_text())
    content["nodes"][4]["children"] = [2]
    path.write_text(json.dumps(content))
    with pytest.raises(DataError, match="no tree"):
        read_skin(path, shape)
