"""Blend shapes: deformation transfer against a slow reference, known maps, and files that go round."""

import base64
import json

import numpy as np
import pytest

from homolog.core.errors import ArgumentError, DataError
from homolog.shapes import Shape, read_shape
from homolog.shapes.formats.gltf import Gltf
from homolog.transfer import (
    Animation,
    BlendShapes,
    DeformationTransfer,
    SurfaceProjector,
    Track,
    Transfer,
    read_blend_shapes,
    write_glb,
)


def bump(points, *, top=0.5):
    """A cap that is pulled up and twisted; the rest does not move at all."""
    reach = np.clip((points[:, 1] - top) / (points[:, 1].max() - top), 0, None)[:, None] ** 2
    x, _, z = points.T
    return reach * np.stack([-0.4 * z, np.full(len(points), 0.3), 0.4 * x], axis=1)


@pytest.fixture(scope="module")
def same(make, matched):
    """A blob, and a copy that is turned and twice as large."""
    shape, turn = make.blob(3), make.rotation(9)
    other = Shape(2.0 * shape.points @ turn.T + [1.0, 2.0, 3.0], shape.faces)
    points = np.arange(shape.n_points)
    return Transfer(matched(shape, shape, points, points)), Transfer(matched(shape, other, points, points)), turn


def test_the_same_mesh_gets_the_same_offsets(same):
    along, _, _ = same
    offsets = bump(along.source.given.points)
    found = DeformationTransfer(along.to_source).offsets(offsets)
    np.testing.assert_allclose(found, offsets, atol=1e-4)
    np.testing.assert_array_equal(found.any(axis=1), np.linalg.norm(offsets, axis=1) > 1e-5 * np.abs(offsets).max())
    assert 0.2 < found.any(axis=1).mean() < 0.5


def test_a_turned_and_scaled_mesh_gets_turned_and_scaled_offsets(same):
    _, along, turn = same
    offsets = bump(along.source.given.points)
    found = DeformationTransfer(along.to_source).offsets(offsets)
    np.testing.assert_allclose(found, 2.0 * offsets @ turn.T, atol=2e-3)
    assert not found[~offsets.any(axis=1)].any()


def frame(a, b, c):
    normal = np.cross(b - a, c - a)
    return np.stack([b - a, c - a, normal / np.sqrt(np.linalg.norm(normal))], axis=1)


def slow(along, offsets):
    """Deformation transfer by loops and dense least squares: the definition, triangle by triangle."""
    to_source = along.to_source
    source, target = along.source.given, along.target.given
    count, unit = target.n_points, along.target.unit
    map_ = DeformationTransfer(to_source)
    turns, scales = map_._similarities
    rows, right = [], []
    mass = np.zeros(count)
    for face in target.faces:
        a, b, c = target.points[face]
        area = np.linalg.norm(np.cross(b - a, c - a)) / 2
        mass[face] += area / 3
        normal = np.cross(b - a, c - a) / (2 * area)
        gradients = []
        for weights in ((1, 1, 1), (4, 1, 1), (1, 4, 1), (1, 1, 4)):
            middle = np.array(weights) / sum(weights)
            images, below = to_source.positions[face], along.source.normals(to_source.surface_points)[face]
            direction = middle @ below / np.linalg.norm(middle @ below)
            place = along.source.project((middle @ images)[None], direction[None])
            corners = source.faces[place.faces[0]]
            moved = frame(*(source.points + offsets)[corners])
            gradients.append(moved @ np.linalg.inv(frame(*source.points[corners])) - np.eye(3))
        u, _, vt = np.linalg.svd(turns[face].mean(axis=0))
        turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
        wanted = turn.T @ np.mean(gradients, axis=0) @ turn
        # The gradient of a linear function from its differences along two sides and none along the normal.
        inverse = np.linalg.inv(np.stack([b - a, c - a, normal]))
        for axis in range(3):
            row = np.zeros(count)
            row[face[1]], row[face[2]] = inverse[axis, 0], inverse[axis, 1]
            row[face[0]] = -inverse[axis, 0] - inverse[axis, 1]
            rows.append(np.sqrt(area) * row)
            within = np.eye(3)[axis] - normal[axis] * normal
            right.append(np.sqrt(area) * wanted @ within)
    pulled = np.zeros((count, 3))
    for point in range(count):
        carried = to_source.surface_points.interpolate(offsets)[point]
        pulled[point] = turns[point].T @ carried / scales[point]
        row = np.zeros(count)
        row[point] = np.sqrt(1e-2 * mass[point]) / unit
        rows.append(row)
        right.append(row[point] * pulled[point])
    free = np.linalg.norm(pulled, axis=1) > 1e-5 * np.linalg.norm(pulled, axis=1).max()
    found = np.zeros((count, 3))
    found[free] = np.linalg.lstsq(np.array(rows)[:, free], np.array(right), rcond=None)[0]
    return found


def test_against_the_slow_reference(make, matched):
    """Another mesh of the blob, which is turned and twisted."""
    source, twin = make.blob(2), make.sphere(1)
    turned = twin.points @ make.rotation(3).T
    there = np.linalg.norm(turned[:, None] - make.sphere(2).points, axis=2).argmin(axis=1)
    target = Shape(1.5 * source.points[there] @ make.rotation(4).T + 0.1 * np.sin(3 * turned), twin.faces)
    back = np.linalg.norm(turned[:, None] - make.sphere(2).points, axis=2).argmin(axis=0)
    along = Transfer(matched(source, target, back, there))
    offsets = bump(source.points, top=0.0)
    found, expected = DeformationTransfer(along.to_source).offsets(offsets), slow(along, offsets)
    size = np.abs(expected).max()
    assert size > 0.3
    np.testing.assert_allclose(found, expected, atol=1e-4 * size)


def test_loose_parts_and_points_without_a_counterpart(make, matched):
    """A part that only shifts goes along, though it has no gradient; what has no counterpart follows its neighbours."""
    blob = make.blob(2)
    small = Shape(0.2 * blob.points + [3.0, 0, 0], blob.faces)
    both = make.joined([blob, small])
    points, loose = np.arange(both.n_points), np.arange(both.n_points) >= blob.n_points
    lost = np.where(blob.points[:, 1].max() - 0.1 < both.points[:, 1], -1, points)
    assert 0 < (lost < 0).sum() < 12
    offsets = np.where(loose[:, None], [0.0, 0.4, 0.0], bump(both.points, top=0.0))
    found = DeformationTransfer(Transfer(matched(both, both, lost, lost)).to_source).offsets(offsets)
    np.testing.assert_allclose(found[loose], offsets[loose], atol=1e-3)
    np.testing.assert_allclose(found, offsets, atol=0.1)
    np.testing.assert_allclose(found[lost >= 0], offsets[lost >= 0], atol=0.03)
    assert not DeformationTransfer(Transfer(matched(both, both, lost, lost)).to_source).offsets(0 * offsets).any()


def test_mistakes(make, matched):
    shape = make.blob(2)
    points = np.arange(shape.n_points)
    with pytest.raises(ArgumentError, match="no faces"):
        DeformationTransfer(Transfer(matched(shape, shape.as_cloud(), points, points)).to_source)
    with pytest.raises(ArgumentError, match=r"must have shape \(162, 3\)"):
        DeformationTransfer(Transfer(matched(shape, shape, points, points)).to_source).offsets(np.zeros((3, 3)))


def test_a_file_goes_round(make, tmp_path):
    """Names, offsets, weights and animations; the mesh is as it lies, and what does not move takes no bytes."""
    shape = make.blob(3)
    offsets = np.stack([bump(shape.points), 0 * shape.points, np.roll(shape.points, 1, axis=0)])
    times, values = np.array([0.0, 0.5, 2.0]), np.array([[0, 0, 0], [1, 0, 0.5], [0.25, 0, 0]])
    animation = Animation("talk", (Track("weights", times, values),))
    shapes = BlendShapes(("jawOpen", "nothing", "mouthSmile_L"), offsets, np.array([0.0, 0.0, 0.25]), (animation,))
    write_glb(tmp_path / "a.glb", SurfaceProjector(shape), blend_shapes=shapes)
    read = read_shape(tmp_path / "a.glb")
    np.testing.assert_allclose(read.points, shape.points, atol=1e-6)
    found = read_blend_shapes(tmp_path / "a.glb", read)
    assert found.names == shapes.names
    np.testing.assert_allclose(found.offsets, offsets, atol=1e-6)
    np.testing.assert_array_equal(found.offsets.any(axis=2), offsets.any(axis=2))
    np.testing.assert_array_equal(found.weights, shapes.weights)
    ((track,),) = (each.tracks for each in found.animations)
    assert found.animations[0].name == "talk" and not track.steps
    np.testing.assert_array_equal(track.times, times)
    np.testing.assert_allclose(track.values, values)
    file = Gltf(tmp_path / "a.glb")
    (primitive,) = file.header["meshes"][0]["primitives"]
    kinds = [file.header["accessors"][target["POSITION"]] for target in primitive["targets"]]
    assert kinds[0]["sparse"]["count"] == offsets[0].any(axis=1).sum() and kinds[1]["sparse"]["count"] == 1
    assert "sparse" not in kinds[2]
    assert file.header["meshes"][0]["extras"] == {"targetNames": list(shapes.names)}
    # Normals go along: those of the moved mesh.
    expected = SurfaceProjector(Shape(shape.points + offsets[0] - 0.25 * offsets[2], shape.faces)).surface
    normals = [
        file.accessor(number) for number in (primitive["attributes"]["NORMAL"], primitive["targets"][0]["NORMAL"])
    ]
    np.testing.assert_allclose(sum(normals), expected.vertex_normals, atol=1e-5)


def by_hand(folder, **changes):
    """Two triangles with two targets each under a node that is turned and scaled, of which one name is in common."""
    parts = [
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4"),
        np.array([[0, 0, 1], [0, 0, 0], [2, 0, 0]], "<f4"),
        np.array([[0, 127, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]], "i1"),
        np.array([0.0, 1.0], "<f4"),
        np.array([0, 0, 0.5, 0.25], "<f4"),
        np.array([[9, 9], [0.5, 0], [9, 9], [9, 9], [1, 1], [9, 9]], "<f4"),
    ]
    buffer, views = b"", []
    for part in parts:
        views.append({"buffer": 0, "byteOffset": len(buffer), "byteLength": part.nbytes})
        buffer += part.tobytes() + bytes(-part.nbytes % 4)
    views[2]["byteStride"] = 4
    kinds = [(5126, 3, "VEC3"), (5126, 3, "VEC3"), (5120, 3, "VEC3"), (5126, 2, "SCALAR"), (5126, 4, "SCALAR")]
    accessors = [
        {"bufferView": number, "componentType": code, "count": count, "type": type_}
        for number, (code, count, type_) in enumerate([*kinds, (5126, 12, "SCALAR")])
    ]
    accessors[2]["normalized"] = True
    targets = [{"POSITION": 1}, {"POSITION": 2}]
    mesh = {"primitives": [{"attributes": {"POSITION": 0}, "targets": targets}]}
    turned = [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]
    content = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(buffer), "uri": "data:;base64," + base64.b64encode(buffer).decode()}],
        "bufferViews": views,
        "accessors": accessors,
        "meshes": [mesh | {"extras": {"targetNames": names}} for names in (["jawOpen", "jawLeft"], ["jawOpen"])],
        "nodes": [{"mesh": 0}, {"mesh": 1, "scale": [2, 2, 2], "rotation": turned, "weights": [0.5, 0]}],
        "animations": [
            {
                "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}],
                "samplers": [{"input": 3, "output": 4, "interpolation": "STEP"}],
            },
            {
                "name": "animation 0",
                "channels": [
                    {"sampler": 0, "target": {"node": 1, "path": "weights"}},
                    {"sampler": 0, "target": {"path": "pointer"}},
                ],
                "samplers": [{"input": 3, "output": 5, "interpolation": "CUBICSPLINE"}],
            },
        ],
    }  # fmt: skip
    (folder / "hand.gltf").write_text(json.dumps(content | changes))
    return folder / "hand.gltf"


def test_a_file_made_by_hand(tmp_path):
    path = by_hand(tmp_path)
    found = read_blend_shapes(path, read_shape(path))
    assert found.names == ("jawOpen", "jawLeft", "mesh 1 target 1")
    jaw = np.zeros((6, 3))
    jaw[[0, 2]] = [0, 0, 1], [2, 0, 0]
    jaw[[3, 5]] = [0, -2, 0], [4, 0, 0]  # z goes to -y, and is doubled
    np.testing.assert_allclose(found.offsets[0], jaw, atol=1e-6)
    np.testing.assert_allclose(found.offsets[1], [[0, 1, 0], *np.zeros((5, 3))], atol=1e-6)
    np.testing.assert_allclose(found.offsets[2][3], [0, 0, 2], atol=1e-6)
    np.testing.assert_array_equal(found.weights, [0.5, 0, 0])
    steps, spline = found.animations
    assert (steps.name, spline.name) == ("animation 0", "animation 0 2")
    assert steps.tracks[0].steps and not spline.tracks[0].steps
    np.testing.assert_allclose(steps.tracks[0].values, [[0, 0, 0], [0.5, 0.25, 0]])
    # Hermite: half way between 0.5 and 1, with the tangents 9 and 9.
    track = spline.tracks[0]
    np.testing.assert_allclose(track.values[[0, 4, 8], 0], [0.5, 0.75, 1.0])
    np.testing.assert_allclose(
        track.values[track.times == 0.25, 0], 0.84375 * 0.5 + 0.15625 + (0.140625 - 0.046875) * 9
    )


TO_WEIGHTS = {"sampler": 0, "target": {"node": 0, "path": "weights"}}


@pytest.mark.parametrize(
    "animation",
    [
        {"channels": [TO_WEIGHTS], "samplers": []},
        {"channels": [TO_WEIGHTS], "samplers": [{"input": 3, "output": 3}]},
        "wave",
        {"channels": 3},
    ],
)
def test_damaged_animations(tmp_path, animation):
    path = by_hand(tmp_path, animations=[animation])
    with pytest.raises(DataError, match=r"morph targets cannot be read .* export it again") as raised:
        read_blend_shapes(path, read_shape(path))
    assert "\n" not in str(raised.value)


def test_files_without_morph_targets(make, tmp_path):
    write_glb(tmp_path / "a.glb", SurfaceProjector(make.blob(1)))
    assert read_blend_shapes(tmp_path / "a.glb", make.blob(1)) is None
    assert read_blend_shapes(tmp_path / "a.obj", make.blob(1)) is None
