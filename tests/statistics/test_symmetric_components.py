"""Symmetric and asymmetric components of shapes that were made of both."""

import numpy as np
import pytest

from homolog.core.errors import ArgumentError
from homolog.statistics import symmetric_components

HALF = 60
PARTNER = np.concatenate([np.arange(HALF, 2 * HALF), np.arange(HALF)])


def turn(rng):
    found = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return found * np.sign(np.linalg.det(found))


def shapes(rng, count, *, variation=0.0, directional=None, fluctuating=0.0):
    """Symmetric shapes that vary, with an asymmetry that all have, and one of each; moved and turned."""
    right = rng.normal(size=(HALF, 3)) + np.array([2, 0, 0])
    found = []
    for _ in range(count):
        own = right + variation * rng.normal(size=right.shape)
        whole = np.concatenate([own, own * [-1, 1, 1]])
        away = fluctuating * rng.normal(size=whole.shape) + (0 if directional is None else directional)
        found.append((whole + away) @ turn(rng).T + rng.normal(size=3))
    return np.stack(found)


def test_symmetric_shapes_have_no_asymmetry_and_vary_as_they_were_made_to():
    points = shapes(np.random.default_rng(0), 8, variation=0.05)
    found = symmetric_components(points, points[:, PARTNER])
    assert found.amounts == pytest.approx(0, abs=1e-9)
    variances = found.variances()
    # Of 2 HALF points with three coordinates; the six ways to move a shape take little of it away.
    assert variances["symmetric"] == pytest.approx(2 * HALF * 3 * 0.05**2, rel=0.15)
    assert variances["directional"] < 1e-12 and variances["fluctuating"] < 1e-12


def test_an_asymmetry_of_all_shapes_is_directional():
    rng = np.random.default_rng(1)
    bump = np.zeros((2 * HALF, 3))
    bump[:5] = [0, 0.1, 0]
    points = shapes(rng, 6, directional=bump)
    found = symmetric_components(points, points[:, PARTNER])
    variances = found.variances()
    # Half of it is in the symmetric part, on both sides; the other half with either sign.
    assert variances["directional"] == pytest.approx(2 * 5 * 0.05**2, rel=0.1)
    assert variances["fluctuating"] < 1e-9
    away = np.linalg.norm(found.directional, axis=1)
    assert away[[*range(5), *range(HALF, HALF + 5)]] == pytest.approx(0.05, rel=0.1)
    assert np.delete(away, [*range(5), *range(HALF, HALF + 5)]).max() < 0.01


def test_an_asymmetry_of_each_shape_is_fluctuating_and_told_by_shape():
    points = np.concatenate(
        [shapes(np.random.default_rng(5), 5), shapes(np.random.default_rng(5), 5, fluctuating=0.04)]
    )
    found = symmetric_components(points, points[:, PARTNER])
    assert found.amounts[:5].max() < 0.01 * found.amounts[5:].min()
    assert found.amounts[5:] == pytest.approx(np.sqrt(3 / 2) * 0.04, rel=0.2)


def test_parts_add_up_to_the_aligned_shapes_and_are_symmetric():
    points = shapes(np.random.default_rng(3), 4, variation=0.1, fluctuating=0.1)
    found = symmetric_components(points, points[:, PARTNER])
    whole = found.symmetric + found.asymmetric
    distances = [np.linalg.norm(each[:, None] - each, axis=2) for each in (whole[2], points[2])]
    assert distances[0] == pytest.approx(distances[1])
    # The symmetric part reflected is itself in the numbering of the partners.
    mirrored = found.symmetric[1][PARTNER]
    own = np.linalg.norm(found.symmetric[1][:, None] - found.symmetric[1], axis=2)
    assert np.linalg.norm(mirrored[:, None] - mirrored, axis=2) == pytest.approx(own)


def test_arrays_that_do_not_fit_are_refused():
    with pytest.raises(ArgumentError, match="partners have shape"):
        symmetric_components(np.ones((2, 5, 3)), np.ones((2, 4, 3)))
