"""Random poses of synthetic animals, natural and extreme ones, within the joints' ranges of motion."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from homolog.synthesis.animal_joints import MIDDLE_RANGES, RANGES, SIDED_RANGES, mirrored, within_ranges
from homolog.synthesis.joints import Angles
from homolog.synthesis.poses import Interval, both_sides
from homolog.synthesis.quadruped import LETTERS

# Intervals of the joints that a family does not list. Shoulders and hips are relative to the vertical: they compensate
# for the slope of the trunk.
_BY_DEFAULT: Mapping[str, Interval] = {
    "shoulder": (-6.0, 6.0),
    "shoulder_abduction": (-1.0, 4.0),
    "elbow": (-3.0, 6.0),
    "wrist": (-3.0, 6.0),
    "finger": (-5.0, 5.0),
    "hip": (-6.0, 6.0),
    "hip_abduction": (-1.0, 4.0),
    "knee": (-4.0, 8.0),
    "hock": (-4.0, 8.0),
    "toe": (-5.0, 5.0),
    "ear_droop": (-15.0, 20.0),
    "ear_turn": (-20.0, 20.0),
    "rise": (-3.0, 3.0),
    "sway": (-2.0, 2.0),
    "heading": (-10.0, 10.0),
    "back_flexion": (-4.0, 6.0),
    "back_bend": (-10.0, 10.0),
    "back_twist": (-4.0, 4.0),
    "neck_flexion": (-12.0, 25.0),
    "neck_bend": (-20.0, 20.0),
    "neck_twist": (-8.0, 8.0),
    "head_flexion": (-10.0, 15.0),
    "head_bend": (-10.0, 10.0),
    "head_twist": (-8.0, 8.0),
    "tail_raise": (-25.0, 40.0),
    "tail_bend": (-40.0, 40.0),
    "tail_curl": (-25.0, 50.0),
}

# Names without a side stand for both sides, sampled independently; every other pose is mirrored.
FAMILIES: Mapping[str, Mapping[str, Interval]] = {
    "standing": {},
    "walking": {
        "left_shoulder": (12.0, 30.0),
        "left_elbow": (0.0, 12.0),
        "right_shoulder": (-30.0, -10.0),
        "right_elbow": (0.0, 15.0),
        "right_wrist": (0.0, 35.0),
        "left_hip": (-28.0, -8.0),
        "left_knee": (-5.0, 12.0),
        "right_hip": (8.0, 28.0),
        "right_knee": (0.0, 20.0),
        "right_hock": (0.0, 15.0),
        "back_bend": (-15.0, 15.0),
    },
    "trotting": {
        "left_shoulder": (15.0, 38.0),
        "left_elbow": (0.0, 50.0),
        "left_wrist": (0.0, 50.0),
        "right_shoulder": (-32.0, -12.0),
        "right_wrist": (0.0, 20.0),
        "left_hip": (-35.0, -12.0),
        "left_hock": (-15.0, 5.0),
        "right_hip": (15.0, 40.0),
        "right_knee": (10.0, 50.0),
        "right_hock": (10.0, 45.0),
        "neck_flexion": (-10.0, 30.0),
    },
    "stretched gallop": {
        "shoulder": (25.0, 60.0),
        "elbow": (-20.0, 15.0),
        "hip": (-60.0, -25.0),
        "knee": (-15.0, 20.0),
        "hock": (-30.0, 10.0),
        "back_flexion": (-22.0, -5.0),
        "neck_flexion": (0.0, 40.0),
        "rise": (-8.0, 12.0),
    },
    "gathered gallop": {
        "shoulder": (-42.0, -15.0),
        "elbow": (0.0, 60.0),
        "wrist": (20.0, 95.0),
        "hip": (25.0, 65.0),
        "knee": (0.0, 50.0),
        "hock": (0.0, 45.0),
        "back_flexion": (12.0, 42.0),
        "neck_flexion": (0.0, 40.0),
        "rise": (-15.0, 8.0),
    },
    "jumping": {
        "shoulder": (10.0, 60.0),
        "elbow": (20.0, 100.0),
        "wrist": (30.0, 105.0),
        "hip": (-55.0, -20.0),
        "knee": (-15.0, 25.0),
        "hock": (-25.0, 10.0),
        "rise": (15.0, 45.0),
        "back_flexion": (-15.0, 10.0),
        "head_flexion": (0.0, 25.0),
    },
    "grazing": {
        "neck_flexion": (65.0, 105.0),
        "head_flexion": (-25.0, 10.0),
        "rise": (-12.0, 2.0),
        "left_shoulder": (0.0, 28.0),
        "right_shoulder": (-25.0, 0.0),
        "elbow": (0.0, 10.0),
    },
    "drinking": {
        "neck_flexion": (70.0, 105.0),
        "head_flexion": (-25.0, 0.0),
        "rise": (-28.0, -10.0),
        "shoulder": (-15.0, 10.0),
        "elbow": (10.0, 60.0),
        "wrist": (0.0, 40.0),
        "shoulder_abduction": (2.0, 15.0),
    },
    "sitting": {
        "rise": (28.0, 48.0),
        "back_flexion": (10.0, 30.0),
        "shoulder": (-5.0, 12.0),
        "hip": (50.0, 78.0),
        "hip_abduction": (8.0, 25.0),
        "knee": (65.0, 98.0),
        "hock": (70.0, 102.0),
        "toe": (30.0, 70.0),
        "head_flexion": (5.0, 35.0),
        "neck_flexion": (-5.0, 35.0),
        "tail_raise": (-10.0, 60.0),
    },
    "lying": {
        "shoulder": (-15.0, 15.0),
        "elbow": (65.0, 98.0),
        "wrist": (-10.0, 20.0),
        "shoulder_abduction": (2.0, 12.0),
        "hip": (35.0, 68.0),
        "hip_abduction": (14.0, 40.0),
        "knee": (55.0, 96.0),
        "hock": (50.0, 95.0),
        "toe": (0.0, 40.0),
        "neck_flexion": (-20.0, 50.0),
        "neck_bend": (-40.0, 40.0),
        "back_bend": (-25.0, 25.0),
    },
    "resting with folded legs": {
        "shoulder": (0.0, 35.0),
        "elbow": (55.0, 95.0),
        "wrist": (50.0, 100.0),
        "finger": (0.0, 40.0),
        "shoulder_abduction": (4.0, 18.0),
        "hip": (35.0, 65.0),
        "hip_abduction": (12.0, 40.0),
        "knee": (55.0, 96.0),
        "hock": (50.0, 90.0),
        "neck_flexion": (-10.0, 60.0),
        "neck_bend": (-60.0, 60.0),
    },
    "rearing": {
        "rise": (40.0, 72.0),
        "hip": (-15.0, 25.0),
        "knee": (0.0, 40.0),
        "hock": (0.0, 35.0),
        "shoulder": (30.0, 110.0),
        "elbow": (20.0, 100.0),
        "wrist": (20.0, 100.0),
        "back_flexion": (-10.0, 15.0),
        "head_flexion": (10.0, 40.0),
        "neck_flexion": (0.0, 45.0),
    },
    "bowing": {
        "rise": (-30.0, -18.0),
        "shoulder": (35.0, 70.0),
        "elbow": (-10.0, 40.0),
        "back_flexion": (-22.0, -5.0),
        "hip": (-8.0, 12.0),
        "neck_flexion": (-30.0, 5.0),
        "head_flexion": (-25.0, 5.0),
        "tail_raise": (20.0, 75.0),
    },
    "stalking": {
        "shoulder": (-45.0, -5.0),
        "elbow": (30.0, 85.0),
        "wrist": (0.0, 40.0),
        "hip": (15.0, 50.0),
        "knee": (25.0, 65.0),
        "hock": (20.0, 60.0),
        "hip_abduction": (4.0, 18.0),
        "neck_flexion": (20.0, 60.0),
        "head_flexion": (-30.0, 0.0),
        "tail_raise": (-30.0, 10.0),
    },
    "looking back": {
        "neck_bend": (35.0, 75.0),
        "back_bend": (15.0, 40.0),
        "head_bend": (5.0, 25.0),
        "neck_flexion": (-10.0, 40.0),
        "tail_bend": (-90.0, 20.0),
    },
    "raising a leg": {
        "left_shoulder": (10.0, 50.0),
        "left_elbow": (30.0, 100.0),
        "left_wrist": (30.0, 105.0),
        "right_hip": (-10.0, 30.0),
        "right_hip_abduction": (5.0, 42.0),
        "right_knee": (10.0, 70.0),
        "sway": (-8.0, 8.0),
    },
    "extreme": {
        **{name: (0.6 * low, 0.6 * high) for name, (low, high) in {**SIDED_RANGES, **MIDDLE_RANGES}.items()},
        "heading": (-10.0, 10.0),
    },
}

# A pose is drawn towards this one, where no limbs touch.
STANDING: Angles = {name: 3.0 if name.endswith("abduction") else 0.0 for name in RANGES}


def draw_pose(family: str, generator: np.random.Generator) -> dict[str, float]:
    """Sample a pose of a family: the angles of all joints, in degrees."""
    intervals = {**both_sides(_BY_DEFAULT, RANGES), **both_sides(FAMILIES[family], RANGES)}
    angles = {name: float(generator.uniform(*intervals[name])) for name in RANGES}
    for side in LETTERS:
        angles[f"{side}_shoulder"] -= angles["rise"]
        angles[f"{side}_hip"] -= angles["rise"] + angles["back_flexion"]
    return within_ranges(mirrored(angles) if generator.random() < 0.5 else angles)
