"""Posterior shape models against dense Gaussian conditioning, and against models whose truth is known."""

import numpy as np
import pytest

from homolog.core.errors import ArgumentError
from homolog.geometry.projection import SurfacePoints
from homolog.statistics import Observations, Placement, ShapeModel, placed_posterior, posterior_model


@pytest.fixture
def model():
    """Twelve points, with five modes of any direction."""
    random = np.random.default_rng(0)
    modes = np.linalg.qr(random.standard_normal((36, 5)))[0].T.reshape(5, 12, 3)
    return ShapeModel(5 * random.standard_normal((12, 3)), modes, np.array([9.0, 4.0, 2.0, 1.0, 0.5]))


def covariance_of(model):
    flat = model.modes.reshape(len(model.modes), -1)
    return flat.T * model.variances @ flat


def conditioned(mean, covariance, seen, noise, values):
    """A normal distribution given some of its numbers with an error, by the textbook's formula on dense matrices."""
    gain = covariance[:, seen] @ np.linalg.inv(covariance[np.ix_(seen, seen)] + noise)
    return mean + gain @ (values - mean[seen]), covariance - gain @ covariance[seen]


def test_it_is_dense_gaussian_conditioning(model):
    indices, random = np.array([7, 0, 3]), np.random.default_rng(1)
    positions = model.mean[indices] + random.standard_normal((3, 3))
    found = posterior_model(model, Observations.of_points(indices, positions, 0.3))
    seen = (3 * indices[:, None] + np.arange(3)).ravel()
    mean, covariance = conditioned(model.mean.ravel(), covariance_of(model), seen, 0.09 * np.eye(9), positions.ravel())
    np.testing.assert_allclose(found.mean.ravel(), mean, atol=1e-10)
    np.testing.assert_allclose(covariance_of(found), covariance, atol=1e-10)
    flat = found.modes.reshape(len(found.modes), -1)
    np.testing.assert_allclose(flat @ flat.T, np.eye(len(flat)), atol=1e-10)


def test_places_between_points_and_errors_of_a_direction(model):
    """A place within a triangle is a weighted sum of rows; what is known across a surface alone is one number."""
    places = SurfacePoints(np.array([[0, 1, 2], [4, 5, 6]]), np.array([[0.2, 0.3, 0.5], [0.6, 0.4, 0.0]]))
    normals = np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0]])
    positions = np.random.default_rng(2).standard_normal((2, 3))
    precisions = normals[:, :, None] * normals[:, None, :] / 0.04
    found = posterior_model(model, Observations(places, positions, precisions))
    rows = np.zeros((2, 12, 3))
    for row, (corners, weights, normal) in enumerate(zip(places.corners, places.weights, normals, strict=True)):
        for corner, weight in zip(corners, weights, strict=True):
            rows[row, corner] += weight * normal
    rows, values = rows.reshape(2, 36), (positions * normals).sum(axis=1)
    before = covariance_of(model)
    gain = before @ rows.T @ np.linalg.inv(rows @ before @ rows.T + 0.04 * np.eye(2))
    mean = model.mean.ravel() + gain @ (values - rows @ model.mean.ravel())
    np.testing.assert_allclose(found.mean.ravel(), mean, atol=1e-10)
    np.testing.assert_allclose(covariance_of(found), before - gain @ rows @ before, atol=1e-10)


@pytest.mark.parametrize("scale", [False, True])
def test_a_known_shape_is_found_in_any_place(model, make, scale):
    """Points of a shape of the model, turned, moved and perhaps grown, tell where and which it is."""
    coefficients = np.array([0.5, -1.0, 0.3, 0.8, -0.4])
    true = Placement(make.rotation(3), np.array([10.0, -4.0, 2.0]), 1.3 if scale else 1.0)
    whole = true(model.shapes(coefficients[None])[0])
    indices = np.arange(7)
    start = true.moved(np.array([0.1, -0.1, 0.15]), np.array([0.5, 0.3, -0.2]), 0.1 if scale else 0.0)
    seen = Observations.of_points(indices, whole[indices], 1e-5)
    found = placed_posterior(model, seen, start, scale=scale)
    np.testing.assert_allclose(found.points, whole, atol=1e-3)
    np.testing.assert_allclose(found.coefficients, coefficients, atol=1e-3)
    assert found.placement.scale == pytest.approx(true.scale, abs=1e-4)
    assert found.variances.max() < 1e-4


def test_what_is_open_of_the_placement_counts(model):
    """The variance is that of dense conditioning on a model with shifts and turns as weakly known modes."""
    indices = np.array([0, 1, 2, 3])
    start = Placement(np.eye(3), np.zeros(3))
    found = placed_posterior(model, Observations.of_points(indices, model.mean[indices], 0.2), start)
    np.testing.assert_allclose(found.points, model.mean, atol=1e-6)  # the mean is what was seen
    arms = model.mean
    rigid = [np.tile(axis, (12, 1)) for axis in np.eye(3)] + [np.cross(axis, arms) for axis in np.eye(3)]
    rigid = np.reshape(rigid, (6, 36))
    before = covariance_of(model) + 1e3 * rigid.T @ rigid
    seen = (3 * indices[:, None] + np.arange(3)).ravel()
    _, after = conditioned(np.zeros(36), before, seen, 0.04 * np.eye(12), np.zeros(12))
    expected = np.diag(after).reshape(12, 3).sum(axis=1)
    np.testing.assert_allclose(found.variances, expected, rtol=1e-3)
    fixed = posterior_model(model, Observations.of_points(indices, model.mean[indices], 0.2))
    assert (found.variances > np.diag(covariance_of(fixed)).reshape(12, 3).sum(axis=1)).all()


def test_the_prior_counts_as_much_with_a_placement(model, make):
    """Where the model lies at the end, the shape is that of conditioning there, wherever the iteration began."""
    random = np.random.default_rng(4)
    indices = np.arange(8)
    true = Placement(make.rotation(2), np.array([1.0, 2.0, 3.0]))
    positions = true(model.mean[indices]) + random.standard_normal((8, 3))
    seen = Observations.of_points(indices, positions, 1.0)
    found = placed_posterior(model, seen, true, rounds=200)
    other = placed_posterior(model, seen, true, coefficients=np.array([2.0, -2.0, 1.0, 2.0, -1.0]), rounds=200)
    np.testing.assert_allclose(other.coefficients, found.coefficients, atol=1e-5)
    back = (positions - found.placement.shift) @ found.placement.rotation
    there = posterior_model(model, Observations.of_points(indices, back, 1.0))
    np.testing.assert_allclose(found.placement(there.mean), found.points, atol=1e-5)


def test_too_few_points_are_refused(model):
    seen = Observations.of_points(np.array([0, 1]), model.mean[:2], 0.1)
    with pytest.raises(ArgumentError, match="needs 3 or more"):
        placed_posterior(model, seen, Placement(np.eye(3), np.zeros(3)))
    with pytest.raises(ArgumentError, match="of the 2 points"):
        Observations(seen.places, model.mean, seen.precisions)
