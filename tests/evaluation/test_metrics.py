"""Figures against their definitions."""

import numpy as np
import pytest

from homolog.evaluation import PCK_THRESHOLD, area_under_pck, least_confident_share, pck_curve


@pytest.fixture
def errors():
    return np.random.default_rng(0).exponential(0.05, 777)


def test_curve_is_the_share_of_points_at_most_each_threshold(errors):
    thresholds, shares = pck_curve(errors)
    assert thresholds[0] == 0
    assert thresholds[-1] == PCK_THRESHOLD == 0.1
    assert len(thresholds) == len(shares) > 50
    np.testing.assert_allclose(np.diff(thresholds), thresholds[1])
    np.testing.assert_allclose(shares, [np.mean(errors <= threshold) for threshold in thresholds])


def test_curve_counts_errors_at_the_threshold():
    _, shares = pck_curve(np.array([0.0, 0.1, 0.2, 5.0]))
    assert shares[0] == 0.25
    assert shares[-1] == 0.5
    _, shares = pck_curve(np.array([0.0, 0.1, 0.2, 5.0]), threshold=0.2)
    assert shares[-1] == 0.75


def test_area_is_that_under_the_curve(errors):
    thresholds, shares = pck_curve(errors)
    by_hand = sum((shares[i] + shares[i + 1]) / 2 * (thresholds[i + 1] - thresholds[i]) for i in range(len(shares) - 1))
    assert area_under_pck(errors) == pytest.approx(by_hand / 0.1)
    # In the limit of a fine curve, each point adds what its error leaves of the threshold.
    assert area_under_pck(errors) == pytest.approx(np.mean(np.clip(1 - errors / 0.1, 0, None)), abs=0.01)


def test_area_of_extremes():
    assert area_under_pck(np.zeros(9)) == 1
    assert area_under_pck(np.full(9, 0.11)) == 0
    assert area_under_pck(np.array([0.0, 7.0])) == pytest.approx(0.5)
    assert area_under_pck(np.full(9, 0.3), threshold=0.6) == pytest.approx(0.5, abs=0.01)


def test_least_confident_share():
    errors = np.array([4.0, 1, 1, 1, 1, 1, 1, 0, 0, 0])
    confidences = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
    assert least_confident_share(errors, confidences) == 0.5
    assert least_confident_share(errors, -confidences) == 0
    assert least_confident_share(errors, confidences, fraction=1.0) == 1
    assert np.isnan(least_confident_share(np.zeros(10), confidences))
