"""Smooth maps between surfaces: exact where the truth is, better than the point maps that they come from elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from homolog.core.errors import ArgumentError
from homolog.geometry import Surface, unit
from homolog.shapes import Shape
from homolog.transfer import SurfacePoints, SurfaceProjector, Transfer, surface_map


def flipped(found, faces):
    """Which triangles of the start are drawn on the goal's surface with the wrong side out."""
    normals = found.target.normals(found.surface_points)[faces].mean(axis=1)
    laid = Surface(found.positions, faces).face_normals
    return np.einsum("mk,mk->m", laid, normals) <= 0


def test_the_identity_carries_everything_unchanged(make, matched):
    shape = make.blob(3)
    same = np.arange(shape.n_points)
    found = surface_map(shape, shape, matched(shape, shape, same, same))
    np.testing.assert_allclose(found.positions, shape.points, atol=1e-6)
    values = np.random.default_rng(0).normal(size=(shape.n_points, 2))
    np.testing.assert_allclose(found.surface_points.interpolate(values), values, atol=1e-4)
    np.testing.assert_array_equal(found.surface_points.labels(same), same)


@pytest.mark.parametrize("scale", [3.0, 1000.0, 1e-3])
def test_a_moved_copy_is_met_exactly(make, matched, scale):
    shape, turn = make.blob(3), make.rotation(5)
    other = Shape(scale * shape.points @ turn.T + [100.0, 200.0, -50.0], shape.faces)
    same = np.arange(shape.n_points)
    found = surface_map(shape, other, matched(shape, other, same, same))
    np.testing.assert_allclose(found.positions, other.points, atol=1e-5 * scale)
    linear = shape.points @ [0.3, -2.0, 1.0] + 4.0
    back = surface_map(other, shape, matched(other, shape, same, same))
    np.testing.assert_allclose(back.surface_points.interpolate(linear), linear, atol=1e-4)


def test_smooth_maps_are_nearer_to_the_truth_than_point_maps(pair):
    truth = pair.bend(pair.source.points)
    found = surface_map(pair.source, pair.target, pair.found)
    by_points = pair.target.points[pair.found.source_to_target]
    before, after = (np.linalg.norm(where - truth, axis=1).mean() for where in (by_points, found.positions))
    assert after < 0.5 * before
    assert flipped(found, pair.source.faces).mean() == 0
    assert found.orientation == 1


def test_wrong_patches_give_way(pair, matched):
    truth = pair.bend(pair.source.points)
    there, back = pair.found.source_to_target.copy(), pair.found.target_to_source.copy()
    rng = np.random.default_rng(0)
    wrong = rng.choice(len(there), len(there) // 10, replace=False)
    there[wrong] = rng.permutation(there[wrong])
    back[rng.choice(len(back), len(back) // 10, replace=False)] = 7
    found = surface_map(pair.source, pair.target, matched(pair.source, pair.target, there, back))
    errors = np.linalg.norm(found.positions - truth, axis=1)
    before = np.linalg.norm(pair.target.points[there] - truth, axis=1)
    assert before[wrong].mean() > 1.0
    # Those to whom 250 points of the other shape point stay wrong.
    assert np.median(errors[wrong]) < 0.04 and errors.mean() < 0.1 * before.mean()
    assert flipped(found, pair.source.faces).mean() < 0.01


def test_pairs_count_by_their_confidence(pair):
    """One of the two maps is wrong all over, as if turned about the vertical axis; confidences say which."""
    truth, turn = pair.bend(pair.source.points), np.array([[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]])
    right = pair.found
    turned = cKDTree(pair.target.points).query(pair.bend(pair.source.points @ turn.T))[1]
    wrong = np.linalg.norm(pair.target.points[turned] - truth, axis=1).mean()
    errors = []
    for there, back in ((0.05, 1.0), (1.0, 0.05)):
        confidences = {
            "source_confidence": np.full(pair.source.n_points, there),
            "target_confidence": np.full(pair.target.n_points, back),
        }
        found = surface_map(pair.source, pair.target, replace(right, source_to_target=turned, **confidences))
        errors.append(np.linalg.norm(found.positions - truth, axis=1).mean())
    assert errors[0] < 0.1 * wrong and errors[1] > 0.8 * wrong


def test_points_without_a_counterpart_have_no_place(pair, matched):
    there, back = pair.found.source_to_target.copy(), pair.found.target_to_source.copy()
    lost = pair.source.points[:, 1] > 0.5
    there[lost] = -1
    back[np.isin(back, np.flatnonzero(lost))] = -1
    found = surface_map(pair.source, pair.target, matched(pair.source, pair.target, there, back))
    np.testing.assert_array_equal(found.surface_points.valid, ~lost)
    assert np.isnan(found.positions[lost]).all()
    assert (found.surface_points.faces[lost] == -1).all()
    truth = pair.bend(pair.source.points)
    assert np.linalg.norm(found.positions - truth, axis=1)[~lost].max() < 0.25
    values = found.surface_points.interpolate(pair.target.points)
    np.testing.assert_array_equal(np.isnan(values).any(axis=1), lost)
    assert (found.surface_points.labels(np.arange(pair.target.n_points))[lost] == -1).all()


@pytest.mark.parametrize(("start_is_cloud", "goal_is_cloud"), [(True, False), (False, True), (True, True)])
def test_clouds(pair, start_is_cloud, goal_is_cloud):
    source = pair.source.as_cloud() if start_is_cloud else pair.source
    target = pair.target.as_cloud() if goal_is_cloud else pair.target
    found = surface_map(source, target, pair.found)
    assert found.orientation == 0
    truth = pair.bend(pair.source.points)
    before = np.linalg.norm(pair.target.points[pair.found.source_to_target] - truth, axis=1).mean()
    assert np.linalg.norm(found.positions - truth, axis=1).mean() < 0.75 * before
    assert (found.surface_points.faces is None) == goal_is_cloud
    np.testing.assert_allclose(found.surface_points.weights.sum(axis=1), 1.0)


def test_faces_that_turn_the_other_way_are_noticed(pair):
    inside_out = Shape(pair.target.points, pair.target.faces[:, ::-1])
    found = surface_map(pair.source, inside_out, pair.found)
    assert found.orientation == -1
    right_way = surface_map(pair.source, pair.target, pair.found)
    np.testing.assert_allclose(found.positions, right_way.positions, atol=1e-6)


def test_indices_are_those_of_the_shapes_as_given(make, matched):
    """Triangles that share no points, points that no face uses, and a broken face first."""
    shape = make.blob(2)
    corners = shape.faces.ravel()
    points = np.concatenate([[[9.0, 9.0, 9.0], [np.nan] * 3], shape.points[corners]])
    soup = Shape(points, np.concatenate([[[0, 0, 1]], np.arange(len(corners)).reshape(-1, 3) + 2]))
    there = np.concatenate([[-1, -1], corners])
    _, first = np.unique(corners, return_index=True)
    found = surface_map(soup, shape, matched(soup, shape, there, first + 2))
    np.testing.assert_allclose(found.positions[2:], shape.points[corners], atol=1e-6)
    assert not found.surface_points.valid[:2].any()
    back = surface_map(shape, soup, matched(shape, soup, first + 2, there))
    assert back.surface_points.corners.min() >= 2 and back.surface_points.faces.min() >= 1
    np.testing.assert_array_equal(soup.faces[back.surface_points.faces], back.surface_points.corners)
    np.testing.assert_allclose(back.positions, shape.points, atol=1e-6)


def test_places_amid_the_start_go_continuously(pair):
    found = surface_map(pair.source, pair.target, pair.found)
    rng = np.random.default_rng(1)
    faces = rng.integers(pair.source.n_faces, size=500)
    weights = rng.dirichlet([1.0, 1.0, 1.0], size=500)
    places = SurfacePoints(pair.source.faces[faces], weights, faces)
    truth = pair.bend(places.interpolate(pair.source.points))
    assert np.linalg.norm(found.target.positions(found.apply(places)) - truth, axis=1).max() < 0.1
    # At its corners a triangle's places are those of its points.
    corners = SurfacePoints(pair.source.faces[faces], np.tile([0.0, 1.0, 0.0], (500, 1)), faces)
    of_points = found.positions[pair.source.faces[faces, 1]]
    np.testing.assert_allclose(found.target.positions(found.apply(corners)), of_points, atol=1e-6)
    nowhere = places.masked(np.arange(500) > 0)
    np.testing.assert_array_equal(found.apply(nowhere).valid, np.arange(500) > 0)


def test_the_far_side_of_a_thin_sheet_is_not_taken(make, matched):
    """Both sides lie within the error of the point maps."""
    ball = make.sphere(4)
    subsample = Shape(ball.points * [1.0, 1.0, 0.004], ball.faces)
    rng = np.random.default_rng(0)
    sides = np.sign(subsample.points[:, 2])
    jittered = subsample.points + 0.02 * rng.normal(size=subsample.points.shape) * [1, 1, 0]
    upper, lower = np.flatnonzero(sides >= 0), np.flatnonzero(sides < 0)
    there = np.empty(subsample.n_points, dtype=int)
    for side in (upper, lower):
        away = np.linalg.norm(jittered[side, None] - subsample.points[None, side], axis=2)
        there[side] = side[away.argmin(axis=1)]
    found = surface_map(subsample, subsample, matched(subsample, subsample, there, there))
    flat = np.abs(subsample.points[:, 2]) > 0.003
    assert (np.sign(found.positions[flat, 2]) == sides[flat]).mean() > 0.99


def test_places_on_a_cloud_meet_its_points(make):
    cloud = make.blob(2).as_cloud()
    projector = SurfaceProjector(cloud)
    at_points = projector.project(cloud.points)
    values = np.random.default_rng(0).normal(size=cloud.n_points)
    np.testing.assert_allclose(at_points.interpolate(values), values, atol=1e-9)
    between = projector.project(unit(np.random.default_rng(1).normal(size=(50, 3))))
    assert between.weights.min() >= 0
    np.testing.assert_allclose(between.weights.sum(axis=1), 1.0)
    np.testing.assert_allclose(between.interpolate(np.full(cloud.n_points, 3.0)), 3.0)


def test_labels_have_the_largest_weight_together():
    places = SurfacePoints(
        np.array([[0, 1, 2], [0, 1, 2], [0, 0, 0]]), np.array([[0.4, 0.3, 0.3], [0.5, 0.3, 0.2], [np.nan] * 3])
    )
    np.testing.assert_array_equal(places.labels(np.array([5, 7, 7])), [7, 5, -1])
    with pytest.raises(ArgumentError, match="at least 3"):
        places.labels(np.array([5, 7]))


def test_a_value_that_counts_nothing_may_be_unknown():
    places = SurfacePoints(np.array([[0, 1, 2]]), np.array([[0.5, 0.5, 0.0]]))
    np.testing.assert_array_equal(places.interpolate(np.array([1.0, 3.0, np.nan])), [2.0])
    assert np.isnan(places.interpolate(np.array([1.0, np.nan, 3.0]))).all()


def test_other_maps_are_refused(pair, matched, make):
    with pytest.raises(ArgumentError, match="those of"):
        surface_map(make.blob(1), pair.target, pair.found)
    nowhere = np.full(pair.source.n_points, -1), np.full(pair.target.n_points, -1)
    nothing = matched(pair.source, pair.target, *nowhere)
    with pytest.raises(ArgumentError, match="no point of"):
        surface_map(pair.source, pair.target, nothing)


def test_places_on_long_triangles(make):
    """A box of twelve triangles beside a fine ball, whose points are nearer than the corners of the box."""
    box = np.array([[x, y, z] for x in (0.0, 10) for y in (0.0, 10) for z in (0.0, 1)])
    corners = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    faces = np.array([*corners, [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])
    ball = make.sphere(3)
    both = make.joined([Shape(box, faces), Shape(0.5 * ball.points + [5.0, 5.0, 2.0], ball.faces)])
    points = np.random.default_rng(0).uniform([1.0, 1.0, 1.0], [9.0, 9.0, 1.1], size=(200, 3))
    projector = SurfaceProjector(both)
    found = projector.project(points)
    near = np.linalg.norm(points - [5.0, 5.0, 2.0], axis=1) - 0.5 < points[:, 2] - 1 + 0.01
    np.testing.assert_allclose(projector.positions(found)[~near], (points * [1, 1, 0] + [0, 0, 1.0])[~near], atol=1e-9)
    assert np.isin(found.faces[~near], [10, 11]).all()


def test_the_label_of_points_without_a_counterpart_is_no_label_of_the_source(make, matched):
    shape = make.blob(2)
    same = np.arange(shape.n_points)
    there = np.where(same < 20, -1, same)
    transfer = Transfer(matched(shape, shape, there, there))
    for labels, none in ((same % 3, -1), (same % 3 - 1, -2), (same % 3 - 4, -1), (same % 5 - 3, -4)):
        found = transfer.labels(labels)
        np.testing.assert_array_equal(found[20:], labels[20:])
        assert (found[:20] == none).all()


@pytest.mark.parametrize("kind", ["<f2", "g", ">i4", "?"])
def test_values_of_any_type_and_infinite_ones_are_interpolated(make, recwarn, kind):
    cloud = make.blob(2).as_cloud()
    places = SurfaceProjector(cloud).project(cloud.points)
    values = (np.arange(cloud.n_points * 2) % 2).astype(kind).reshape(-1, 1, 2)
    np.testing.assert_allclose(places.interpolate(values), values.astype(float), atol=1e-9)
    assert np.isinf(places.interpolate(np.full((cloud.n_points, 2), np.inf))).all()
    assert np.isinf(places.interpolate(np.full(cloud.n_points, np.longdouble("1e4000")))).all()
    assert not recwarn.list


def test_what_has_no_counterpart_follows_the_rest_and_loose_parts_move_with_it_as_one_body(make, matched):
    """A cap of the blob and a ball beside it are not matched; all of it is moved, turned and made larger."""
    blob, ball = make.blob(3), make.sphere(1)
    source = make.joined([blob, Shape(0.2 * ball.points + [0, 2.5, 0], ball.faces)])
    points = 2 * source.points @ make.rotation(3).T + [5.0, 6, 7]
    target = Shape(points[: blob.n_points], blob.faces)
    known = np.append(blob.points[:, 1] < 0.8, np.zeros(ball.n_points, dtype=bool))
    same = np.arange(source.n_points)
    back = np.where(known, same, -1)[: blob.n_points]
    found = surface_map(source, target, matched(source, target, np.where(known, same, -1), back))
    assert np.isnan(found.positions[~known]).all()
    np.testing.assert_allclose(found.positions[known], points[known], atol=1e-4)
    np.testing.assert_allclose(found.extended[~known], points[~known], atol=1e-2)
