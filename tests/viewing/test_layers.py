"""Colours and numbers, against direct computation."""

from dataclasses import replace

import numpy as np
import pytest

from homolog.datasets import Truth
from homolog.evaluation import geodesic_errors
from homolog.features import DiffusionNet, NetworkSettings
from homolog.matching import Match, Matcher
from homolog.viewing import Ramp, confidence_layer, error_layer, feature_layer, map_errors, pair_features
from homolog.viewing.colours import UNKNOWN, principal_colours


def test_ramp():
    ramp = Ramp(((0, 0, 0), (100, 200, 50), (200, 0, 250)), 1.0, 3.0)
    found = ramp.colours(np.array([0.0, 1.0, 1.5, 2.0, 3.0, 9.0, np.nan]))
    expected = [[0, 0, 0], [0, 0, 0], [50, 100, 25], [100, 200, 50], [200, 0, 250], [200, 0, 250], UNKNOWN]
    assert found.tolist() == [list(colour) for colour in expected]


def test_principal_colours_follow_the_principal_components():
    """Features that lie along three known directions of falling variance, in another basis."""
    rng = np.random.default_rng(0)
    basis = np.linalg.qr(rng.standard_normal((8, 8)))[0]
    hidden = np.zeros((400, 8))
    hidden[:, 0] = 100.0  # all rows are about as long, so that their directions hardly bend the rest
    hidden[:, 1:4] = rng.standard_normal((400, 3)) * [3, 2, 1]
    source, target = principal_colours(*np.split(hidden @ basis, 2))
    colours = np.concatenate([source, target]).astype(float)
    for channel, direction in enumerate((1, 2, 3)):
        agreement = np.corrcoef(colours[:, channel], hidden[:, direction])[0, 1]
        assert abs(agreement) > 0.97


def test_like_features_have_like_colours_on_both_shapes():
    features = np.random.default_rng(1).standard_normal((50, 6))
    order = np.random.default_rng(2).permutation(50)
    source, target = principal_colours(features, 3.0 * features[order])
    np.testing.assert_array_equal(source[order], target)
    assert source.min() == 40 and source.max() == 255
    features[7] = np.nan
    source, _ = principal_colours(features, features[order])
    assert tuple(source[7]) == UNKNOWN and (source == UNKNOWN).all(axis=1).sum() == 1


def test_few_or_no_features():
    source, _ = principal_colours(np.array([[1.0, 0], [0, 1], [1, 1]]), np.ones((1, 2)))
    assert len(np.unique(source[:, 2])) == 1
    nothing, _ = principal_colours(np.full((3, 4), np.nan), np.full((2, 4), np.nan))
    assert (nothing == UNKNOWN).all()


def test_confidences(known):
    layer = confidence_layer(known)
    np.testing.assert_array_equal(np.isnan(layer.values["source"]), known.source_to_target < 0)
    assert (layer.ramp.low, layer.ramp.high) == (0, 1)
    assert (layer.colours["source"][[3, 5]] == UNKNOWN).all()


def swapped_pair(known):
    """The match with two far points of the target exchanged, and its truth."""
    wrong = known.target_to_source.copy()
    first, second = known.target.points[:, 1].argmin(), known.target.points[:, 1].argmax()
    wrong[[first, second]] = wrong[[second, first]]
    truth = Truth(np.arange(len(wrong)), known.target_to_source)
    return replace(known, target_to_source=wrong), truth, [first, second]


def test_errors_are_those_of_each_map(known):
    result, truth, wrong = swapped_pair(known)
    errors, unit = map_errors(result, truth)
    assert unit == "% of \N{SQUARE ROOT}area"
    expected = 100 * geodesic_errors(known.source, truth.source, result.target_to_source)
    np.testing.assert_allclose(errors["target"], expected)
    assert (errors["target"][wrong] > 50).all() and np.delete(errors["target"], wrong).max() == 0
    np.testing.assert_array_equal(np.isnan(errors["source"]), known.source_to_target < 0)
    assert np.nanmax(errors["source"]) == 0
    layer = error_layer(errors, unit)
    assert layer.ramp.high > 0
    assert (layer.colours["target"][wrong] == layer.ramp.stops[-1]).all()


def test_errors_of_clouds_are_straight(known, known_clouds):
    result, truth, wrong = swapped_pair(known)
    result = replace(result, target=result.target.as_cloud())
    errors, unit = map_errors(result, truth)
    assert unit == "% of the diagonal"
    apart = known.source.points[truth.source[wrong[0]]] - known.source.points[truth.source[wrong[1]]]
    expected = 100 * np.linalg.norm(apart) / np.linalg.norm(np.ptp(known.source.points, axis=0))
    np.testing.assert_allclose(errors["target"][wrong], expected)


def test_points_that_the_truth_does_not_name_take_the_nearest_error_if_it_is_near(make, known):
    """On a fine grid: next to a named point is near, the far corner is not."""
    grid = make.grid(60)
    index = np.arange(grid.n_points)
    shifted = np.roll(index, 60)
    named = np.array([30 * 60 + 30])
    shifted[named - 1] = -1
    errors, _ = map_errors(Match(grid, grid, index, shifted), Truth(named, named))
    assert errors["target"][named[0] + 1] == errors["target"][named[0]] == pytest.approx(100 / 59)
    assert np.isnan(errors["target"][0])
    assert np.isnan(errors["target"][named[0] - 1])  # near, but without a counterpart


def test_features_are_those_of_the_matcher_whatever_was_left_out(known, make):
    """A point that repair leaves out has none; options of the match hold again."""
    network = DiffusionNet(NetworkSettings(width=16, blocks=1, out_channels=8))
    matcher = Matcher(network, device="cpu")
    stray = np.concatenate([known.source.points, [[5.0, 5, 5]]])
    result = replace(
        known,
        source=replace(known.source, points=stray),
        source_to_target=np.append(known.source_to_target, -1),
        source_confidence=np.append(known.source_confidence, 0),
    )
    source, target = pair_features(result, matcher)
    assert source.shape == (len(stray), 8)
    np.testing.assert_array_equal(np.isnan(source).any(axis=1), np.arange(len(stray)) == len(stray) - 1)
    np.testing.assert_allclose(target, matcher.preprocess(known.target).features, atol=1e-5)
    options = {"as_cloud": "target", "partial": None, "partial_scale": 1.0, "pre_aligned": False}
    cloud = pair_features(replace(result, report={"options": options}), matcher)[1]
    np.testing.assert_allclose(cloud, matcher.preprocess(known.target, as_cloud=True).features, atol=1e-5)
    layer = feature_layer(source, target)
    assert (layer.colours["source"][-1] == UNKNOWN).all() and layer.values is None
