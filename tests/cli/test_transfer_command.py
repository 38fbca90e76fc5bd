"""``homolog transfer``: what a result's source has, on its target."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from homolog.core.files import sha256
from homolog.matching import Match
from homolog.shapes import Shape, read_shape, write_shape
from homolog.transfer import (
    Animation,
    BlendShapes,
    Skin,
    SurfaceProjector,
    Track,
    bake_texture,
    png,
    read_appearance,
    read_blend_shapes,
    read_skin,
    unwrap,
    write_glb,
)
from homolog.transfer.appearance import Texture

pytest.importorskip("xatlas")
pytest.importorskip("PIL")


@pytest.fixture
def result(make, tmp_path):
    """A match of a blob, whose file has texture and skin, with a larger copy, whose cap has no counterpart."""
    shape = make.blob(2)
    projector = SurfaceProjector(shape)
    atlas = unwrap(projector, size=64)
    image = png(bake_texture(atlas, projector, lambda places: np.full((len(places.faces), 3), [10, 200, 90], np.uint8)))
    frames = np.stack([np.eye(4), np.eye(4)])
    frames[1, 1, 3] = 0.5
    weights = np.stack([shape.points[:, 1] < 0, shape.points[:, 1] >= 0], axis=1).astype(float)
    skin = Skin(("hip", "head"), np.array([-1, 0]), frames, weights)
    write_glb(tmp_path / "source.glb", projector, texture=(atlas, image), skin=skin)
    source = read_shape(tmp_path / "source.glb")
    point_of = np.linalg.norm(source.points[:, None] - shape.points, axis=2).argmin(axis=1)
    target = Shape(2 * shape.points, shape.faces)
    write_shape(tmp_path / "target.ply", target, colours=np.full((shape.n_points, 3), 77, np.uint8))
    lost = shape.points[:, 1] > 1.0
    back = np.array([np.flatnonzero(point_of == point)[0] for point in range(shape.n_points)])
    there = np.where(lost[point_of], -1, point_of)
    back = np.where(lost, -1, back)
    files = {"source": tmp_path / "source.glb", "target": tmp_path / "target.ply"}
    inputs = {side: {"file": str(file), "sha256": sha256(file)} for side, file in files.items()}
    target = read_shape(tmp_path / "target.ply")
    Match(source, target, there, back, method="nearest-features", report={"inputs": inputs}).save(tmp_path / "result")
    return tmp_path / "result"


@pytest.fixture
def rows(result):
    """How many points the source has."""
    return read_shape(result / "source.ply").n_points


def test_everything_that_the_file_has(homolog, result, tmp_path):
    before = sha256(tmp_path / "source.glb", tmp_path / "target.ply", result / "source.ply")
    ended = homolog("transfer", result, "-o", tmp_path / "out", "--texture-size", 64)
    assert (ended.code, ended.err) == (0, "")
    names = ["textured.obj", "textured.mtl", "textured.png", "carried.glb", "transfer.json"]
    assert ended.out.split() == [str(tmp_path / "out" / name) for name in names]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(names)
    written = read_shape(tmp_path / "out" / "textured.obj")
    np.testing.assert_array_equal(written.points, read_shape(tmp_path / "target.ply").points)
    mesh = trimesh.load(tmp_path / "out" / "carried.glb", force="mesh")
    colours = mesh.visual.to_color().vertex_colors[:, :3]
    low = mesh.vertices[:, 1] < 1.0
    np.testing.assert_allclose(colours[low], np.tile([10, 200, 90], (low.sum(), 1)), atol=2)
    assert (colours[mesh.vertices[:, 1] > 2.5] == 160).all()
    report = json.loads((tmp_path / "out" / "transfer.json").read_text())
    assert report["files"]["carried.glb"]["holds"] == ["skin", "texture"]
    lost = int((written.points[:, 1] > 2.0).sum())
    assert report["target"] == {"points": 162, "without_counterpart": lost}
    assert sha256(tmp_path / "source.glb", tmp_path / "target.ply", result / "source.ply") == before


def test_arrays_labels_and_landmarks(homolog, result, rows, tmp_path):
    points = read_shape(result / "source.ply").points
    np.save(tmp_path / "height.npy", points[:, 1].astype(np.float32))
    np.save(tmp_path / "sides.npy", np.where(points[:, 0] > 0, 7, 3).astype(np.uint8))
    (tmp_path / "marks.csv").write_text("name,x,y,z\nlow,%r,%r,%r\n" % tuple(map(float, points[points[:, 1].argmin()])))  # noqa: UP031
    ended = homolog(
        "transfer", result, "--array", tmp_path / "height.npy", "--labels", tmp_path / "sides.npy",
        "--landmarks", tmp_path / "marks.csv", "-o", tmp_path / "out", "-q",
    )  # fmt: skip
    assert (ended.code, ended.out, ended.err) == (0, "", "")
    target = read_shape(tmp_path / "target.ply").points
    height, sides = np.load(tmp_path / "out" / "height.npy"), np.load(tmp_path / "out" / "sides.npy")
    lost = target[:, 1] > 2.0
    assert height.dtype == np.float32 and set(sides.tolist()) == {3, 7, -1}
    np.testing.assert_array_equal(np.isnan(height), lost)
    np.testing.assert_array_equal(sides == -1, lost)
    np.testing.assert_allclose(height[~lost], target[~lost, 1] / 2, atol=1e-3)
    np.testing.assert_array_equal(sides[~lost] == 7, target[~lost, 0] > 0)
    lines = (tmp_path / "out" / "marks.csv").read_text().splitlines()
    carried = np.loadtxt(lines[1:], delimiter=",", usecols=(1, 2, 3))
    np.testing.assert_allclose(carried, target[target[:, 1].argmin()], atol=1e-3)
    assert not (tmp_path / "out" / "carried.glb").exists()


def test_the_other_way(homolog, result, tmp_path):
    ended = homolog("transfer", result, "--reverse", "-o", tmp_path / "out")
    assert (ended.code, ended.err) == (0, "")
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["carried.glb", "coloured.ply", "transfer.json"]
    colours = trimesh.load(tmp_path / "out" / "coloured.ply", process=False).visual.vertex_colors[:, 0]
    assert set(colours.tolist()) == {77, 160}


def test_a_checkerboard(homolog, result, tmp_path):
    ended = homolog("transfer", result, "--checker", "--texture-size", 64, "-o", tmp_path / "out")
    assert (ended.code, ended.err) == (0, "")
    for name in ("checkered.glb", "carried.glb", "textured.obj"):
        assert trimesh.load(tmp_path / "out" / name, force="mesh").visual.kind == "texture"


def test_a_moved_file_is_told(homolog, result, tmp_path):
    (tmp_path / "source.glb").rename(tmp_path / "moved.glb")
    ended = homolog("transfer", result, "--skin", "-o", tmp_path / "out")
    assert ended.is_one_line_of_complaint() and "is not there" in ended.err and "--from" in ended.err
    ended = homolog("transfer", result, "--skin", "--from", tmp_path / "moved.glb", "-o", tmp_path / "out")
    assert (ended.code, ended.err) == (0, "")


def test_landmarks_far_away_are_told_of(homolog, result, tmp_path):
    (tmp_path / "marks.csv").write_text("x,y,z\n0,-900,0\n")
    ended = homolog("transfer", result, "--landmarks", tmp_path / "marks.csv", "-o", tmp_path / "out")
    assert ended.code == 0 and "Warning: a landmark of marks.csv is 89" in ended.err


@pytest.mark.parametrize(
    ("spaces", "axes"), [(("RAS", "LPS"), []), (("RAS", "RAS"), []), ((None, None), ["--axes", "RAS"])]
)
def test_landmarks_follow_the_axes_that_the_shapes_name(homolog, result, tmp_path, spaces, axes):
    """A landmark in LPS is at -x, -y of a shape in RAS; it is written as it was, in LPS."""
    match = Match.load(result)
    for side, space in zip(("source", "target"), spaces, strict=True):
        match.report["inputs"][side]["space"] = space
    match.save(tmp_path / "named")
    low = int(match.source.points[:, 1].argmin())
    x, y, z = match.source.points[low].tolist()
    (tmp_path / "marks.csv").write_text(f"l,p,s\n{-x!r},{-y!r},{z!r}\n")
    homolog("transfer", tmp_path / "named", "--landmarks", tmp_path / "marks.csv", "-o", tmp_path / "out", *axes)
    found = np.loadtxt(tmp_path / "out" / "marks.csv", delimiter=",", skiprows=1)
    image = match.target.points[match.source_to_target[low]]
    np.testing.assert_allclose(found, image if spaces[1] == "LPS" else image * [-1, -1, 1], atol=1e-3)


def test_mistakes_are_one_line(homolog, result, rows, tmp_path):
    np.save(tmp_path / "short.npy", np.zeros(3))
    np.save(tmp_path / "half.npy", np.full(rows, 0.5))
    np.save(tmp_path / "words.npy", np.full(rows, "a"))
    np.save(tmp_path / "whole.npy", np.zeros(rows, int))
    np.save(tmp_path / "objects.npy", np.full(rows, None), allow_pickle=True)
    given = Path(json.loads((result / "report.json").read_text())["inputs"]["source"]["file"]).name
    assert given != "source.ply"
    np.save(tmp_path / "wide.npy", np.zeros((rows, 2), int))
    np.save(tmp_path / "textured.obj", np.zeros(rows))
    (tmp_path / "textured.obj.npy").rename(tmp_path / "textured.obj")
    (tmp_path / "rubbish.npy").write_bytes(b"rubbish")
    (tmp_path / "other").mkdir()
    np.save(tmp_path / "other" / "half.npy", np.full(rows, 0.5))
    (tmp_path / "file").write_text("")
    half = tmp_path / "half.npy"
    for arguments, told in (
        (["--array", tmp_path / "short.npy"], f"one row for each of the {rows} points of {given}"),
        (["--array", tmp_path / "objects.npy"], "but real numbers are needed; save it as numbers"),
        (["--labels", tmp_path / "whole.npy", "--array", tmp_path / "whole.npy"], "whole.npy is given twice"),
        (["--array", tmp_path / "words.npy"], "must be one array of numbers"),
        (["--array", tmp_path / "rubbish.npy"], "cannot be read as an NPY array"),
        (["--array", tmp_path / "none.npy"], "No such file"),
        (["--labels", half], "not whole"),
        (["--labels", tmp_path / "wide.npy"], "labels must have shape"),
        (["--array", half, "--array", tmp_path / "other" / "half.npy"], "another file named half.npy"),
        (["--array", tmp_path / "textured.obj"], "another file named textured.obj"),
        (["--array", half, "-o", tmp_path], "would be replaced"),
        (["--array", half, "-o", tmp_path / "file"], "is a file"),
        (["--colours", "--reverse", "--skin"], "holds no skin"),
        (["--reverse", "--texture"], "holds no texture"),
        (["--checker", "--texture"], "one at a time"),
        (["--landmarks", half], "landmarks must have one of"),
        (["--from", tmp_path / "target.ply"], "is not the file that was matched"),
        (["--axes", "XYZ"], "XYZ"),
        (["--texture-size", 3], "texture-size"),
    ):
        place = [] if "-o" in arguments else ["-o", tmp_path / "out"]
        ended = homolog("transfer", result, *arguments, *place)
        assert ended.is_one_line_of_complaint() and told in ended.err, ended.err
    ended = homolog("transfer", tmp_path / "other", "-o", tmp_path / "out")
    assert ended.is_one_line_of_complaint() and "is no result" in ended.err
    assert not (tmp_path / "out").exists()


def test_nothing_to_carry(homolog, files, result, tmp_path):
    report = json.loads((result / "report.json").read_text())
    report["inputs"]["target"] = {"file": str(tmp_path / "plain.off")}
    (result / "report.json").write_text(json.dumps(report))
    write_shape(tmp_path / "plain.off", read_shape(tmp_path / "target.ply"))
    ended = homolog("transfer", result, "--reverse", "-o", tmp_path / "out")
    assert ended.is_one_line_of_complaint() and "holds nothing that could be transferred" in ended.err


def test_another_file_in_place_of_the_one_that_was_matched(homolog, result, make, tmp_path):
    """Even if the report tells no hash."""
    report = json.loads((result / "report.json").read_text())
    del report["inputs"]["target"]["sha256"]
    (result / "report.json").write_text(json.dumps(report))
    moved = Shape(make.blob(2).points + 1, make.blob(2).faces)
    write_shape(tmp_path / "target.ply", moved, colours=np.zeros((moved.n_points, 3), np.uint8))
    ended = homolog("transfer", result, "--reverse", "-o", tmp_path / "out")
    assert ended.is_one_line_of_complaint() and "is not the file that was matched" in ended.err


def test_a_texture_needs_its_extra_and_nothing_is_half_written(homolog, result, rows, monkeypatch, tmp_path):
    np.save(tmp_path / "ones.npy", np.ones(rows))
    monkeypatch.setitem(sys.modules, "xatlas", None)
    ended = homolog("transfer", result, "--texture", "--array", tmp_path / "ones.npy", "-o", tmp_path / "out")
    assert ended.is_one_line_of_complaint() and "pip install 'homolog[transfer]'" in ended.err
    assert not list((tmp_path / "out").glob("*"))


def painted(path, shape):
    """The target's file with a look of its own: an image above, a colour below, and what is not carried."""
    upper = shape.points[shape.faces].mean(axis=1)[:, 1] > 0
    image = np.random.default_rng(0).integers(0, 255, (4, 4, 3), np.uint8)
    places = np.random.default_rng(1).random((shape.n_faces, 3, 2))
    green = np.full((1, 1, 3), (0, 255, 0), np.uint8)
    np.savez(path.with_suffix(".npz"), places=places, upper=upper, image=image)
    if path.suffix == ".glb":
        write_glb(path, SurfaceProjector(shape), look=Texture(places, np.where(upper, 0, 1), (image, green)))
        return
    path.with_name("my look.png").write_bytes(png(image))
    path.with_name("look.mtl").write_text("newmtl up\nmap_Kd my look.png\nmap_bump x.png\nnewmtl low\nKd 0 1 0\n")
    lines = ["mtllib look.mtl", *("v %r %r %r" % tuple(p) for p in shape.points.tolist())]  # noqa: UP031
    lines += ["vt %r %r" % (u, 1 - v) for u, v in places.reshape(-1, 2).tolist()]  # noqa: UP031
    for number in np.argsort(~upper, kind="stable"):
        corners = [f"{point + 1}/{3 * number + k + 1}" for k, point in enumerate(shape.faces[number])]
        lines += [f"usemtl {'up' if upper[number] else 'low'}", "f " + " ".join(corners)]
    path.write_text("\n".join(lines))


@pytest.mark.parametrize("suffix", [".glb", ".obj"])
def test_the_target_keeps_its_look_where_the_skin_alone_is_transferred(homolog, result, make, tmp_path, suffix):
    target = tmp_path / f"own{suffix}"
    shape = Shape(2 * make.blob(2).points, make.blob(2).faces)
    painted(target, shape)
    read = read_shape(target)
    old = Match.load(result)
    point_of = np.linalg.norm(read.points[:, None] - shape.points, axis=2).argmin(axis=1)
    place_of = np.linalg.norm(read.points[:, None] - shape.points, axis=2).argmin(axis=0)
    there = np.where(old.source_to_target < 0, -1, place_of[old.source_to_target])
    inputs = old.report["inputs"] | {"target": {"file": str(target), "sha256": sha256(target)}}
    found = Match(old.source, read, there, old.target_to_source[point_of], method="a", report={"inputs": inputs})
    found.save(tmp_path / "again")
    ended = homolog("transfer", tmp_path / "again", "--skin", "-o", tmp_path / "out")
    assert ended.code == 0
    assert ("own.obj: left out of its look: normal maps" in ended.err) == (suffix == ".obj")
    carried = tmp_path / "out" / "carried.glb"
    written = read_shape(carried)
    look, expected = (read_appearance(file, read_shape(file)).texture for file in (carried, target))
    assert look.images[0].tolist() == expected.images[0].tolist() and look.images[1].tolist() == [[[0, 255, 0]]]
    np.testing.assert_allclose(written.points[written.faces], read.points[read.faces], atol=1e-5)
    np.testing.assert_allclose(look.coordinates, expected.coordinates, atol=1e-5)
    assert read_skin(carried, written).names == ("hip", "head")
    # Another look takes its place.
    homolog("transfer", tmp_path / "again", "--texture", "--texture-size", 64, "-o", tmp_path / "other")
    (image,) = read_appearance(
        tmp_path / "other" / "carried.glb", read_shape(tmp_path / "other" / "carried.glb")
    ).texture.images
    assert image.shape[1] == 64
    # Without the target's file its look is left out, and that is said.
    target.unlink()
    ended = homolog("transfer", tmp_path / "again", "--skin", "-o", tmp_path / "bare")
    assert ended.code == 0 and "the target's own look, skin and blend shapes are left out" in ended.err


@pytest.fixture
def talking(make, matched_files, tmp_path):
    """A match of a blob, whose file has a skin with a movement and blend shapes, with a larger copy."""
    shape = make.blob(2)
    weights = np.ones((shape.n_points, 1))
    nod = Animation("nod", (Track("rotation", np.array([0.0, 1.0]), np.array([[0, 0, 0, 1.0], [0.6, 0, 0, 0.8]]), 0),))
    skin = Skin(("head",), np.array([-1]), np.eye(4)[None], weights, (nod,))
    offsets = np.stack([np.where(shape.points[:, 1:2] > 0.5, [0, 0.25, 0], 0.0), np.zeros_like(shape.points)])
    talk = Animation("talk", (Track("weights", np.array([0.0, 2.0]), np.array([[0.0, 0.0], [1.0, 0.5]])),))
    shapes = BlendShapes(("jawOpen", "eyeBlink_L"), offsets, np.zeros(2), (talk,))
    write_glb(tmp_path / "head.glb", SurfaceProjector(shape), skin=skin, blend_shapes=shapes)
    write_shape(tmp_path / "large.ply", Shape(2 * shape.points, shape.faces))
    return matched_files(tmp_path / "head.glb", tmp_path / "large.ply")


@pytest.fixture
def matched_files(tmp_path):
    """A match of two files with the same points, as a folder."""

    def saved(source, target):
        files = {"source": source, "target": target}
        shapes = [read_shape(file) for file in files.values()]
        points = np.arange(shapes[0].n_points)
        inputs = {side: {"file": str(file), "sha256": sha256(file)} for side, file in files.items()}
        Match(*shapes, points, points, method="nearest-features", report={"inputs": inputs}).save(tmp_path / "talking")
        return tmp_path / "talking"

    return saved


def test_blend_shapes_and_animations(homolog, talking, tmp_path):
    ended = homolog("transfer", talking, "-o", tmp_path / "out")
    assert ended.code == 0
    assert ended.err == "head.glb: blend shapes that move no point of the target: eyeBlink_L\n"
    assert ended.out.split() == [str(tmp_path / "out" / name) for name in ("carried.glb", "transfer.json")]
    report = json.loads((tmp_path / "out" / "transfer.json").read_text())
    entry = report["files"]["carried.glb"]
    assert entry["holds"] == ["blend-shapes", "skin"]
    assert entry["blend_shapes"] == ["jawOpen", "eyeBlink_L"] and entry["animations"] == ["nod", "talk"]
    carried = read_shape(tmp_path / "out" / "carried.glb")
    shapes = read_blend_shapes(tmp_path / "out" / "carried.glb", carried)
    assert shapes.names == ("jawOpen", "eyeBlink_L")
    np.testing.assert_allclose(shapes.offsets[0], np.where(carried.points[:, 1:2] > 1.0, [0, 0.5, 0], 0.0), atol=5e-3)
    assert not shapes.offsets[1].any() and shapes.animations[0].name == "talk"
    assert read_skin(tmp_path / "out" / "carried.glb", carried).animations[0].name == "nod"


def test_blend_shapes_alone_and_where_there_are_none(homolog, talking, tmp_path):
    ended = homolog("transfer", talking, "--blend-shapes", "-o", tmp_path / "out")
    carried = read_shape(tmp_path / "out" / "carried.glb")
    assert ended.code == 0 and read_skin(tmp_path / "out" / "carried.glb", carried) is None
    ended = homolog("transfer", talking, "--reverse", "--blend-shapes", "-o", tmp_path / "other")
    assert ended.is_one_line_of_complaint() and "holds no blend-shapes; leave --blend-shapes out" in ended.err
    assert not (tmp_path / "other").exists()


def test_the_target_keeps_its_own_blend_shapes(homolog, talking, matched_files, tmp_path):
    shape = read_shape(tmp_path / "large.ply")
    write_shape(tmp_path / "red.ply", shape, colours=np.full((shape.n_points, 3), (200, 0, 0), np.uint8))
    result = matched_files(tmp_path / "red.ply", tmp_path / "head.glb")
    ended = homolog("transfer", result, "-o", tmp_path / "out")
    assert (ended.code, ended.err) == (0, "")
    carried = tmp_path / "out" / "carried.glb"
    found, own = (read_blend_shapes(path, read_shape(path)) for path in (carried, tmp_path / "head.glb"))
    assert found.names == own.names and found.animations[0].name == "talk"
    np.testing.assert_allclose(found.offsets, own.offsets, atol=1e-6)


def test_a_cloud_says_what_it_cannot_hold(homolog, talking, matched_files, tmp_path):
    head = read_shape(tmp_path / "head.glb")
    write_shape(tmp_path / "cloud.ply", head.as_cloud())
    colours = np.full((head.n_points, 3), (200, 0, 0), np.uint8)
    shapes = read_blend_shapes(tmp_path / "head.glb", head)
    write_glb(tmp_path / "red.glb", SurfaceProjector(head), colours=colours, blend_shapes=shapes)
    result = matched_files(tmp_path / "red.glb", tmp_path / "cloud.ply")
    ended = homolog("transfer", result, "-o", tmp_path / "out")
    assert ended.code == 0 and "cloud.ply has no faces: left out: blend shapes" in ended.err
    ended = homolog("transfer", result, "--blend-shapes", "-o", tmp_path / "out")
    assert ended.is_one_line_of_complaint() and "has no faces, but --blend-shapes needs them" in ended.err


def test_the_texture_files_of_the_source_are_inputs(homolog, make, tmp_path):
    """They have the names that a transfer writes."""
    painted(tmp_path / "textured.obj", make.blob(2))
    for old, new in (("look.mtl", "textured.mtl"), ("my look.png", "textured.png")):
        (tmp_path / old).rename(tmp_path / new)
    for name in ("textured.obj", "textured.mtl"):
        text = (tmp_path / name).read_text().replace("look.mtl", "textured.mtl").replace("my look.png", "textured.png")
        (tmp_path / name).write_text(text)
    (tmp_path / "textured.obj").rename(tmp_path / "mine.obj")
    shape = read_shape(tmp_path / "mine.obj")
    points = np.arange(shape.n_points)
    inputs = {side: {"file": str(tmp_path / "mine.obj")} for side in ("source", "target")}
    Match(shape, shape, points, points, method="a", report={"inputs": inputs}).save(tmp_path / "result")
    before = sha256(tmp_path / "textured.mtl", tmp_path / "textured.png")
    ended = homolog("transfer", tmp_path / "result", "--texture", "-o", tmp_path)
    assert ended.is_one_line_of_complaint() and "textured.mtl is an input and would be replaced" in ended.err
    assert sha256(tmp_path / "textured.mtl", tmp_path / "textured.png") == before


def test_materials_that_no_library_holds_are_told(homolog, make, tmp_path):
    shape = make.blob(2)
    lines = [*("v %r %r %r" % tuple(point) for point in shape.points.tolist()), "usemtl red"]  # noqa: UP031
    faces = ["f %d %d %d" % tuple(face) for face in (shape.faces + 1).tolist()]  # noqa: UP031
    lines = ["mtllib a.mtl", *lines, *faces[:100], "usemtl gone", *faces[100:]]
    (tmp_path / "a.obj").write_text("\n".join(lines) + "\n")
    (tmp_path / "a.mtl").write_text("newmtl red # of the upper half\nKd 1 0 0\n")
    source, same = read_shape(tmp_path / "a.obj"), np.arange(shape.n_points)
    inputs = {"source": {"file": str(tmp_path / "a.obj"), "sha256": sha256(tmp_path / "a.obj")}}
    Match(source, shape, same, same, method="nearest-features", report={"inputs": inputs}).save(tmp_path / "r")
    ended = homolog("transfer", tmp_path / "r", "--texture", "--texture-size", 64, "-o", tmp_path / "out")
    told = "Warning: a.obj: no file of materials holds its gone; its faces are white"
    assert ended.code == 0 and told in ended.err.splitlines()
    assert json.loads((tmp_path / "out" / "transfer.json").read_text())["notes"] == [told]
