"""Figures against their definitions."""

import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra

from homolog.evaluation import PCK_THRESHOLD, area_under_pck, geodesic_diameter, least_confident_share, pck_curve
from homolog.geometry import edge_graph
from homolog.shapes import Shape, face_areas


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


def all_pairs(shape):
    """The largest finite distance along edges between two points, over the root of the area."""
    distances = dijkstra(edge_graph(shape.points, shape.faces))
    return distances[np.isfinite(distances)].max() / np.sqrt(face_areas(shape.points, shape.faces).sum())


def test_the_diameter_is_nearly_the_largest_of_all_distances(make):
    rng = np.random.default_rng(0)
    for shape in (make.sphere(2), make.grid(12), make.blob(2)):
        for _ in range(10):
            stretched = Shape(shape.points * rng.uniform(0.3, 3, 3), shape.faces)
            moved = make.relabelled(stretched, rng.permutation(shape.n_points))  # whichever point comes first
            assert 0.94 * all_pairs(moved) <= geodesic_diameter(moved) <= (1 + 1e-9) * all_pairs(moved)


def test_the_diameter_is_that_of_the_body_not_of_small_components(make):
    body = make.blob(2)
    for first in (False, True):
        littered = make.littered(body, 40, first=first)
        area = [face_areas(shape.points, shape.faces).sum() for shape in (body, littered)]
        expected = geodesic_diameter(body) * np.sqrt(area[0] / area[1])
        assert geodesic_diameter(littered) == pytest.approx(expected, rel=0.03)
