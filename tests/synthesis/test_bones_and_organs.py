"""Bones of a statistical model, and variants of one shape: models, warps, turns, and whole sets of both kinds."""

import json
import pickle
import pickletools
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from homolog.core.errors import ArgumentError, DataError, MissingExtraError, ShapeError
from homolog.datasets import ShapeFolder
from homolog.geometry.projection import SurfaceProjector
from homolog.geometry.surface import BarycentricPoints, Surface
from homolog.shapes import Shape, read_shape, write_shape
from homolog.synthesis import (
    BodySettings,
    Bones,
    MeshSettings,
    Organs,
    Warp,
    bone_model,
    make_body,
    production,
    remeshing,
    synthesize_bones,
    synthesize_organs,
)
from homolog.synthesis.bodies import MOST_CROSSING
from homolog.synthesis.bone_model import BoneModel
from homolog.synthesis.remeshing import is_one_closed_surface
from homolog.synthesis.template import sample_evenly
from homolog.synthesis.turns import drawn_turn, turned

SMALL = BodySettings(seed=3, mesh=MeshSettings(700))


@pytest.fixture
def workshop(monkeypatch):
    """Rough meshes do, and soon."""
    monkeypatch.setattr(production, "TEMPLATE_POINTS", 200)
    monkeypatch.setattr(remeshing, "_ROUNDS", 4)


@pytest.fixture
def package():
    """The folder of the package of bones."""
    models = pytest.importorskip("musculoskeletal.models")
    return Path(models.__file__).parent


@pytest.fixture
def ring(tmp_path):
    """A file with a surface that has a hole through it."""
    mesh = trimesh.creation.torus(3.0, 1.0, major_sections=40, minor_sections=20)
    write_shape(tmp_path / "ring.ply", Shape(mesh.vertices * 10.0, mesh.faces))
    return tmp_path / "ring.ply"


def nodes_of(package, file):
    """Positions of a mean bone as the package itself gives them in text, turned as Homolog turns them."""
    stored = json.loads((package / "atlas_meshes" / file).read_text())["field_parameters"]
    x, y, z = np.array([[float(stored[key][f"dim {i}"]) for key in sorted(stored)] for i in range(3)])
    return np.stack([x, z, -y], axis=1)


@pytest.mark.parametrize(
    ("bone", "file"),
    [("patella", "patella_left_mean_rigid_LLP26.geof"), ("femur", "femur_left_mean_rigid_LLP26.geof")],
)
def test_the_mean_passes_through_the_nodes_of_the_package(package, bone, file):
    mean, nodes = BoneModel.of(bone).mean, nodes_of(package, file)
    surface = SurfaceProjector(Shape(mean.vertices, mean.faces))
    for _ in range(30):  # the mean is moved as a whole
        nodes = nodes + (surface.positions(surface.project(nodes)) - nodes).mean(axis=0)
    away = np.linalg.norm(surface.positions(surface.project(nodes)) - nodes, axis=1)
    assert away.max() < 0.005 * np.ptp(nodes, axis=0).max()
    corners, _ = cKDTree(mean.vertices).query(nodes)
    assert np.sum(corners < 1e-3 * np.ptp(nodes)) > 0.1 * len(nodes)


@pytest.mark.parametrize(("bone", "euler_number"), [("patella", 2), ("fibula", 2), ("tibia", 2), ("femur", 2)])
def test_bones_are_closed_and_stand_upright(package, bone, euler_number):
    model = BoneModel.of(bone)
    assert is_one_closed_surface(model.mean, euler_number=euler_number)
    assert np.ptp(model.mean.vertices, axis=0).argmax() == 1
    assert len(model.modes) == 25


def test_a_hip_bone_has_a_hole_through_it(package):
    bones = Bones("hip", "none")
    assert bones.template.euler_number == 0
    character = next(bones.characters(0, 1, np.random.default_rng(0)))
    assert is_one_closed_surface(bones.surface(character), euler_number=0)
    assert not is_one_closed_surface(bones.surface(character))


def test_modes_are_the_standard_deviations_of_the_people_measured(package):
    """The package keeps where its 26 people lie along the modes; in units of a mode, their spread is one."""
    numbers = bone_model._stored_numbers(package / "shape_models" / "LLP26_rigid.pc")
    data, name = (package / "shape_models" / "LLP26_rigid.pc").read_bytes(), ""
    for operation, argument, _ in pickletools.genops(data):
        if operation.name == "SHORT_BINUNICODE":
            name = argument if argument.endswith("Weights") else name
        elif operation.name == "BINBYTES" and name:
            people = np.frombuffer(argument, "<f8").reshape(26, 26)
    spread = (people**2).sum(axis=1)[:25] / 26
    np.testing.assert_allclose(spread / numbers["weights"][:25], 25 / 26, atol=0.05)


class Bomb:
    """Leaves a trace when it is unpickled."""

    def __init__(self, trace):
        self.trace = trace

    def __reduce__(self):
        return Path.touch, (self.trace,)


@pytest.mark.parametrize("content", ["bomb", "shortened", "text"])
def test_a_model_that_is_another(package, tmp_path, content):
    file = tmp_path / "model.pc"
    whole = (package / "shape_models" / "LLP26_rigid.pc").read_bytes()
    bomb = pickle.dumps({"mean": Bomb(tmp_path / "trace")})
    file.write_bytes({"bomb": bomb, "shortened": whole[:50_000], "text": b"no pickle"}[content])
    with pytest.raises(DataError, match=r"model\.pc .*musculoskeletal-models"):
        bone_model._nodes(file)
    assert not (tmp_path / "trace").exists()


@pytest.mark.parametrize("content", ["{}", "[1", '{"elements": {"0": "0 hex8"}, "connectivity": {}}'])
def test_patches_that_are_others(tmp_path, content):
    (tmp_path / "a.mesh").write_text(content)
    with pytest.raises(DataError, match=r"a\.mesh"):
        bone_model._Patches.read(tmp_path / "a.mesh", 74)


def test_the_package_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "musculoskeletal", None)
    with pytest.raises(MissingExtraError, match=r"homolog\[synth\]"):
        BoneModel.of("femur")


def test_a_set_of_bones(package, workshop, tmp_path):
    root = synthesize_bones(tmp_path / "set", 3, SMALL, bone="patella").root
    manifest = json.loads((root / "manifest.json").read_text())
    assert [(asset["licence"], asset["version"]) for asset in manifest["assets"]] == [("MPL-2.0", "0.2.4")]
    assert ShapeFolder.open(root).names == ("patella_00000", "patella_00001", "patella_00002")
    model = BoneModel.of("patella")
    for name, body in manifest["bodies"].items():
        assert body["crossing_share"] <= MOST_CROSSING
        held = np.load(root / "barycentric" / f"{name}.npz", allow_pickle=False)
        amounts = np.array(list(body["angles"].values()))
        bone = model.mean.vertices + np.einsum("k,knc->nc", amounts, model.modes)
        expected = BarycentricPoints(held["triangles"], held["weights"]).positions(Surface(bone, model.mean.faces))
        found = ShapeFolder.open(root).shape(name).points
        np.testing.assert_allclose(found, turned(expected, body["build"]["turn"]), atol=1e-4)
    again = synthesize_bones(tmp_path / "again", 3, SMALL, bone="patella").root
    for file in sorted(root.glob("*/*.off")):
        assert file.read_bytes() == (again / file.relative_to(root)).read_bytes()
    with pytest.raises(ArgumentError, match="bone patella, not femur"):
        synthesize_bones(root, 1, SMALL)


@pytest.mark.parametrize("wrong", [{"bone": "skull"}, {"turn": "upside down"}])
def test_bones_that_there_are_not(tmp_path, wrong):
    with pytest.raises(ArgumentError, match=next(iter(wrong))):
        synthesize_bones(tmp_path / "set", 1, SMALL, **wrong)


@pytest.mark.parametrize("seed", range(5))
def test_warps_are_smooth_and_fold_nothing(seed):
    """The Jacobian, by differences: its determinant is positive everywhere, and it is not that of an isometry."""
    generator = np.random.default_rng(seed)
    warp, points = Warp.drawn(1.0, generator), generator.uniform(-1, 1, (400, 3))
    step = 1e-5
    columns = [(warp(points + step * axis) - warp(points - step * axis)) / (2 * step) for axis in np.eye(3)]
    jacobians = np.stack(columns, axis=2)
    determinants = np.linalg.det(jacobians)
    assert determinants.min() > 0.1
    stretches = np.linalg.svd(jacobians, compute_uv=False)
    assert stretches[:, 0].mean() > 1.1 > 0.95 > stretches[:, 2].mean()
    np.testing.assert_allclose(warp(points, 0.0), points, atol=1e-12)
    weak = np.linalg.norm(warp(points, 0.1) - points, axis=1)
    strong = np.linalg.norm(warp(points, 1.0) - points, axis=1)
    assert weak.mean() == pytest.approx(strong.mean() / 10, rel=0.2)


def test_turns():
    generator = np.random.default_rng(0)
    assert drawn_turn("none", generator) == [0.0, 0.0, 0.0]
    up = np.array([[0.0, 1.0, 0.0]])
    vertical = [drawn_turn("vertical", generator) for _ in range(20)]
    assert all(np.allclose(turned(up, turn), up) for turn in vertical)
    ways = np.array([turned(up, drawn_turn("any", generator))[0] for _ in range(400)])
    assert np.abs(ways.mean(axis=0)).max() < 0.1
    np.testing.assert_allclose((ways**2).mean(axis=0), 1 / 3, atol=0.05)


def test_a_set_from_one_shape(workshop, ring, tmp_path):
    root = synthesize_organs(ring, tmp_path / "set", 3, SMALL).root
    folder, manifest = ShapeFolder.open(root), json.loads((root / "manifest.json").read_text())
    assert manifest["assets"][0]["asset"] == "ring.ply"
    template = read_shape(root / "template" / "template.off")
    at = np.load(root / "template" / "points.npz", allow_pickle=False)
    rest = Surface(template.points, template.faces)
    points = BarycentricPoints(at["triangles"], at["weights"]).positions(rest)
    size = np.sqrt(trimesh.Trimesh(template.points, template.faces).area)
    for name, body in manifest["bodies"].items():
        shape, build = folder.shape(name), body["build"]
        assert is_one_closed_surface(Surface(shape.points, shape.faces), euler_number=0)
        assert body["crossing_share"] <= MOST_CROSSING
        held = np.load(root / "barycentric" / f"{name}.npz", allow_pickle=False)
        drawn = np.random.default_rng([build["seed"], build["individual"], build["attempt"], 3])
        warped = turned(Warp.drawn(size, drawn)(template.points, body["pose_share"]), build["turn"])
        places = BarycentricPoints(held["triangles"], held["weights"])
        np.testing.assert_allclose(shape.points, places.positions(Surface(warped, template.faces)), atol=1e-3)
        found = folder.template_correspondence(name)
        assert np.linalg.norm(places.positions(rest)[found] - points, axis=1).max() < 0.1 * size
    again = synthesize_organs(ring, tmp_path / "again", 3, SMALL).root
    for file in sorted(root.glob("*/*.off")):
        assert file.read_bytes() == (again / file.relative_to(root)).read_bytes()
    with pytest.raises(ArgumentError, match=r"strength 1\.0, not 0\.5"):
        synthesize_organs(ring, root, 1, SMALL, strength=0.5)


def test_without_strength_and_turn_the_shape_stays(ring):
    organs = Organs(ring, strength=0.0, turn="none")
    points = sample_evenly(organs.template.rest, 100)
    made = make_body(organs, points, SMALL, 0).meshed
    np.testing.assert_allclose(made.mesh.vertices, made.barycentric.positions(organs.template.rest), atol=1e-9)


def test_shapes_that_are_not_one_closed_surface(tmp_path, make):
    ball = make.blob(2)
    two = Shape(
        np.concatenate([ball.points, ball.points + 5]), np.concatenate([ball.faces, ball.faces + ball.n_points])
    )
    wrong = {
        "cloud.ply": (Shape(ball.points), "is a point cloud"),
        "open.ply": (Shape(ball.points, ball.faces[3:]), "has a boundary"),
        "two.ply": (two, "is several closed surfaces"),
    }
    for name, (shape, message) in wrong.items():
        write_shape(tmp_path / name, shape)
        with pytest.raises(ShapeError, match=f"{name} {message}"):
            Organs(tmp_path / name)


def test_triangles_that_look_inward_are_turned(tmp_path, make):
    ball = make.blob(2)
    write_shape(tmp_path / "inward.ply", Shape(ball.points, ball.faces[:, ::-1]))
    assert is_one_closed_surface(Organs(tmp_path / "inward.ply").template.rest)


@pytest.mark.parametrize("strength", [-0.1, 3, float("nan"), "much"])
def test_strengths_out_of_range(ring, tmp_path, strength):
    with pytest.raises(ArgumentError, match="strength"):
        synthesize_organs(ring, tmp_path / "set", 1, SMALL, strength=strength)
