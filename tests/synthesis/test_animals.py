"""Synthetic animals: forms, joints and poses against what must hold of any animal, and whole sets."""

import json
from importlib.resources import files

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from homolog.datasets import ShapeFolder
from homolog.geometry.surface import BarycentricPoints, Surface
from homolog.shapes import read_shape
from homolog.synthesis import Animals, BodySettings, MeshSettings, animals, production, remeshing, synthesize_animals
from homolog.synthesis.animal_forms import individual
from homolog.synthesis.animal_joints import RANGES, bone_turns, mirrored
from homolog.synthesis.animal_parameters import AMOUNTS, BODIES, FACTORS, HEADS, complete, mixed
from homolog.synthesis.animal_poses import FAMILIES, draw_pose
from homolog.synthesis.animal_profiles import profile
from homolog.synthesis.bodies import MOST_CROSSING
from homolog.synthesis.quadruped import Quadruped
from homolog.synthesis.remeshing import is_one_closed_surface
from homolog.synthesis.self_intersections import self_intersection_share
from homolog.synthesis.species import SPECIES


@pytest.fixture(scope="module")
def animal():
    return Quadruped.load()


def test_the_skin_is_one_closed_surface_that_stands_upright_and_looks_ahead(animal):
    assert is_one_closed_surface(animal.surface)
    assert self_intersection_share(animal.surface) < 0.001
    np.testing.assert_allclose(animal.weight.sum(axis=1), 1.0)
    at = dict(zip(animal.bones, animal.pivots, strict=True))
    assert at["skull"][2] > at["torso"][2] > at["pelvis"][2] > at["Ca_21"][2]
    assert at["ear_L"][0] > 0 > at["ear_R"][0]
    assert at["skull"][1] > at["pelvis"][1] > at["toe_L"][1]
    assert (animal.parents < np.arange(len(animal.bones))).all()


def test_every_licence_is_in_the_package():
    folder = files("homolog.synthesis") / "animal_data"
    text = (folder / "LICENSE.md").read_text(encoding="utf-8")
    for name in ("LICENSE-dm_control.txt", "LICENSE-infinigen.txt"):
        assert name in text
        assert (folder / name).is_file()
    assert "quadruped.npz" in text
    assert {asset["package"] for asset in Animals.assets} == {"dm_control", "infinigen"}


def test_without_stretches_and_turns_nothing_moves(animal):
    vertices, pivots, linear = animal.followed(animal.surface.vertices, animal.pivots)
    np.testing.assert_allclose(vertices, animal.surface.vertices, atol=1e-12)
    np.testing.assert_allclose(pivots, animal.pivots, atol=1e-12)
    np.testing.assert_allclose(linear, np.tile(np.eye(3), (len(vertices), 1, 1)), atol=1e-12)


def test_one_turn_of_the_trunk_is_a_rigid_motion_of_everything(animal):
    turn = bone_turns({"rise": 40.0, "heading": 10.0})["torso"]
    vertices, _, _ = animal.followed(animal.surface.vertices, animal.pivots, turns={"torso": turn})
    some = slice(None, None, 200)
    np.testing.assert_allclose(
        cdist(vertices[some], vertices[some]), cdist(animal.surface.vertices[some], animal.surface.vertices[some])
    )


def test_the_same_stretch_of_all_bones_is_a_scaling(animal):
    stretches = np.tile(1.7 * np.eye(3), (len(animal.bones), 1, 1))
    vertices, _, _ = animal.followed(animal.surface.vertices, animal.pivots, stretches=stretches, smooth_rounds=3)
    anchor = animal.pivots[animal.bones.index("torso")]
    np.testing.assert_allclose(vertices, anchor + 1.7 * (animal.surface.vertices - anchor), atol=1e-9)


@pytest.mark.parametrize(
    ("joint", "bone", "axis", "sign"),
    [
        ("left_shoulder", "finger_L", 2, 1),
        ("left_elbow", "finger_L", 2, 1),
        ("left_wrist", "finger_L", 2, -1),
        ("left_hip", "toe_L", 2, 1),
        ("left_knee", "toe_L", 2, -1),
        ("left_hock", "toe_L", 2, 1),
        ("left_hip_abduction", "toe_L", 0, 1),
        ("right_hip_abduction", "toe_R", 0, -1),
        ("rise", "skull", 1, 1),
        ("neck_flexion", "skull", 1, -1),
        ("neck_bend", "skull", 0, 1),
        ("back_flexion", "Ca_1", 1, -1),
        ("back_bend", "Ca_1", 0, 1),
        ("tail_raise", "Ca_21", 1, 1),
    ],
)
def test_joints_move_bones_the_way_that_their_names_say(animal, joint, bone, axis, sign):
    _, pivots, _ = animal.followed(animal.surface.vertices, animal.pivots, turns=bone_turns({joint: 20.0}))
    here = animal.bones.index(bone)
    assert sign * (pivots[here] - animal.pivots[here])[axis] > 0.003


def test_a_mirrored_pose_is_the_mirror_image(animal):
    pose = draw_pose("extreme", np.random.default_rng(0))
    _, straight, _ = animal.followed(animal.surface.vertices, animal.pivots, turns=bone_turns(pose))
    _, other, _ = animal.followed(animal.surface.vertices, animal.pivots, turns=bone_turns(mirrored(pose)))
    swapped = [animal.bones.index(_other_side(bone)) for bone in animal.bones]
    np.testing.assert_allclose(other[swapped], straight * [-1.0, 1.0, 1.0], atol=1e-6)


def _other_side(bone):
    return bone[:-1] + {"L": "R", "R": "L"}[bone[-1]] if bone[-2:] in ("_L", "_R") else bone


@pytest.mark.parametrize("family", FAMILIES)
def test_poses_stay_within_ranges(family):
    pose = draw_pose(family, np.random.default_rng(3))
    assert set(pose) == set(RANGES)
    assert all(RANGES[name][0] <= angle <= RANGES[name][1] for name, angle in pose.items())


@pytest.mark.parametrize("species", SPECIES)
def test_species_stand_on_four_legs_without_passing_through_themselves(animal, species):
    assert set(SPECIES[species]) <= {*FACTORS, *AMOUNTS}
    one = individual(SPECIES[species])
    surface = Surface(one.vertices, animal.surface.faces)
    assert is_one_closed_surface(surface)
    assert self_intersection_share(surface, by_area=True) < MOST_CROSSING / 2
    soles = [one.vertices[animal.share(bone) > 0.5, 1].min() for bone in ("finger_L", "finger_R", "toe_L", "toe_R")]
    assert np.ptp(soles) < 0.03 * np.ptp(one.vertices[:, 1])


def test_proportions_are_those_of_the_animals(animal):
    def of(species, start, end):
        pivots = individual(SPECIES[species]).pivots
        trunk = np.linalg.norm(pivots[animal.bones.index("C_7")] - pivots[animal.bones.index("pelvis")])
        ends = [pivots[animal.bones.index(bone)] for bone in (start, end)]
        return np.linalg.norm(ends[0] - ends[1]) / trunk

    assert of("giraffe", "C_7", "skull") > 2.5 * of("horse", "C_7", "skull") > 2.5 * of("pig", "C_7", "skull")
    assert of("horse", "lower_arm_L", "finger_L") > 2 * of("hippopotamus", "lower_arm_L", "finger_L")


def test_horns_grow_out_of_the_forehead_alone(animal):
    bare, horned = individual({}), individual({"horn_length": 0.2, "horn_side": 10.0, "horn_back": 0.0})
    moved = np.linalg.norm(horned.vertices - bare.vertices, axis=1)
    tip = moved.argmax()
    assert 0.17 < moved[tip] < 0.23
    assert horned.vertices[tip, 1] > bare.vertices[:, 1].max()
    assert (animal.share("skull")[moved > 1e-9] > 0.5).all()


def test_mixtures_lie_between_their_parts():
    both = mixed([SPECIES["horse"], SPECIES["cat"]], [0.5, 0.5])
    horse, cat = complete(SPECIES["horse"]), complete(SPECIES["cat"])
    assert both["size"] == pytest.approx(np.sqrt(horse["size"] * cat["size"]))
    assert both["hoof"] == pytest.approx(0.5)
    assert mixed([horse], [1.0]) == pytest.approx(horse)


def test_forms_of_other_species_are_known(animal):
    assert {*HEADS, *BODIES, "head_carnivore_wolf", "body_feline_wolf"} == set(animal.grids)
    # The wolf's head is the shorter and the wider one of these two, measured in Blender's own units.
    wolf, giraffe = profile("head_carnivore_wolf"), profile("head_herbivore_giraffe")
    assert wolf.length == pytest.approx(0.53, abs=0.02)
    assert giraffe.length > 1.3 * wolf.length
    assert (giraffe.width[-4:] / giraffe.length < wolf.width[-4:] / wolf.length).all()
    assert (wolf.height > 0).all()


@pytest.fixture
def rough(monkeypatch):
    """Small sets of rough meshes."""
    monkeypatch.setattr(production, "TEMPLATE_POINTS", 300)
    monkeypatch.setattr(remeshing, "_ROUNDS", 5)
    return BodySettings(seed=2, mesh=MeshSettings(1200))


@pytest.mark.slow
def test_a_set_has_exact_ground_truth_between_poses_and_individuals(tmp_path, rough):
    root = synthesize_animals(tmp_path / "set", 5, rough).root
    folder = ShapeFolder.open(root)
    template = read_shape(root / "template" / "template.off")
    rest = Surface(template.points, template.faces)
    at = np.load(root / "template" / "points.npz", allow_pickle=False)
    kind, points = Animals(), BarycentricPoints(at["triangles"], at["weights"])
    records = [json.loads((root / "records" / f"{name}.json").read_text()) for name in folder.names]
    assert [record["build"]["individual"] for record in records] == [0, 0, 0, 0, 1]
    assert len({record["family"] for record in records}) == 5
    for name, record in zip(folder.names, records, strict=True):
        shape = folder.shape(name)
        mesh = Surface(shape.points, shape.faces)
        assert is_one_closed_surface(mesh)
        assert self_intersection_share(mesh) <= MOST_CROSSING
        # The surface is made anew from the record alone.
        character = type("Character", (), {"build": record["build"], "angles": record["angles"]})
        body = kind.surface(character)
        assert body.vertices[:, 1].min() == 0.0
        held = np.load(root / "barycentric" / f"{name}.npz", allow_pickle=False)
        places = BarycentricPoints(held["triangles"], held["weights"])
        np.testing.assert_allclose(places.positions(body), shape.points, atol=1e-5)
        found = folder.template_correspondence(name)
        apart = np.linalg.norm(places.positions(rest)[found] - points.positions(rest), axis=1)
        assert np.median(apart) < 0.02
        # Where a form is small, as a short tail is, neighbouring vertices are far apart on the template.
        assert np.percentile(apart, 99) < 0.12


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes_and_another_seed_other_animals(tmp_path, rough):
    first = synthesize_animals(tmp_path / "first", 1, rough)
    animals._individual.cache_clear()
    again = synthesize_animals(tmp_path / "again", 1, rough)
    for relative, path in first.files("animal_00000").items():
        assert path.read_bytes() == again.files("animal_00000")[relative].read_bytes()
    other = synthesize_animals(tmp_path / "other", 1, BodySettings(seed=3, mesh=rough.mesh))
    assert other.record("animal_00000")["build"]["form"] != first.record("animal_00000")["build"]["form"]


def test_the_manifest_names_sources_and_licences(tmp_path, rough):
    root = synthesize_animals(tmp_path / "set", 1, rough).root
    manifest = json.loads((root / "manifest.json").read_text())
    assert {(a["package"], a["version"], a["licence"]) for a in manifest["assets"]} == {
        ("dm_control", "1.0.50", "Apache-2.0"),
        ("infinigen", "1.15.5", "BSD-3-Clause"),
    }
    assert manifest["what"] == "synthetic animals with ground truth, made by homolog synth animals"


@pytest.mark.slow
def test_every_species_comes_first_equally_often():
    kind = Animals()
    firsts = []
    for number in range(2 * len(SPECIES)):
        character = next(kind.characters(0, 4 * number, np.random.default_rng(0)))
        firsts.append(next(iter(character.build["species"])))
        assert sum(character.build["species"].values()) == pytest.approx(1.0)
    assert all(firsts.count(name) == 2 for name in SPECIES)


def test_bumps_tie_off_no_limb(animal):
    for seed in range(20):
        bumps = animals._draw_bumps(np.random.default_rng(seed))
        assert np.abs(bumps).max() < 0.02
        assert np.abs(bumps[animal.share("lower_arm", "lower_leg", "hand", "foot") > 0.99]).max() < 2e-4
    assert bumps.any()
