"""How the points of a cloud are spread over its surface, against surfaces whose areas are known."""

from __future__ import annotations

import numpy as np
import pytest

from homolog.geometry import areas_by_density, lies_in_lines


def rings(n_rings: int, n_around: int, power: float = 1.0) -> np.ndarray:
    """Contours of a sphere at some heights, which are closer together above where the power is less than one."""
    heights = 2 * ((np.arange(n_rings) + 0.5) / n_rings) ** power - 1
    angles = 2 * np.pi * np.arange(n_around) / n_around
    wide = np.sqrt(1 - heights**2)
    around = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.concatenate([np.c_[w * around, np.full(n_around, h)] for w, h in zip(wide, heights, strict=True)])


def sphere(n: int) -> np.ndarray:
    points = np.random.default_rng(0).standard_normal((n, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def test_contours_lie_in_lines_and_scattered_points_do_not(demo) -> None:
    assert lies_in_lines(rings(12, 200))
    noise = np.random.default_rng(1).normal(scale=0.003, size=(2400, 3))
    assert lies_in_lines(rings(12, 200) + noise)
    assert not lies_in_lines(sphere(2400))
    assert not lies_in_lines(demo.amber.points)


@pytest.mark.parametrize("n", [1, 3, 5])
def test_few_points_are_no_lines(n: int) -> None:
    assert not lies_in_lines(sphere(n))
    assert areas_by_density(sphere(n)).shape == (n,)


def test_one_point_many_times_is_no_line() -> None:
    assert not lies_in_lines(np.zeros((50, 3)))


def test_areas_of_contours_are_those_of_the_surface_between() -> None:
    """Archimedes: the area of a sphere between two heights is in proportion to their difference."""
    points = rings(24, 150, power=0.6)
    areas = areas_by_density(points)
    assert (points[:, 2] > 0).mean() > 0.6
    assert areas[points[:, 2] > 0].sum() / areas.sum() == pytest.approx(0.5, abs=0.05)
