"""Materials of OBJ and glTF, however programs spell them."""

import json
import re

import numpy as np
import pytest
from PIL import Image

from homolog.core.errors import DataError
from homolog.shapes import read_shape, write_shape
from homolog.shapes.formats.gltf import GlbWriter
from homolog.transfer import SurfaceProjector, read_appearance, write_glb
from homolog.transfer.appearance import Texture, left_out, materials_warning
from homolog.transfer.obj import missing_materials, read_obj_texture

RED, BLUE = (255, 0, 0), (0, 0, 255)
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
FACE = "f 1/1 2/2 3/3 4/4\n"


def image(path, colour):
    path.parent.mkdir(exist_ok=True)
    Image.new("RGB", (2, 2), colour).save(path)


def colours(path):
    """The colour of each triangle, by its texture."""
    texture = read_appearance(path, read_shape(path)).texture
    return None if texture is None else [tuple(texture.images[number][0, 0].tolist()) for number in texture.image_of]


def obj(folder, faces, **libraries):
    for name, text in libraries.items():
        (folder / f"{name}.mtl").write_text(text)
    (folder / "a.obj").write_text(SQUARE + faces)
    return folder / "a.obj"


def test_names_with_marks(tmp_path):
    image(tmp_path / "red.png", RED)
    image(tmp_path / "blue #2.png", BLUE)
    library = "newmtl Material #1\nmap_Kd red.png\nnewmtl Material #2\nmap_Kd blue #2.png\n# the end\n"
    faces = f"mtllib m.mtl\nusemtl Material #1\n{FACE}usemtl Material #2\n{FACE}usemtl Material #1 # again\n{FACE}"
    assert colours(obj(tmp_path, faces, m=library)) == [RED, RED, BLUE, BLUE, RED, RED]


@pytest.mark.parametrize(
    ("library", "use"),
    [
        ("newmtl a\nmap_kd red.png", "usemtl a"),
        ("NEWMTL a\nMAP_KD red.png", "USEMTL a"),
        ("newmtl a\n\tmap_Kd RED.PNG", "usemtl a"),
        ('newmtl "a b"\nmap_Kd "red.png"', "usemtl a b"),
        ("newmtl a\nmap_Kd -s 1 1 1 -o 0 0 0 red.png", "usemtl a"),
        ("newmtl a\nmap_Kd -blendu on -mm 0 1 -bm 0.5 -texres 2 red.png", "usemtl a"),
        ("newmtl a\nmap_Kd C:\\art\\red.png", "usemtl a"),
        ("newmtl a\nmap_Kd gone/red.png", "usemtl a"),
        ("newmtl a\nmap_Kd D:\\far away\\art\\Red.png", "usemtl a"),
        ("newmtl a\nmap_Kd /home/her/art/red.png", "usemtl a"),
        ("newmtl a\nmap_Kd red.png # of the skin", "usemtl a"),
        ("newmtl a\nmap_Kd art%2Fred.png", "usemtl a"),
        ("newmtl Skin\nmap_Kd red.png", "usemtl SKIN"),
        ("newmtl a\nKd spectral file.rfl 1\nmap_Kd red.png", "usemtl a"),
        ("newmtl a\nKd 1\nmap_Kd red.png", "usemtl a"),
    ],
)
def test_spellings(tmp_path, library, use):
    image(tmp_path / "red.png", RED)
    assert colours(obj(tmp_path, f"mtllib m.mtl\n{use}\n{FACE}", m=library)) == [RED, RED]


@pytest.mark.parametrize(
    ("library", "use"),
    [
        ("newmtl a # first", "usemtl a"),
        ("newmtl a\t# first", "usemtl A"),
        ("newmtl a #first", "usemtl a # once more"),
        ('newmtl "a" # first', 'usemtl "a" # again'),
        ("newmtl a # first # of all", "usemtl a"),
        ("newmtl a #1", "usemtl a"),
        ("newmtl a # gone\nKd 0 0 1\nnewmtl a # first", "usemtl a"),
        ("newmtl Material #1 # first", "usemtl Material #1"),
    ],
)
def test_comments_behind_names(tmp_path, library, use):
    image(tmp_path / "red.png", RED)
    others = "newmtl b # second\nKd 0 0 1\nnewmtl Material #2\nKd 0 0 1\n"
    path = obj(tmp_path, f"mtllib m.mtl # here\n{use}\n{FACE}", m=f"{library}\nmap_Kd red.png # tex\n{others}")
    assert colours(path) == [RED, RED] and missing_materials(path) == []


def test_materials_that_are_not_there_are_told(tmp_path):
    """A number behind a mark is part of the name, so that no other is taken for it."""
    image(tmp_path / "red.png", RED)
    faces = "".join(f"usemtl {name}\n{FACE}" for name in ("a", "gone", "Material #3", "Material"))
    library = "newmtl a\nmap_Kd red.png\nnewmtl Material #1\nKd 0 0 1\nnewmtl Material #2\nKd 0 1 0\n"
    path = obj(tmp_path, f"mtllib m.mtl\nusemtl unused\n{faces}", m=library)
    assert missing_materials(path) == ["gone", "Material #3", "Material"]
    assert colours(path)[2:] == [(255, 255, 255)] * 6
    assert materials_warning(path) == "no file of materials holds its gone, Material #3, Material"


def test_texture_coordinates_that_are_not_there(tmp_path):
    path = obj(tmp_path, f"mtllib m.mtl\nusemtl a\n{FACE.replace('4/4', '4/9')}", m=KD)
    with pytest.raises(
        DataError, match=r"a\.obj: .* a face names texture coordinates 9, but there are 4; export it again"
    ):
        colours(path)


@pytest.mark.parametrize("words", ["nan 0 x", "1 0", "inf 0 0", "0,5 0 0", ""])
def test_colours_that_are_no_numbers(tmp_path, words):
    library = f"# head\nnewmtl a\nKd {words}\nnewmtl b\nKd 0 0 1\n"
    with pytest.raises(DataError) as caught:
        colours(obj(tmp_path, f"mtllib m.mtl\nusemtl a\n{FACE}", m=library))
    shown = f"{tmp_path / 'm.mtl'}, line 3: {f'Kd {words}'.strip()!r}"
    assert str(caught.value) == f"{shown} should hold one number or three, from 0 to 1; correct it"


@pytest.mark.parametrize("name", ["my red.png", "1 red.png", "-1 red.png"])
def test_names_with_blanks(tmp_path, name):
    image(tmp_path / name, RED)
    options = "-s 2 2 2 " if name.startswith("my") else ""
    assert colours(obj(tmp_path, f"mtllib m.mtl\nusemtl a\n{FACE}", m=f"newmtl a\nmap_Kd {options}{name}")) == [
        RED,
        RED,
    ]


@pytest.mark.parametrize(
    "line", ["mtllib one.mtl two.mtl", "mtllib one.mtl\nmtllib two.mtl", 'MTLLIB "one.mtl" Two.MTL']
)
def test_several_libraries(tmp_path, line):
    image(tmp_path / "red.png", RED)
    image(tmp_path / "art" / "blue.png", BLUE)
    faces = f"{line}\nusemtl a\n{FACE}usemtl b\n{FACE}"
    path = obj(tmp_path, faces, one="newmtl a\nmap_Kd red.png", two="newmtl b\nmap_Kd art\\blue.png")
    assert colours(path) == [RED, RED, BLUE, BLUE]


def test_a_library_whose_name_has_blanks(tmp_path):
    image(tmp_path / "red.png", RED)
    path = obj(tmp_path, f"mtllib my mats.mtl\nusemtl a\n{FACE}", **{"my mats": "newmtl a\nmap_Kd red.png"})
    assert colours(path) == [RED, RED]
    path = obj(tmp_path, f"mtllib my mats.mtl gone.mtl\nusemtl a\n{FACE}")
    with pytest.raises(DataError, match=r"gone\.mtl, the materials of an OBJ file, is not there"):
        colours(path)


def test_options_move_coordinates(tmp_path):
    image(tmp_path / "red.png", RED)
    library = "newmtl a\nmap_Kd -o 0.25 0.5 -s 2 red.png"
    found = read_obj_texture(obj(tmp_path, f"mtllib m.mtl\nusemtl a\n{FACE}", m=library))
    np.testing.assert_allclose(found.coordinates[0], [[0.25, 0.5], [2.25, 0.5], [2.25, -0.5]])


def test_texture_of_a_concave_polygon(tmp_path):
    """Its triangles are those of the shape, and each has its own corners' coordinates."""
    image(tmp_path / "red.png", RED)
    ring = [[4, 1], [1, 1], [1, 4], [0, 4], [0, 0], [4, 0]]
    text = "mtllib m.mtl\nusemtl a\n" + "".join(f"v {x} {y} 0\nvt {x / 4} {y / 4}\n" for x, y in ring)
    (tmp_path / "a.obj").write_text(text + "f " + " ".join(f"{i}/{i}" for i in range(1, 7)))
    (tmp_path / "m.mtl").write_text("newmtl a\nmap_Kd red.png")
    shape, texture = read_shape(tmp_path / "a.obj"), read_obj_texture(tmp_path / "a.obj")
    expected = shape.points[shape.faces][..., :2] / 4 * [1, -1] + [0, 1]
    np.testing.assert_allclose(texture.coordinates, expected)


KD = "newmtl a\nKd 1 0 0\nnewmtl b\nkd 0 0 1\n"


@pytest.mark.parametrize("face", [FACE, "f 1 2 3 4\n"])
def test_materials_of_one_colour_each(tmp_path, face):
    """With texture coordinates and without; one grey alone, as programs write it for all, says nothing."""
    faces = f"mtllib m.mtl\nusemtl a\n{face}usemtl b\n{face}"
    assert colours(obj(tmp_path, faces, m=KD)) == [RED, RED, BLUE, BLUE]
    assert colours(obj(tmp_path, faces, m="newmtl a\nKd 0.8 0.8 0.8\nnewmtl b\nKd 0.8 0.8 0.8\n")) is None
    assert colours(obj(tmp_path, faces, m="newmtl a\nKd 0.8 0.8 0.8\nnewmtl b\nKd 0.2 0.2 0.2\n")) is not None


def test_colours_of_points_before_those_of_materials(tmp_path):
    path = obj(tmp_path, f"mtllib m.mtl\nusemtl a\n{FACE}", m=KD)
    path.write_text(re.sub(r"(?m)^(v .*)$", r"\1 0 1 0", path.read_text()))
    look = read_appearance(path, read_shape(path))
    assert look.texture is None and look.point_colours.tolist() == [[0, 1, 0]] * 4


def painted(path, shape, *factors, **more):
    """A GLB whose upper and lower faces have materials of one colour each."""
    upper = shape.points[shape.faces].mean(axis=1)[:, 1] > 0
    writer = GlbWriter()
    position = writer.accessor(shape.points.astype("<f4"), bounds=True)
    for factor, faces in zip(factors, (shape.faces[upper], shape.faces[~upper]), strict=True):
        material = writer.add("materials", {"pbrMetallicRoughness": {"baseColorFactor": [*factor, 1]}, **more})
        indices = writer.accessor(faces.ravel().astype("<u4"), indices=True)
        first = {"attributes": {"POSITION": position}, "indices": indices, "material": material}
        writer.header.setdefault("meshes", [{"primitives": []}])[0]["primitives"].append(first)
    writer.header |= {"nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}], "scene": 0}
    path.write_bytes(writer.content())
    return read_shape(path)


def test_gltf_materials_of_one_colour_each(tmp_path, make):
    shape = painted(tmp_path / "a.glb", make.blob(2), (1, 0, 0), (0, 0, 0.5))
    look = read_appearance(tmp_path / "a.glb", shape).texture
    upper = shape.points[shape.faces].mean(axis=1)[:, 1] > 0
    assert colours(tmp_path / "a.glb") == [RED] * upper.sum() + [(0, 0, 188)] * (~upper).sum()
    # Written as the look of a mesh, they are materials again, with the same factors.
    write_glb(tmp_path / "b.glb", SurfaceProjector(shape), look=look)
    materials = glb_tree(tmp_path / "b.glb")[0]["materials"]
    factors = [m["pbrMetallicRoughness"]["baseColorFactor"] for m in materials]
    np.testing.assert_allclose(factors, [[1, 0, 0, 1], [0, 0, 0.5, 1]], atol=3e-3)
    assert colours(tmp_path / "b.glb") == colours(tmp_path / "a.glb")
    painted(tmp_path / "c.glb", make.blob(2), (0.8, 0.8, 0.8), (0.8, 0.8, 0.8))
    assert colours(tmp_path / "c.glb") is None


def test_a_look_keeps_coordinates_and_images(tmp_path, make):
    """Each face has its own places in its own image, whatever shares its points."""
    shape, rng = make.blob(1), np.random.default_rng(0)
    images = (rng.integers(0, 255, (4, 4, 3), np.uint8), rng.integers(0, 255, (2, 8, 3), np.uint8))
    places, image_of = rng.random((shape.n_faces, 3, 2)) * 3 - 1, np.arange(shape.n_faces) % 2
    write_glb(tmp_path / "a.glb", SurfaceProjector(shape), look=Texture(places, image_of, images))
    found = read_shape(tmp_path / "a.glb")
    look = read_appearance(tmp_path / "a.glb", found).texture
    order = np.argsort(image_of, kind="stable")
    np.testing.assert_allclose(found.points[found.faces], shape.points[shape.faces[order]], atol=1e-6)
    np.testing.assert_allclose(look.coordinates, places[order], atol=1e-6)
    for image, expected in zip(look.images, images, strict=True):
        np.testing.assert_array_equal(image, expected)


def test_transforms_of_texture_coordinates(tmp_path, make):
    """KHR_texture_transform scales, turns counterclockwise as one sees it, and moves."""
    shape = make.blob(1)
    places = np.random.default_rng(0).random((shape.n_faces, 3, 2))
    image = np.full((2, 2, 3), (255, 0, 0), np.uint8)
    write_glb(tmp_path / "a.glb", SurfaceProjector(shape), look=Texture(places, np.zeros(shape.n_faces, int), (image,)))
    tree, binary = glb_tree(tmp_path / "a.glb")
    moved = {"scale": [2, 3], "rotation": np.pi / 2, "offset": [0.25, 0.5]}
    texture = tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]
    texture["extensions"] = {"KHR_texture_transform": moved}
    tree["buffers"] = [{"byteLength": len(binary), "uri": "a.bin"}]
    (tmp_path / "a.bin").write_bytes(binary)
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    found = read_appearance(tmp_path / "a.gltf", read_shape(tmp_path / "a.gltf")).texture.coordinates
    u, v = places[..., 0], places[..., 1]
    np.testing.assert_allclose(found, np.stack([3 * v + 0.25, 0.5 - 2 * u], axis=-1), atol=1e-6)


def test_what_is_left_out_of_a_look(tmp_path, make):
    painted(tmp_path / "a.glb", make.blob(1), (1, 0, 0), (0, 1, 0), normalTexture={"index": 0}, alphaMode="BLEND")
    assert left_out(tmp_path / "a.glb") == ("normal maps", "transparency")
    assert left_out(obj(tmp_path, f"mtllib m.mtl\nusemtl a\n{FACE}", m=f"{KD}map_Bump red.png")) == ("normal maps",)
    write_shape(tmp_path / "a.ply", make.blob(1))
    assert left_out(tmp_path / "a.ply") == ()


def glb_tree(path):
    content = path.read_bytes()
    length = int.from_bytes(content[12:16], "little")
    return json.loads(content[20 : 20 + length]), content[28 + length :]


def test_gltf_textures_in_files_below(tmp_path, make):
    """A texture by its file's name, one without an image, and a factor; numbers of points stay."""
    shape = make.blob(1)
    write_shape(tmp_path / "a.glb", shape)
    tree, binary = glb_tree(tmp_path / "a.glb")
    image(tmp_path / "art" / "my red.png", RED)
    places = np.random.default_rng(0).random((shape.n_points, 2)).astype("<f4")
    (tmp_path / "a.bin").write_bytes(binary + places.tobytes())
    tree["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": places.nbytes})
    tree["accessors"].append({"bufferView": 2, "componentType": 5126, "count": shape.n_points, "type": "VEC2"})
    tree["buffers"] = [{"byteLength": len(binary) + places.nbytes, "uri": "a.bin"}]
    tree |= {"images": [{"uri": "art/my%20red.png"}], "textures": [{"source": 0}]}
    textured = {"baseColorTexture": {"index": 0, "texCoord": 1}, "baseColorFactor": [0.2, 1, 1, 1]}
    tree["materials"] = [
        {"pbrMetallicRoughness": textured},
        {"pbrMetallicRoughness": {"baseColorFactor": [0, 0, 1, 1]}},
    ]
    first = tree["meshes"][0]["primitives"][0]
    first["attributes"]["TEXCOORD_1"] = 2
    tree["meshes"][0]["primitives"] = [first | {"material": 0}, first | {"material": 1}]
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    read = read_shape(tmp_path / "a.gltf")
    assert read.n_points == shape.n_points and read.n_faces == 2 * shape.n_faces
    texture = read_appearance(tmp_path / "a.gltf", read).texture
    np.testing.assert_allclose(texture.coordinates[: shape.n_faces], places[shape.faces])
    # Factors are of linear light: a fifth of it looks half as bright.
    assert colours(tmp_path / "a.gltf") == [(124, 0, 0)] * shape.n_faces + [BLUE] * shape.n_faces
    tree["images"] = [{"uri": "../red.png"}]
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    with pytest.raises(DataError, match="outside its own folder"):
        read_appearance(tmp_path / "a.gltf", read)
    tree["images"] = [{"uri": "gone.png"}]
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    with pytest.raises(DataError, match=r"gone\.png, a texture, cannot be read"):
        read_appearance(tmp_path / "a.gltf", read)
