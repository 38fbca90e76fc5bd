"""Parts of people, cut from the body model: joints of hands, expressions, lids, and whole sets of both kinds."""

import json

import numpy as np
import pytest
import trimesh
from stand_in import PartStandIn, hand_skeleton, sphere
from test_people import anny_is_ready

import homolog
from homolog.core.errors import ArgumentError
from homolog.datasets import ShapeFolder
from homolog.geometry.surface import BarycentricPoints, Surface
from homolog.shapes import read_shape
from homolog.synthesis import (
    BodySettings,
    Hands,
    Heads,
    MeshSettings,
    expressions,
    hand_joints,
    make_body,
    production,
    remeshing,
    synthesize_hands,
    synthesize_heads,
)
from homolog.synthesis.bodies import MOST_CROSSING
from homolog.synthesis.creases import without_creases
from homolog.synthesis.remeshing import is_one_closed_surface
from homolog.synthesis.self_intersections import self_intersecting_faces, self_intersection_share
from homolog.synthesis.template import Template, boundary_loops, sample_evenly

SMALL = BodySettings(seed=3, mesh=MeshSettings(700))
KINDS = [(synthesize_hands, Hands, "hand"), (synthesize_heads, Heads, "head")]
FINGERTIP = np.array([0.0, 1.0, 0.0])
TO_THUMB, OUT_OF_PALM = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, -1.0])


@pytest.fixture
def workshop(monkeypatch):
    """Sets of stand-ins."""
    monkeypatch.setattr(production, "_body_model", PartStandIn)
    monkeypatch.setattr(production, "TEMPLATE_POINTS", 200)
    monkeypatch.setattr(remeshing, "_ROUNDS", 4)  # rough meshes do, and soon


@pytest.mark.parametrize("family", hand_joints.FAMILIES)
def test_poses_of_hands_stay_within_ranges(family):
    pose = hand_joints.draw_pose(family, np.random.default_rng(1))
    assert set(pose) == set(hand_joints.RANGES)
    assert all(low <= pose[name] <= high for name, (low, high) in hand_joints.RANGES.items())


def test_families_name_joints_that_there_are():
    known = {*hand_joints.RANGES, *(name.partition("_")[2] for name in hand_joints.RANGES)}
    assert all(set(family) <= known for family in hand_joints.FAMILIES.values())
    actions = {name.removesuffix("Left").removesuffix("Right") for name in expressions.ACTIONS}
    sides = {"jaw", "mouth"}  # jawLeft and mouthLeft move to a side, and are no action of one side
    assert all(set(family) <= {*expressions.ACTIONS, *actions} - sides for family in expressions.FAMILIES.values())


def test_the_frame_of_a_hand_has_the_thumb_the_fingers_and_the_back():
    np.testing.assert_allclose(hand_joints.hand_frame(hand_skeleton()), np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ("joint", "bone", "towards"),
    [
        ("index_knuckle", "finger2-1.L", OUT_OF_PALM),
        ("little_middle_joint", "finger5-2.L", OUT_OF_PALM),
        ("ring_last_joint", "finger4-3.L", OUT_OF_PALM),
        ("middle_spread", "finger3-1.L", TO_THUMB),
        ("index_spread", "finger2-1.L", TO_THUMB),
        ("thumb_spread", "finger1-1.L", TO_THUMB),
    ],
)
def test_joints_move_fingers_the_way_that_their_names_say(joint, bone, towards):
    turned = hand_joints.bone_rotations({**hand_joints.AT_REST, joint: 20.0}, hand_skeleton())
    moved = turned.pop(bone) @ FINGERTIP - FINGERTIP
    assert moved @ towards == pytest.approx(np.sin(np.deg2rad(20)), abs=0.03)
    assert all(np.allclose(rotation, np.eye(3)) for rotation in turned.values())


def test_opposition_takes_the_thumb_across_the_palm():
    turned = hand_joints.bone_rotations({**hand_joints.AT_REST, "thumb_opposition": 30.0}, hand_skeleton())
    outwards = np.array([1.0, 0.0, -0.3])
    moved = turned["finger1-1.L"] @ outwards - outwards
    assert moved @ OUT_OF_PALM > 0.3
    assert moved @ TO_THUMB < -0.2


@pytest.mark.parametrize("family", expressions.FAMILIES)
def test_expressions_use_no_more_than_is_allowed(family):
    for seed in range(20):
        drawn = expressions.draw_expression(family, np.random.default_rng(seed))
        assert set(drawn) == {*expressions.NECK, *expressions.ACTIONS}
        assert all(0 <= drawn[name] <= most for name, most in expressions.ACTIONS.items())
        assert all(low <= drawn[name] <= high for name, (low, high) in expressions.NECK.items())


def test_the_neck_turns_the_head():
    turns = expressions.turns({**expressions.AT_REST, "neck_rotation": 20.0})
    total = np.linalg.multi_dot([turns[bone] for bone in ("neck01", "neck02", "neck03", "head")])
    np.testing.assert_allclose(total @ [0, 0, 1], [np.sin(np.deg2rad(20)), 0, np.cos(np.deg2rad(20))], atol=1e-12)


def test_a_crease_is_smoothed_and_what_may_not_move_stays():
    vertices, faces = sphere(3)
    dented = vertices.copy()
    dent = np.linalg.norm(vertices - [0, 1, 0], axis=1) < 0.12
    dented[dent] += [0.03, -2.1, 0.05]  # through the other side
    surface = Surface(dented, faces)
    assert self_intersecting_faces(surface).any()
    around = np.linalg.norm(vertices - [0, 1, 0], axis=1) < 0.6
    smooth = without_creases(surface, around)
    assert not self_intersecting_faces(smooth).any()
    np.testing.assert_array_equal(smooth.vertices[~around], dented[~around])
    stiff = without_creases(surface, np.zeros(len(vertices), dtype=bool))
    np.testing.assert_array_equal(stiff.vertices, dented)


def test_the_lid_closes_the_longest_hole():
    vertices, faces = sphere(3)
    heights = vertices[faces][:, :, 1]
    outer = faces[((heights > -0.6) & (heights < 0.9)).all(axis=1)]
    template = Template.of_outer_faces(outer, vertices, np.ones(len(vertices)), cut=True)
    assert len(template.rims) == 2
    assert (template.rest.vertices[template.faces[template.lid]][:, :, 1] < -0.4).all()
    without = np.delete(template.faces, template.lid, axis=0)
    assert len(boundary_loops(without)) == 1
    points = sample_evenly(template.rest, 300, without=template.lid)
    assert not np.isin(points.triangles, template.lid).any()
    assert len(Template.of_outer_faces(outer, vertices, np.ones(len(vertices))).lid) == 0


def test_an_opened_mesh_ends_exactly_where_it_was_cut():
    hands = Hands(PartStandIn())
    points = sample_evenly(hands.template.rest, 200, without=hands.template.lid)
    body = make_body(hands, points, SMALL, 1)
    assert body.character.opened
    mesh, places = body.meshed.mesh, body.meshed.barycentric
    (loop,) = boundary_loops(mesh.faces)
    rim = hands.template.rims[0]
    corners = np.take_along_axis(
        hands.template.faces[places.triangles[loop]], np.argsort(-places.weights[loop]), axis=1
    )
    assert np.isin(corners[:, :2], rim).all(axis=1).mean() > 0.9
    assert np.isin(corners[:, 0], rim).all()
    assert not np.isin(places.triangles, hands.template.lid).any()
    # Vertices follow each other around the rim, and none goes back.
    around = np.unwrap(np.arctan2(*mesh.vertices[loop][:, [2, 0]].T))
    assert len(set(np.sign(np.diff(around)))) == 1


@pytest.mark.parametrize(("synthesize", "kind", "stem"), KINDS)
def test_a_set_has_exact_ground_truth_and_open_and_closed_meshes(tmp_path, workshop, synthesize, kind, stem):
    root = synthesize(tmp_path / "set", 6, SMALL).root
    folder = ShapeFolder.open(root)
    assert folder.names == tuple(f"{stem}_{i:05d}" for i in range(6))
    template = read_shape(root / "template" / "template.off")
    rest = Surface(template.points, template.faces)
    assert is_one_closed_surface(rest)
    at = np.load(root / "template" / "points.npz", allow_pickle=False)
    points = BarycentricPoints(at["triangles"], at["weights"]).positions(rest)
    bodies = json.loads((root / "manifest.json").read_text())["bodies"]
    assert [body["build"]["individual"] for body in bodies.values()] == [0, 0, 0, 0, 1, 1]
    for i, (name, body) in enumerate(bodies.items()):
        shape = folder.shape(name)
        assert trimesh.Trimesh(shape.points, shape.faces, process=False).volume > 0
        assert len(boundary_loops(shape.faces)) == i % 2
        held = np.load(root / "barycentric" / f"{name}.npz", allow_pickle=False)
        places = BarycentricPoints(held["triangles"], held["weights"]).positions(rest)
        # Stand-ins are the template made taller, and right hands are mirrored.
        height = (0.5 + 0.5 * body["build"]["body"]["height"]) / 0.75
        side = -1.0 if body["build"].get("side") == "right" else 1.0
        np.testing.assert_allclose(shape.points, places * [1.0, height, side], atol=2e-5)
        found = folder.template_correspondence(name)
        assert np.linalg.norm(places[found] - points, axis=1).max() < 0.12
    assert kind.assets[-1]["licence"] == "CC0-1.0"


@pytest.mark.slow
def test_sides_of_hands(workshop, tmp_path):
    def of(sides):
        made = synthesize_hands(tmp_path / sides, 5, SMALL, sides=sides)
        return [made.record(f"hand_{i:05d}")["build"]["side"] for i in range(5)]

    assert of("both") == ["left"] * 4 + ["right"]
    assert of("left") == ["left"] * 5
    assert of("right") == ["right"] * 5
    with pytest.raises(ArgumentError, match="sides"):
        synthesize_hands(tmp_path / "set", 1, SMALL, sides="upper")
    with pytest.raises(ArgumentError, match="sides both, not left"):
        synthesize_hands(tmp_path / "both", 1, SMALL, sides="left")


@pytest.mark.parametrize(("synthesize", "kind", "stem"), KINDS)
def test_the_same_seed_gives_the_same_bytes(tmp_path, workshop, synthesize, kind, stem):
    first, again = (synthesize(tmp_path / name, 2, SMALL) for name in ("first", "again"))
    for i in range(2):
        for relative, path in first.files(f"{stem}_{i:05d}").items():
            assert path.read_bytes() == again.files(f"{stem}_{i:05d}")[relative].read_bytes()
    other = synthesize(tmp_path / "other", 1, BodySettings(seed=4, mesh=SMALL.mesh))
    assert other.record(f"{stem}_00000")["build"]["changes"] != first.record(f"{stem}_00000")["build"]["changes"]


def test_fingers_of_individuals_differ_in_size(workshop):
    model = PartStandIn()
    hands = Hands(model)
    character = next(hands.characters(0, 0, np.random.default_rng(0)))
    assert len(hands.template.lid)
    hands.surface(character)
    _, linear, changes, _ = model.seen[-1]
    for finger, size in character.build["fingers"].items():
        assert np.linalg.det(linear[f"finger{finger}-1.L"]) == pytest.approx(size**3)
    assert changes == character.build["changes"]
    assert {name for name in linear if name.startswith("metacarpal")} == {f"metacarpal{i}.L" for i in range(1, 5)}


def test_the_sides_of_a_face_are_nearly_alike():
    kind = Heads(PartStandIn())
    changes = next(kind.characters(0, 0, np.random.default_rng(0))).build["changes"]
    assert set(changes) == {"l-ear-scale-incr", "r-ear-scale-incr", "nose-hump-incr"}
    assert changes["l-ear-scale-incr"] == pytest.approx(changes["r-ear-scale-incr"], abs=0.2)


@pytest.mark.bodies
@pytest.mark.skipif(not anny_is_ready(), reason="anny's data are not prepared; HOMOLOG_BODIES=1 does so, in minutes")
@pytest.mark.parametrize(("synthesize", "kind", "stem"), KINDS)
def test_real_hands_and_heads(tmp_path, synthesize, kind, stem):
    pytest.importorskip("anny")
    settings = BodySettings(seed=1, mesh=MeshSettings(2500))
    folder = synthesize(tmp_path / "set", 2, settings)
    again = synthesize(tmp_path / "again", 1, settings)
    for relative, path in again.files(f"{stem}_00000").items():
        assert path.read_bytes() == folder.files(f"{stem}_00000")[relative].read_bytes()
    shapes = ShapeFolder.open(folder.root)
    for i, name in enumerate(shapes.names):
        shape = shapes.shape(name)
        assert self_intersection_share(Surface(shape.points, shape.faces)) <= MOST_CROSSING
        assert len(boundary_loops(shape.faces)) == i
        assert shape.n_points == pytest.approx(2500, rel=0.08)
        assert 0.05 < np.ptp(shape.points[:, 1]) < 0.4
        # The cut is at the bottom, and what belongs to it stands above.
        assert shape.points[:, 1].mean() > 0.02
    if len(shapes.names) > 1:
        match = homolog.match(*map(shapes.shape, shapes.names))
        assert match.report["choice"][0]["name"] == kind.name
