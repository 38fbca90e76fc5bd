"""Learning rates."""

import numpy as np
import pytest

from homolog.training.schedule import learning_rate
from homolog.training.settings import OptimiserSettings


def rates(steps=100, **settings):
    chosen = OptimiserSettings(learning_rate=0.5, **settings)
    return np.array([learning_rate(chosen, step, steps) for step in range(steps)])


def test_constant():
    assert np.all(rates(schedule="constant") == 0.5)


def test_cosine_is_half_a_wave():
    expected = 0.25 * (1 + np.cos(np.pi * np.arange(100) / 100))
    np.testing.assert_allclose(rates(schedule="cosine"), expected, atol=1e-12)


@pytest.mark.parametrize("schedule", ["cosine", "constant"])
def test_warm_up_is_a_straight_line(schedule):
    found = rates(schedule=schedule, warmup_steps=10)
    np.testing.assert_allclose(found[:10], 0.05 * np.arange(1, 11))
    assert found[10] == 0.5
    assert np.all(np.diff(found[10:]) <= 0)


def test_one_cycle_rises_and_falls():
    found = rates(schedule="one-cycle")
    assert found[0] < 0.03
    assert found.argmax() in (29, 30)
    assert found.max() == 0.5
    assert np.all(np.diff(found[:30]) > 0)
    assert np.all(np.diff(found[30:]) < 0)
    assert found[-1] < 0.001
    assert rates(schedule="one-cycle", warmup_steps=50).argmax() in (49, 50)


@pytest.mark.parametrize("schedule", ["cosine", "constant", "one-cycle"])
@pytest.mark.parametrize("warmup", [0, 1, 5, 50])
def test_short_trainings_and_long_warm_ups(schedule, warmup):
    for steps in (1, 2, 5):
        found = rates(steps, schedule=schedule, warmup_steps=warmup)
        assert np.all((found > 0) & (found <= 0.5))
