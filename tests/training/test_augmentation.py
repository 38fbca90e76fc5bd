"""Variations of the input: what they keep, their range, and that they follow their generator."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from homolog.core.errors import ArgumentError
from homolog.training import AugmentationSettings, augmented

STILL = {"least_scale": 1.0, "most_scale": 1.0, "jitter": 0.0}
POINTS = torch.randn(200, 3, generator=torch.Generator().manual_seed(0))


def many(count: int = 200, points: Tensor = POINTS, **settings) -> list[Tensor]:
    generator = torch.Generator().manual_seed(1)
    return [augmented(points, AugmentationSettings(**settings), generator) for _ in range(count)]


def test_no_turn_no_scale_and_no_jitter_is_the_identity() -> None:
    settings = AugmentationSettings(turn="none", **STILL)
    assert torch.equal(augmented(POINTS, settings, torch.Generator()), POINTS)


def test_a_turn_about_the_vertical_keeps_heights_lengths_and_hands() -> None:
    angles = []
    for turned in many(turn="vertical", degrees=60, **STILL):
        torch.testing.assert_close(turned[:, 1], POINTS[:, 1])
        torch.testing.assert_close(turned.norm(dim=1), POINTS.norm(dim=1))
        rotation = torch.linalg.lstsq(POINTS, turned).solution.T
        assert rotation.det() == pytest.approx(1, abs=1e-4)
        angles.append(math.degrees(math.atan2(rotation[0, 2], rotation[0, 0])))
    # To either side, evenly, as far as allowed.
    assert -60 <= min(angles) < -55 and 55 < max(angles) <= 60
    assert abs(sum(angles) / len(angles)) < 5 * 60 / math.sqrt(3 * len(angles))


def test_any_turn_keeps_lengths_and_hands_alone_and_all_are_as_likely() -> None:
    directions, angles = [], []
    for turned in many(2000, turn="any", **STILL):
        rotation = torch.linalg.lstsq(POINTS, turned).solution.T
        torch.testing.assert_close(rotation @ rotation.T, torch.eye(3), atol=1e-5, rtol=0)
        assert rotation.det() == pytest.approx(1, abs=1e-4)
        directions.append(rotation[:, 1])
        angles.append(math.acos(float(((rotation.trace() - 1) / 2).clamp(-1, 1))))
    # Where the vertical goes is spread evenly over the sphere; angles have the density (1 - cos a) / pi.
    directions = torch.stack(directions)
    torch.testing.assert_close(directions.mean(dim=0), torch.zeros(3), atol=0.05, rtol=0)
    torch.testing.assert_close(directions.T @ directions / 2000, torch.eye(3) / 3, atol=0.05, rtol=0)
    for angle in (1.0, 2.0, 3.0):
        expected = (angle - math.sin(angle)) / math.pi
        assert sum(found < angle for found in angles) / 2000 == pytest.approx(expected, abs=0.04)


def test_the_vertical_leans_by_up_to_the_tilt_in_all_directions() -> None:
    up = torch.tensor([[0.0, 1.0, 0.0]])
    settings = AugmentationSettings(turn="vertical", degrees=90, tilt=20, **STILL)
    generator = torch.Generator().manual_seed(0)
    leaning = torch.cat([augmented(up, settings, generator) for _ in range(300)])
    angles = torch.rad2deg(torch.acos(leaning[:, 1]))
    assert 18 < angles.max() <= 20.01 and 8 < angles.mean() < 12
    assert all(((leaning[:, axis] * sign) > 0.2).any() for axis in (0, 2) for sign in (1, -1))
    torch.testing.assert_close(leaning.norm(dim=1), torch.ones(300))


@pytest.mark.parametrize(("turn", "degrees"), [("vertical", 0), ("none", 90)])
def test_without_an_angle_nothing_turns(turn: str, degrees: float) -> None:
    for turned in many(3, turn=turn, degrees=degrees, **STILL):
        torch.testing.assert_close(turned, POINTS, atol=1e-6, rtol=0)


def test_a_shift_moves_all_points_alike() -> None:
    moved = [found - POINTS for found in many(500, turn="none", shift=0.3, **STILL)]
    assert all((shift - shift[0]).abs().max() < 1e-6 for shift in moved)
    shifts = torch.stack([shift[0] for shift in moved])
    torch.testing.assert_close(shifts.std(dim=0), torch.full((3,), 0.3), atol=0.03, rtol=0)
    torch.testing.assert_close(shifts.mean(dim=0), torch.zeros(3), atol=0.05, rtol=0)


def test_each_axis_is_scaled_within_its_range() -> None:
    settings = {"turn": "none", "least_scale": 0.8, "most_scale": 1.5, "jitter": 0.0}
    factors = []
    for stretched in many(**settings):
        ratios = stretched / POINTS
        torch.testing.assert_close(ratios, ratios[:1].expand_as(ratios))
        factors.append(ratios[0])
    found = torch.stack(factors)
    assert 0.8 - 1e-6 <= found.min() < 0.82 and 1.48 < found.max() <= 1.5 + 1e-6
    # One factor for each axis, drawn apart.
    assert (torch.corrcoef(found.T) - torch.eye(3)).abs().max() < 0.3


def test_jitter_is_gaussian_up_to_where_it_is_clipped() -> None:
    still = {"turn": "none", "least_scale": 1.0, "most_scale": 1.0}
    small = torch.stack(many(50, jitter=0.01, largest_jitter=1.0, **still)) - POINTS
    assert abs(small.mean()) < 5 * 0.01 / small.numel() ** 0.5
    assert small.std().item() == pytest.approx(0.01, rel=0.05)
    assert (small.abs() < 0.01).float().mean().item() == pytest.approx(0.683, abs=0.02)
    clipped = torch.stack(many(50, jitter=0.1, largest_jitter=0.05, **still)) - POINTS
    assert clipped.abs().max().item() == pytest.approx(0.05, abs=1e-6)
    # Beyond half a standard deviation.
    assert (clipped.abs() > 0.05 - 1e-6).float().mean().item() == pytest.approx(0.617, abs=0.02)


def test_the_state_of_the_generator_decides() -> None:
    settings = AugmentationSettings(turn="any")
    generator = torch.Generator().manual_seed(5)
    first, second = augmented(POINTS, settings, generator), augmented(POINTS, settings, generator)
    torch.manual_seed(99)
    again = augmented(POINTS, settings, torch.Generator().manual_seed(5))
    assert torch.equal(first, again) and not torch.equal(first, second)
    torch.manual_seed(5)
    assert torch.equal(augmented(POINTS, settings), first)  # torch's own


def test_points_stay_as_they_are_and_keep_their_type() -> None:
    points = POINTS.double()
    found = augmented(points, AugmentationSettings(), torch.Generator().manual_seed(0))
    assert found.dtype == torch.float64 and found.shape == points.shape
    assert torch.equal(points, POINTS.double()) and not torch.equal(found, points)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("degrees", -1.0),
        ("degrees", math.inf),
        ("degrees", math.nan),
        ("least_scale", 0.0),
        ("least_scale", 1.2),
        ("least_scale", math.nan),
        ("most_scale", math.inf),
        ("most_scale", math.nan),
        ("jitter", -0.01),
        ("jitter", math.nan),
        ("largest_jitter", -0.01),
        ("largest_jitter", math.inf),
    ],
)
def test_settings_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(ArgumentError, match=f"^{name} is {value}, but must be"):
        AugmentationSettings(**{name: value})


def test_an_unknown_turn_is_refused() -> None:
    with pytest.raises(ArgumentError, match="did you mean 'vertical'"):
        AugmentationSettings(turn="vertikal")
