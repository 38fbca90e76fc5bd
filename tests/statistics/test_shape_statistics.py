"""Alignment, modes and curves, against closed forms, known families and slow loops."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import procrustes
from scipy.spatial.transform import Rotation

from homolog.core.errors import ArgumentError
from homolog.statistics import compactness, generalisation, generalised_procrustes, principal_modes, specificity


def moved(shape, count, *, seed=0, scaled=False):
    """Copies of a shape, turned and shifted anywhere, and perhaps scaled."""
    rng = np.random.default_rng(seed)
    turns = Rotation.random(count, random_state=rng).as_matrix()
    scales = rng.uniform(0.3, 3, count) if scaled else np.ones(count)
    return scales[:, None, None] * shape @ turns.transpose(0, 2, 1) + 5 * rng.standard_normal((count, 1, 3))


def rms(a, b):
    """Root mean square distance of points, by the definition."""
    return np.sqrt(np.mean([np.linalg.norm(p - q) ** 2 for p, q in zip(a, b, strict=True)]))


@pytest.fixture
def shape():
    return np.random.default_rng(3).standard_normal((40, 3)) * [1, 2, 3]


@pytest.fixture
def family(shape):
    """Twelve shapes that vary along two known modes, orthogonal and of unit length, and along nothing else."""
    rng = np.random.default_rng(5)
    modes = np.linalg.qr(rng.standard_normal((shape.size, 2)))[0].T.reshape(2, *shape.shape)
    coefficients = rng.standard_normal((12, 2)) * [4, 1]
    coefficients -= coefficients.mean(axis=0)
    # Uncorrelated, so that the modes are the principal ones.
    coefficients = np.linalg.svd(coefficients, full_matrices=False)[0] * [9, 3]
    return shape + np.tensordot(coefficients, modes, axes=1), modes, coefficients


@pytest.mark.parametrize("scaled", [False, True])
def test_moved_copies_become_one(shape, scaled):
    given_shapes = moved(shape, 7, scaled=scaled)
    found = generalised_procrustes(given_shapes, scale=scaled)
    np.testing.assert_allclose(found.distances, 0, atol=1e-7)
    np.testing.assert_allclose(found.points.mean(axis=1), 0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(found.rotations), 1)
    again = found.scales[:, None, None] * given_shapes @ found.rotations.transpose(0, 2, 1) + found.shifts[:, None]
    np.testing.assert_allclose(again, found.points, atol=1e-9)


def test_mirrored_copies_do_not(shape):
    found = generalised_procrustes(np.stack([shape, shape * [-1, 1, 1]]))
    np.testing.assert_allclose(np.linalg.det(found.rotations), 1)
    assert found.distances.min() > 0.3


def test_sizes_stay_without_scale_and_in_sum_with_it(shape):
    given_shapes = moved(shape, 6, scaled=True) + np.random.default_rng(1).normal(0, 0.2, (6, *shape.shape))
    centred = given_shapes - given_shapes.mean(axis=1, keepdims=True)
    plain, scaled = generalised_procrustes(given_shapes), generalised_procrustes(given_shapes, scale=True)
    np.testing.assert_array_equal(plain.scales, 1)
    np.testing.assert_allclose(np.linalg.norm(plain.points, axis=(1, 2)), np.linalg.norm(centred, axis=(1, 2)))
    assert (scaled.points**2).sum() == pytest.approx((centred**2).sum())
    assert scaled.distances.mean() < 0.5 * plain.distances.mean()


def test_two_shapes_agree_with_scipy(shape):
    """Scipy's disparity is that of unit shapes, one of which is scaled: one less the squared sum of singular values."""
    other = shape + np.random.default_rng(2).normal(0, 0.5, shape.shape)
    disparity = procrustes(shape, other)[2]
    pair = [one - one.mean(axis=0) for one in (shape, other)]
    found = generalised_procrustes(np.stack([one / np.linalg.norm(one) for one in pair]), scale=True)
    apart = ((found.points[0] - found.points[1]) ** 2).sum()
    assert apart == pytest.approx(2 - 2 * np.sqrt(1 - disparity), rel=1e-6)


def test_alignment_is_a_minimum(shape):
    """No small turn of any shape lowers the distance from the mean of the others."""
    given_shapes = moved(shape, 5) + np.random.default_rng(4).normal(0, 0.3, (5, *shape.shape))
    found = generalised_procrustes(given_shapes)
    for number, one in enumerate(found.points):
        rest = np.delete(found.points, number, axis=0).mean(axis=0)
        for turn in Rotation.from_rotvec(1e-3 * np.concatenate([np.eye(3), -np.eye(3)])):
            assert np.linalg.norm(one @ turn.as_matrix().T - rest) > np.linalg.norm(one - rest)


def test_the_mean_stands_as_the_start(shape):
    found = generalised_procrustes(moved(shape, 6), start=shape + 2.0)
    np.testing.assert_allclose(found.mean, shape - shape.mean(axis=0), atol=1e-7)


@given(st.integers(0, 1000))
def test_alignment_does_not_mind_how_shapes_lie(seed):
    rng = np.random.default_rng(seed)
    shapes = rng.standard_normal((12, 3)) * [1, 2, 4] + rng.normal(0, 0.2, (4, 12, 3))
    turned = np.stack([moved(one, 1, seed=seed + k)[0] for k, one in enumerate(shapes)])
    a, b = (generalised_procrustes(each, start=shapes[0]) for each in (shapes, turned))
    np.testing.assert_allclose(a.points, b.points, atol=1e-5)


def test_modes_of_a_known_family(family, shape):
    points, modes, coefficients = family
    model = principal_modes(points)
    assert len(model.variances) == 2
    np.testing.assert_allclose(model.mean, shape, atol=1e-9)
    np.testing.assert_allclose(model.variances, coefficients.var(axis=0, ddof=1))
    for found, true in zip(model.modes, modes, strict=True):
        assert abs((found * true).sum()) == pytest.approx(1)
        assert found.ravel()[np.abs(found).argmax()] > 0
    np.testing.assert_allclose(
        np.abs(model.coefficients(points)), np.abs(coefficients / coefficients.std(axis=0, ddof=1))
    )
    np.testing.assert_allclose(model.shapes(model.coefficients(points)), points, atol=1e-9)
    np.testing.assert_allclose(model.shapes(np.zeros((1, 0)))[0], model.mean)
    assert model.coefficients(points).std(axis=0, ddof=1) == pytest.approx(1)


def test_variances_are_those_of_the_covariance():
    points = np.random.default_rng(0).standard_normal((9, 5, 3))
    covariance = np.cov(points.reshape(9, -1).T)
    expected = np.linalg.eigvalsh(covariance)[::-1][:8]
    np.testing.assert_allclose(principal_modes(points).variances, expected)
    assert principal_modes(points).variances.sum() == pytest.approx(np.trace(covariance))


def test_compactness_in_closed_form(family):
    """Variances are as 9^2 to 3^2."""
    np.testing.assert_allclose(compactness(principal_modes(family[0])), [0.9, 1.0])


def test_generalisation_of_a_family_needs_its_modes_only(family):
    curve = generalisation(family[0])
    assert len(curve.mean) == len(family[0]) - 2
    assert curve.mean[0] > 0.05
    np.testing.assert_allclose(curve.mean[1:], 0, atol=1e-6)


def test_generalisation_agrees_with_a_slow_loop():
    points = np.random.default_rng(7).standard_normal((7, 10, 3)) * np.linspace(0.2, 2, 10)[:, None] + 50
    distances = np.zeros((7, 5))
    for one in range(7):
        model = principal_modes(np.delete(points, one, axis=0))
        coefficients = model.coefficients(points[one : one + 1])
        for count in range(1, 6):
            distances[one, count - 1] = rms(model.shapes(coefficients[:, :count])[0], points[one])
    curve = generalisation(points)
    np.testing.assert_allclose(curve.mean, distances.mean(axis=0), rtol=1e-8)
    np.testing.assert_allclose(curve.error, distances.std(axis=0, ddof=1) / np.sqrt(7), rtol=1e-7)
    assert (np.diff(curve.mean) < 0).all()


def test_specificity_agrees_with_a_slow_loop():
    points = np.random.default_rng(8).standard_normal((6, 8, 3)) + 20
    model = principal_modes(points)
    drawn = np.random.default_rng(4).standard_normal((30, 5))
    expected = [
        np.mean([min(rms(sample, own) for own in points) for sample in model.shapes(drawn[:, :count])])
        for count in range(1, 6)
    ]
    curve = specificity(model, points, samples=30, seed=4)
    np.testing.assert_allclose(curve.mean, expected, rtol=1e-8)
    np.testing.assert_array_equal(curve.mean, specificity(model, points, samples=30, seed=4).mean)
    assert (curve.mean != specificity(model, points, samples=30, seed=5).mean).all()


def test_equal_shapes_have_no_modes(shape):
    points = np.stack([shape] * 4)
    model = principal_modes(points)
    assert model.variances.shape == (0,) and model.modes.shape == (0, 40, 3)
    np.testing.assert_allclose(generalisation(points).mean, 0, atol=1e-7)
    assert specificity(model, points).mean.shape == (0,)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: generalised_procrustes(np.zeros((4, 3))), r"points has shape \(4, 3\)"),
        (lambda: generalised_procrustes(np.full((2, 4, 3), np.nan)), "must be finite"),
        (lambda: generalised_procrustes(np.ones((2, 4, 3))), "all the same"),
        (lambda: generalised_procrustes(np.eye(3)[None], start=np.ones((4, 3))), "start has shape"),
        (lambda: principal_modes(np.ones((1, 4, 3))), "two shapes or more"),
        (lambda: generalisation(np.ones((2, 4, 3))), "three or more"),
    ],
)
def test_refused(call, said):
    with pytest.raises(ArgumentError, match=said):
        call()


@pytest.mark.parametrize("scale", [False, True])
def test_weights_count_as_copies_of_points_and_none_as_absent_ones(shape, scale):
    rng = np.random.default_rng(8)
    points = moved(shape, 5, seed=1) + 0.2 * rng.standard_normal((5, 40, 3))
    weights = rng.integers(0, 4, 40)
    copies = np.repeat(np.arange(40), weights)
    found = generalised_procrustes(points, scale=scale, start=shape, weights=weights.astype(float))
    expected = generalised_procrustes(points[:, copies], scale=scale, start=shape[copies])
    np.testing.assert_allclose(found.points[:, copies], expected.points, atol=1e-9)
    np.testing.assert_allclose(found.rotations, expected.rotations, atol=1e-9)
    np.testing.assert_allclose(found.distances, expected.distances, atol=1e-9)
    again = found.scales[:, None, None] * points @ found.rotations.transpose(0, 2, 1) + found.shifts[:, None]
    np.testing.assert_allclose(again, found.points, atol=1e-9)  # those that count nothing are moved with the others


def test_weights_that_are_none_are_refused(shape):
    points = moved(shape, 3)
    for weights, said in ((-np.ones(40), "numbers from 0"), (np.ones(39), "each of the 40 points")):
        with pytest.raises(ArgumentError, match=said):
            generalised_procrustes(points, weights=weights)
    with pytest.raises(ArgumentError, match="leave 2 points, but aligning needs three"):
        generalised_procrustes(points, weights=np.arange(40) < 2.0)


def test_modes_are_those_of_the_points_that_are_kept_and_the_others_follow(family):
    shapes, _, _ = family
    rng = np.random.default_rng(1)
    kept = rng.random(shapes.shape[1]) < 0.6
    noisy = shapes + 0.1 * rng.standard_normal(shapes.shape)  # eleven modes: as many as there can be
    found, alone = principal_modes(noisy, kept=kept), principal_modes(noisy[:, kept])
    np.testing.assert_allclose(found.modes[:, kept], alone.modes, atol=1e-9)
    np.testing.assert_allclose(found.variances, alone.variances)
    coefficients = found.coefficients(noisy)
    np.testing.assert_allclose(coefficients, alone.coefficients(noisy[:, kept]), atol=1e-9)
    np.testing.assert_allclose(found.shapes(coefficients), noisy, atol=1e-8)
    # With the first mode alone they follow as linear regression on its coefficients has it.
    others = noisy[:, ~kept].reshape(len(noisy), -1)
    slope = np.linalg.lstsq(coefficients[:, :1], others - others.mean(axis=0), rcond=None)[0]
    np.testing.assert_allclose(found.modes[0, ~kept].ravel() * found.deviations[0], slope[0], atol=1e-9)
    np.testing.assert_array_equal(found.of_kept().mean, alone.mean)
