"""Textures and colours: read from files, carried, and written so that other programs read them."""

import numpy as np
import pytest
import trimesh

from homolog.core.errors import ArgumentError, DataError
from homolog.shapes import Shape, read_shape, write_shape
from homolog.transfer import (
    Appearance,
    Atlas,
    SurfacePoints,
    SurfaceProjector,
    Texture,
    Transfer,
    bake_texture,
    png,
    read_appearance,
    unwrap,
    write_glb,
    write_obj,
)
from homolog.transfer.atlas import texels

xatlas = pytest.importorskip("xatlas")
pytest.importorskip("PIL")

SIZE = 256


def colour_at(points):
    """A smooth colour at every point of space, whose channels change by at most 127 per unit."""
    return 127.5 + 100 * np.sin(points * [1.0, 1.2, 0.9] + [0.3, 1.0, 2.0])


def painter(projector):
    return lambda places: np.round(colour_at(projector.positions(places))).astype(np.uint8)


@pytest.fixture(scope="module")
def textured(make, tmp_path_factory):
    """A blob painted by position, as OBJ and as GLB; its atlas has many pieces."""
    folder = tmp_path_factory.mktemp("textured")
    shape = make.blob(3)
    projector = SurfaceProjector(shape)
    atlas = unwrap(projector, size=SIZE)
    image = png(bake_texture(atlas, projector, painter(projector)))
    (folder / "paint.png").write_bytes(image)
    write_obj(folder / "blob.obj", shape, atlas.uv[atlas.faces], materials="blob.mtl", image="paint.png")
    write_glb(folder / "blob.glb", projector, texture=(atlas, image))
    return folder


def random_places(shape, count=2000, seed=0):
    rng = np.random.default_rng(seed)
    faces = rng.integers(shape.n_faces, size=count)
    return SurfacePoints(shape.faces[faces], rng.dirichlet([1.0, 1.0, 1.0], size=count), faces)


def pieces_of(shape, texture):
    """How many pieces an atlas has: faces that share an edge in it belong together."""
    corners = np.round(texture.coordinates * 1e5).astype(int)
    edges = {}
    for face in range(len(corners)):
        for a, b in ((0, 1), (1, 2), (2, 0)):
            edges.setdefault(frozenset((tuple(corners[face, a]), tuple(corners[face, b]))), []).append(face)
    pairs = np.array([faces for faces in edges.values() if len(faces) == 2])
    return trimesh.graph.connected_component_labels(pairs, len(corners)).max() + 1


@pytest.mark.parametrize("name", ["blob.obj", "blob.glb"])
def test_files_give_the_colours_that_were_painted(textured, name):
    shape = read_shape(textured / name)
    texture = read_appearance(textured / name, shape).texture
    assert pieces_of(shape, texture) > 5
    places = random_places(shape)
    expected = colour_at(places.interpolate(shape.points))
    np.testing.assert_allclose(texture.colours(places), expected, atol=4)


@pytest.mark.parametrize("name", ["blob.obj", "blob.glb"])
def test_seams_do_not_smear(textured, name, make, matched):
    """The target, a moved copy with its points in another order, has the source's colour at every point."""
    shape, turn = read_shape(textured / name), make.rotation(1)
    order = np.random.default_rng(0).permutation(shape.n_points)
    moved = make.relabelled(Shape(2.0 * shape.points @ turn.T + 3.0, shape.faces), order)
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    transfer = Transfer(matched(shape, moved, back, order), source=shape)
    atlas, image = transfer.texture(read_appearance(textured / name, shape), size=SIZE)
    carried = Texture(atlas.uv[atlas.faces], np.zeros(moved.n_faces, dtype=int), (image,))
    np.testing.assert_array_equal(atlas.face_of, np.arange(moved.n_faces))
    places = random_places(moved, 5000)
    expected = colour_at(places.interpolate((moved.points - 3.0) @ turn / 2.0))
    # Texels are some 0.02 wide, over which a colour changes by 3.
    assert np.abs(carried.colours(places) - expected).max() < 8


def test_written_files_open_elsewhere(textured):
    shape = read_shape(textured / "blob.glb")
    for name in ("blob.obj", "blob.glb"):
        mesh = trimesh.load(textured / name, force="mesh")
        assert mesh.visual.kind == "texture"
        assert len(mesh.faces) == shape.n_faces
        middles = mesh.triangles_center
        colours = mesh.visual.material.to_color(mesh.visual.uv[mesh.faces].mean(axis=1))[:, :3]
        assert np.median(np.abs(colours - colour_at(middles)).max(axis=1)) < 5
    scene = trimesh.load_scene(textured / "blob.glb")
    (only,) = scene.geometry.values()
    np.testing.assert_allclose(np.linalg.norm(only.vertex_normals, axis=1), 1.0, atol=1e-5)


def test_an_obj_keeps_the_numbers_of_points(textured, make):
    np.testing.assert_array_equal(read_shape(textured / "blob.obj").points, make.blob(3).points)
    np.testing.assert_array_equal(read_shape(textured / "blob.obj").faces, make.blob(3).faces)


def test_weights_of_texels_lead_to_their_middles():
    corners = np.array([[0.1, 0.2], [0.9, 0.1], [0.4, 0.95], [0.95, 0.9]])
    faces = np.array([[0, 1, 2], [1, 3, 2]])
    atlas = Atlas(np.arange(4), faces, np.arange(2), corners, (30, 40))
    found = texels(atlas)
    middles = np.einsum("tc,tck->tk", found.weights, corners[faces[found.triangles]])
    np.testing.assert_allclose(middles * [40, 30], np.stack([found.columns, found.rows], axis=1) + 0.5)
    assert found.weights.min() >= 0
    # As many as the triangles' areas have room for, none twice.
    sides = corners[faces][:, 1:] - corners[faces][:, :1]
    assert len(found.rows) == pytest.approx(np.abs(np.linalg.det(sides)).sum() / 2 * 1200, rel=0.02)
    assert len(np.unique(found.rows * 40 + found.columns)) == len(found.rows)


def test_texels_are_met_and_images_repeat():
    image = np.random.default_rng(0).integers(256, size=(4, 8, 3)).astype(np.uint8)
    row, column = np.meshgrid(np.arange(4), np.arange(8), indexing="ij")
    middles = np.stack([(column.ravel() + 0.5) / 8, (row.ravel() + 0.5) / 4], axis=1)
    for shift in ([0, 0], [1, -2]):
        coordinates = np.repeat((middles + shift)[:, None], 3, axis=1)
        texture = Texture(coordinates, np.zeros(32, dtype=int), (image,))
        places = SurfacePoints(np.zeros((32, 3), int), np.tile([0.2, 0.3, 0.5], (32, 1)), np.arange(32))
        np.testing.assert_array_equal(texture.colours(places), image.reshape(-1, 3))
    half = Texture(np.tile([1.0 / 8, 0.5 / 4], (1, 3, 1)), np.zeros(1, int), (image,))
    between = half.colours(SurfacePoints(np.zeros((1, 3), int), np.array([[1.0, 0, 0]]), np.zeros(1, int)))
    np.testing.assert_allclose(between[0], image[0, :2].mean(axis=0), atol=0.51)


def test_what_has_no_counterpart_is_grey(textured, matched):
    shape = read_shape(textured / "blob.obj")
    same = np.arange(shape.n_points)
    there = np.where(shape.points[:, 1] > 0.2, -1, same)
    transfer = Transfer(matched(shape, shape, there, there), source=shape)
    atlas, image = transfer.texture(read_appearance(textured / "blob.obj", shape), size=SIZE)
    texture = Texture(atlas.uv[atlas.faces], np.zeros(shape.n_faces, dtype=int), (image,))
    middles = SurfacePoints(shape.faces, np.full((shape.n_faces, 3), 1 / 3), np.arange(shape.n_faces))
    lost = (there[shape.faces] < 0).all(axis=1)
    assert (texture.colours(middles)[lost] == 160).all()
    kept = (there[shape.faces] >= 0).all(axis=1)
    expected = colour_at(middles.interpolate(shape.points))
    assert np.median(np.abs(texture.colours(middles) - expected).max(axis=1)[kept]) < 4
    colours = transfer.colours(Appearance(point_colours=np.full((shape.n_points, 3), 0.2)))
    np.testing.assert_array_equal(colours, np.where((there < 0)[:, None], 160, 51) * np.ones((1, 3), int))


def test_materials_have_images_or_colours(tmp_path):
    write_shape(tmp_path / "flat.off", Shape([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2]]))
    red = np.zeros((2, 2, 3), np.uint8)
    red[..., 0] = 200
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "a red.png").write_bytes(png(red))
    (tmp_path / "some stuff.mtl").write_text(
        "newmtl paint on it\nKd 0.1 0.1 0.1\nmap_Kd images/a red.png\nnewmtl plain\nKd 0 1 0.5\n"
    )
    (tmp_path / "flat.obj").write_text(
        "mtllib some stuff.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 0\nvt 1 1\n"
        "usemtl paint on it\nf 1/-3 2/-2/ 3/-1 4/1\nusemtl plain\nf 1//1 2 5\nusemtl unknown\nf 1 2 5\n"
    )
    shape = read_shape(tmp_path / "flat.obj")
    texture = read_appearance(tmp_path / "flat.obj", shape).texture
    assert texture.coordinates.shape == (shape.n_faces, 3, 2) == (4, 3, 2)
    np.testing.assert_array_equal(texture.coordinates[1], [[0, 1], [1, 0], [0, 1]])
    middles = SurfacePoints(shape.faces, np.full((4, 3), 1 / 3), np.arange(4))
    expected = [[200, 0, 0], [200, 0, 0], [0, 255, 128], [255, 255, 255]]
    np.testing.assert_array_equal(texture.colours(middles), expected)


def test_colours_of_points(tmp_path, make):
    shape = make.blob(1)
    colours = np.random.default_rng(0).integers(256, size=(shape.n_points, 3)).astype(np.uint8)
    write_shape(tmp_path / "a.ply", shape, colours=colours)
    rows = np.concatenate([shape.points, colours / 255], axis=1).tolist()
    lines = [" ".join(["v", *map(repr, row)]) for row in rows]
    lines += [" ".join(["f", *map(str, face)]) for face in (shape.faces + 1).tolist()]
    (tmp_path / "a.obj").write_text("\n".join(lines))
    head = ["ply", "format ascii 1.0", "element vertex 4", *(f"property float {axis}" for axis in "xyz")]
    head += [*(f"property float {name}" for name in ("red", "green", "blue")), "end_header"]
    (tmp_path / "b.ply").write_text("\n".join([*head, "0 0 0 1 0 0", "1 0 0 0 1 0", "0 1 0 0 0 .5", "0 0 1 1 1 1"]))
    write_glb(tmp_path / "a.glb", SurfaceProjector(shape), colours=colours)
    for name in ("a.ply", "a.obj", "a.glb"):
        found = read_appearance(tmp_path / name, read_shape(tmp_path / name))
        assert found.texture is None
        np.testing.assert_allclose(255 * found.point_colours, colours, atol=0.01)
    np.testing.assert_allclose(
        read_appearance(tmp_path / "b.ply", read_shape(tmp_path / "b.ply")).point_colours[2], [0, 0, 0.5]
    )
    for name in ("bare.ply", "bare.obj", "bare.glb", "bare.off"):
        write_shape(tmp_path / name, shape)
        found = read_appearance(tmp_path / name, read_shape(tmp_path / name))
        assert found.texture is None and found.point_colours is None


def test_a_cloud_takes_no_texture_but_its_colours(textured, matched):
    shape = read_shape(textured / "blob.obj")
    same = np.arange(shape.n_points)
    transfer = Transfer(matched(shape, shape.as_cloud(), same, same), source=shape)
    appearance = read_appearance(textured / "blob.obj", shape)
    with pytest.raises(ArgumentError, match="no faces"):
        transfer.texture(appearance)
    np.testing.assert_allclose(transfer.colours(appearance), colour_at(shape.points), atol=5)


def test_faults_of_files(textured, tmp_path):
    text = (textured / "blob.obj").read_text()
    (tmp_path / "blob.obj").write_text(text)
    shape = read_shape(tmp_path / "blob.obj")
    with pytest.raises(DataError, match=r"blob\.mtl, the materials"):
        read_appearance(tmp_path / "blob.obj", shape)
    (tmp_path / "blob.mtl").write_text("newmtl texture\nmap_Kd paint.png\n")
    with pytest.raises(DataError, match=r"paint\.png, a texture, cannot"):
        read_appearance(tmp_path / "blob.obj", shape)
    (tmp_path / "paint.png").write_bytes(b"rubbish")
    with pytest.raises(DataError, match=r"paint\.png, a texture, cannot"):
        read_appearance(tmp_path / "blob.obj", shape)
    (tmp_path / "blob.obj").write_text(text.replace("vt ", "vn "))
    with pytest.raises(DataError, match="texture coordinates"):
        read_appearance(tmp_path / "blob.obj", shape)
