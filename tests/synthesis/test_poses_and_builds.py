"""Poses stay within what joints can do; builds cover everything evenly."""

import numpy as np
import pytest

from homolog.synthesis.builds import PARAMETERS, draw_build, toward_mean
from homolog.synthesis.joints import MIDDLE_RANGES, RANGES, SIDED_RANGES, WIDE_RANGES, within_ranges
from homolog.synthesis.poses import FAMILIES, STANDING, WIDE_FAMILIES, draw_pose, scaled_pose


@pytest.mark.parametrize("family", FAMILIES)
def test_families_name_joints_and_keep_to_their_ranges(family):
    for name, (low, high) in FAMILIES[family].items():
        assert name in RANGES or name in SIDED_RANGES
        assert low < high
        limits = {**RANGES, **SIDED_RANGES, **MIDDLE_RANGES}[name]
        assert limits[0] <= low and high <= limits[1], name


@pytest.mark.parametrize("family", FAMILIES)
def test_poses_are_within_ranges_and_vary(family):
    generator = np.random.default_rng(0)
    drawn = [draw_pose(family, generator) for _ in range(30)]
    for angles in drawn:
        assert set(angles) == set(RANGES)
        assert angles == within_ranges(angles)
    assert all(np.ptp([angles[name] for angles in drawn]) > 0 for name in RANGES)
    assert max(abs(angles["heading"]) for angles in drawn) <= 15.0


@pytest.mark.parametrize("family", WIDE_FAMILIES)
def test_wide_poses_are_within_wider_ranges(family):
    generator = np.random.default_rng(0)
    drawn = [draw_pose(family, generator, "wide") for _ in range(60)]
    assert all(angles == within_ranges(angles, WIDE_RANGES) for angles in drawn)
    assert np.ptp([angles["trunk_bend"] for angles in drawn]) > 0


def test_wide_poses_bend_farther_backward_and_forward():
    generator = np.random.default_rng(0)
    leans = [
        [draw_pose(family, generator, poses)["lean"] for family in families for _ in range(30)]
        for poses, families in (("natural", FAMILIES), ("wide", WIDE_FAMILIES))
    ]
    assert min(leans[1]) < -50 < -30 <= min(leans[0]) and max(leans[1]) > 90 > 80 >= max(leans[0])


def test_left_and_right_take_turns():
    generator = np.random.default_rng(0)
    raised = [draw_pose("kicking", generator) for _ in range(40)]
    share = np.mean([pose["left_hip_flexion"] > pose["right_hip_flexion"] for pose in raised])
    assert 0.25 < share < 0.75


def test_feet_are_flat_where_ankles_allow():
    generator = np.random.default_rng(0)
    for _ in range(20):
        pose = draw_pose("sitting", generator)
        sole = pose["lean"] - pose["left_hip_flexion"] + pose["left_knee_flexion"] - pose["left_ankle_dorsiflexion"]
        assert abs(sole) <= 4.0 or pose["left_ankle_dorsiflexion"] in (-50.0, 20.0) or pose["left_hip_flexion"] == 120.0


def test_drawing_back_ends_in_standing():
    pose = draw_pose("crouching", np.random.default_rng(0))
    assert scaled_pose(pose, 1.0) == pytest.approx(pose, abs=5e-4)
    assert scaled_pose(pose, 0.0) == STANDING == within_ranges(STANDING)


def test_builds_cover_all_there_is_evenly():
    builds = [draw_build(seed=4, index=i) for i in range(60)]
    for name in PARAMETERS:
        values = np.array([build[name] for build in builds])
        assert values.min() >= 0.0 and values.max() <= 1.0
        assert (np.histogram(values, [0, 1 / 3, 2 / 3, 1])[0] > 0).all()
    for name in ("muscle", "height", "proportions"):
        tenths = np.histogram([build[name] for build in builds], 10, (0, 1))[0]
        assert tenths.min() >= 3 and tenths.max() <= 9
    ages = np.array([build["age"] for build in builds])
    assert 0.35 < (ages > 0.66).mean() < 0.85
    weights = np.array([build["weight"] for build in builds])
    assert (weights < 0.31).mean() > 0.3 and (weights > 0.69).mean() > 0.3
    genders = np.array([build["gender"] for build in builds])
    assert (genders < 0.2).mean() > 0.35 and (genders > 0.8).mean() > 0.35


def test_builds_of_small_sets_hold_all_combinations():
    """Any two parameters take all four pairs of low and high within a few dozen bodies."""
    builds = [draw_build(seed=0, index=i) for i in range(40)]
    high = {name: np.array([build[name] for build in builds]) > 0.5 for name in ("muscle", "weight", "height")}
    for first, second in (("muscle", "weight"), ("weight", "height"), ("muscle", "height")):
        pairs = np.bincount(2 * high[first] + high[second], minlength=4)
        assert pairs.min() >= 4


def test_another_seed_gives_others():
    assert draw_build(0, 5) == draw_build(0, 5) != draw_build(1, 5) != draw_build(1, 6)


def test_builds_come_nearer_to_the_mean():
    build = draw_build(0, 3)
    assert toward_mean(build, 1.0) == build
    assert set(toward_mean(build, 0.0).values()) == {0.5}
