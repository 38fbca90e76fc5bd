"""Fitting articulated models: against differences and known parameters; with anny, where its data are ready."""

import json

import numpy as np
import pytest
from articulated_stand_in import Worm, faulty_maps, scan_of, wormlike
from scipy.spatial.transform import Rotation
from test_people import anny_is_ready

import homolog as package
from homolog.core.errors import ArgumentError, DataError, ShapeError
from homolog.fitting import Fit, Goal, PeopleModel, fit_to_match, fitted, read_fit, write_fit
from homolog.fitting.articulated import _Problem
from homolog.matching import Match
from homolog.shapes import Shape
from homolog.synthesis import BodyModel, BodySettings, People, make_body
from homolog.synthesis.joints import bone_rotations
from homolog.synthesis.template import sample_evenly


@pytest.fixture(scope="module")
def worm(make):
    return Worm(make.blob(3))


@pytest.fixture(scope="module")
def truth():
    return wormlike()


@pytest.fixture(scope="module")
def scan(worm, truth):
    return scan_of(worm, truth)


def test_derivatives_are_differences(worm, truth):
    rows = np.arange(0, worm.shares.shape[0], 5)
    problem = _Problem(worm, Goal(rows, truth.points(worm)[rows], np.ones(len(rows))), free_scale=True)
    pose = worm.pose(truth.build, truth.rotations, rows)
    jacobian = problem._jacobian(truth, pose)
    here, step = truth.points(worm)[rows], 1e-6
    for unknown in range(9):
        turns = step * np.eye(9)[unknown].reshape(3, 3)
        rotations = problem._turned(truth.rotations, pose.turns, turns)
        there = Fit(truth.build, rotations, truth.shift).points(worm)[rows]
        np.testing.assert_allclose(jacobian[:, :, unknown], (there - here) / step, atol=1e-5)
    for number in range(2):
        there = Fit(truth.build + step * np.eye(2)[number], truth.rotations, truth.shift).points(worm)[rows]
        np.testing.assert_allclose(jacobian[:, :, 9 + number], (there - here) / step, atol=1e-5)
    np.testing.assert_array_equal(jacobian[:, :, 11:14], np.tile(np.eye(3), (len(rows), 1, 1)))
    there = Fit(truth.build, truth.rotations, truth.shift, scale=np.exp(step)).points(worm)[rows]
    np.testing.assert_allclose(jacobian[:, :, 14], (there - here) / step, atol=1e-5)


def test_known_points_give_known_parameters(worm, truth):
    points = truth.points(worm)
    goal = Goal(np.arange(len(points)), points, np.ones(len(points)), reach=1.0, stiffness=1e-7)
    start = Fit(np.full(2, 0.5), np.tile(Rotation.from_rotvec([0, 0, 2.0]).as_matrix(), (4, 1, 1)), points.mean(axis=0))
    start.rotations[1:] = np.eye(3)
    found = fitted(worm, start, goal, steps=40)
    np.testing.assert_allclose(found.points(worm), points, atol=1e-3)
    np.testing.assert_allclose(found.build, truth.build, atol=0.01)
    np.testing.assert_allclose(found.rotations, truth.rotations, atol=0.01)


def test_a_scan_in_centimetres_turned_over_by_a_map_with_faults(worm, truth, scan):
    shape, order = scan
    there, back = faulty_maps(order)
    told = []
    found = fit_to_match(
        Match(worm.template, shape, there, back, method="a"), worm, progress=lambda done, total, what: told.append(what)
    )
    assert found.unit == "cm" and found.units_per_metre == 100
    away = np.linalg.norm(found.registered.points - 100 * truth.points(worm), axis=1)
    assert away.mean() < 0.3, away.mean()
    assert abs(found.parameters["height"] - 0.3) < 0.05 and abs(found.parameters["width"] - 0.9) < 0.05
    assert found.distances.mean() < 0.2 and found.warnings == () and set(found.bones) == {"low", "middle", "high"}
    assert told[0] == "fit along the map" and told[-1] == "fit to the surface"


@pytest.mark.parametrize("as_cloud", [False, True])
def test_what_a_partial_scan_lacks_follows_from_the_model(worm, truth, scan, as_cloud):
    """Of one side of it, whose triangles face inward, in centimetres: nothing of the other side is drawn there."""
    shape, order = scan
    visible = worm.rest[:, 2] > -0.02
    kept = np.flatnonzero(visible[order])
    place = np.full(len(order), -1)
    place[kept] = np.arange(len(kept))
    faces = shape.faces[(place[shape.faces] >= 0).all(axis=1)]
    part = Shape(shape.points[kept], None if as_cloud else place[faces])
    there, back = place[np.argsort(order)], order[kept]
    found = fit_to_match(Match(worm.template, part, there, back, method="a"), worm)
    np.testing.assert_array_equal(found.seen, visible)
    away = np.linalg.norm(found.registered.points - 100 * truth.points(worm), axis=1)
    assert found.unit == "cm" and away[visible].mean() < 0.5 and away[~visible].mean() < 1.5, away.mean()
    assert found.mean_distance < 0.005 < found.distances.mean() / 100 and found.warnings == ()


def test_a_cloud_in_a_unit_of_its_own(worm, truth, scan):
    shape, order = scan
    small = Shape(7.3 * shape.points / 100)
    there, back = faulty_maps(order)
    found = fit_to_match(Match(worm.template, small, there, back, method="a"), worm)
    assert found.unit == "free"
    away = np.linalg.norm(found.registered.points - 7.3 * truth.points(worm), axis=1) / 7.3
    assert away.mean() < 0.02, away.mean()


def test_mistakes_are_told(worm, scan):
    shape, order = scan
    there, back = faulty_maps(order)
    with pytest.raises(ArgumentError, match="no match of the model's template"):
        fit_to_match(Match(shape, shape, there, back, method="a"), worm)
    with pytest.raises(ArgumentError, match="unit"):
        fit_to_match(Match(worm.template, shape, there, back, method="a"), worm, unit="ell")
    none = np.full(len(order), -1)
    with pytest.raises(ShapeError, match="0 of its points have a counterpart on the body model, but at least 100"):
        fit_to_match(Match(worm.template, shape, none, none, method="a"), worm)
    few = np.where(np.isin(there, there[:5]), there, -1), np.where(np.arange(len(back)) < 5, back, -1)
    with pytest.raises(ShapeError, match="give a scan with more points"):  # however many of the model lead there
        fit_to_match(Match(worm.template, shape, *few, method="a"), worm)
    wrong = fit_to_match(Match(worm.template, shape, np.roll(there, 300), -1 + 0 * back, method="a"), worm)
    assert any("from the scan on average" in warning for warning in wrong.warnings)


def test_files_go_round(worm, scan, tmp_path):
    shape, order = scan
    found = fit_to_match(Match(worm.template, shape, *faulty_maps(order), method="a"), worm)
    paths = write_fit(tmp_path / "fit", found)
    assert [path.name for path in paths] == ["parameters.json", "registered.ply", "distances.npy"]
    fit, per_metre = read_fit(tmp_path / "fit", worm)
    np.testing.assert_allclose(per_metre * fit.points(worm), found.registered.points, atol=1e-9)
    np.testing.assert_allclose(package.read_shape(paths[1]).points, found.registered.points, atol=1e-4)
    np.testing.assert_array_equal(np.load(paths[2]), found.distances)
    content = json.loads(paths[0].read_text())
    assert content["unit"] == "cm" and content["distance"]["mean"] < 0.2
    for change, told in (
        ({"parameters": {"height": 0.5}}, "of another model"),
        ({"bones": {"low": [0, 1.0]}}, "damaged"),
        ({"shift": "far"}, "damaged"),
    ):
        paths[0].write_text(json.dumps(content | change))
        with pytest.raises(DataError, match=told):
            read_fit(tmp_path / "fit", worm)


@pytest.mark.bodies
@pytest.mark.skipif(not anny_is_ready(), reason="anny's data are not prepared; HOMOLOG_BODIES=1 does so")
def test_a_synthetic_body_is_recovered_from_its_own_surface():
    """A body of seed 5, remeshed and turned; the model is the one that made it."""
    pytest.importorskip("anny")
    anny_model = BodyModel()
    people, model = People(anny_model), PeopleModel(anny_model)
    body = make_body(people, sample_evenly(people.template.rest, 300), BodySettings(seed=5), 1)
    truth, turn = people.surface(body.character).vertices, Rotation.random(random_state=1).as_matrix()
    rotations = np.tile(np.eye(3), (len(model.bones), 1, 1))
    for bone, rotation in bone_rotations(body.character.angles, anny_model.skeleton).items():
        rotations[model.bones.index(bone)] = rotation
    known = Fit(np.array([body.character.build[name] for name in model.parameters]), rotations, np.zeros(3))
    away = known.points(model) - truth
    np.testing.assert_allclose(away, np.tile(away.mean(axis=0), (len(away), 1)), atol=1e-6)
    mesh = body.meshed.mesh
    found = package.fitting.fit_body(Shape(1000 * mesh.vertices @ turn.T, mesh.faces), model=model, weights="people")
    assert found.unit == "mm"
    assert np.linalg.norm(found.registered.points - 1000 * truth @ turn.T, axis=1).mean() < 5
