"""Random poses of synthetic people, natural and extreme ones, within the joints' ranges of motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from homolog.core.choices import Poses
from homolog.synthesis.joints import (
    MIDDLE_RANGES,
    RANGES,
    SIDED_RANGES,
    SIDES,
    WIDE_RANGES,
    Angles,
    mirrored,
    within_ranges,
)

Interval = tuple[float, float]

# Intervals of the joints that a family does not list. Hip flexion is relative to the vertical: hips compensate for the
# lean of the pelvis. Ankles that a family does not list put the foot flat on the ground.
_BY_DEFAULT: Mapping[str, Interval] = {
    "shoulder_elevation": (8.0, 28.0),
    "shoulder_plane": (-20.0, 50.0),
    "shoulder_rotation": (-20.0, 30.0),
    "elbow_flexion": (5.0, 40.0),
    "forearm_pronation": (-30.0, 50.0),
    "wrist_flexion": (-20.0, 20.0),
    "wrist_deviation": (-8.0, 10.0),
    "finger_curl": (0.0, 30.0),
    "hip_flexion": (-5.0, 8.0),
    "hip_abduction": (-2.0, 9.0),
    "hip_rotation": (-5.0, 20.0),
    "knee_flexion": (0.0, 12.0),
    "toe_extension": (0.0, 5.0),
    "trunk_flexion": (-6.0, 8.0),
    "trunk_bend": (-5.0, 5.0),
    "trunk_rotation": (-8.0, 8.0),
    "neck_flexion": (-15.0, 20.0),
    "neck_bend": (-8.0, 8.0),
    "neck_rotation": (-25.0, 25.0),
    "lean": (-4.0, 6.0),
    "sway": (-3.0, 3.0),
    "heading": (-10.0, 10.0),
}

# Names without a side stand for both sides, sampled independently; every other pose is mirrored.
FAMILIES: Mapping[str, Mapping[str, Interval]] = {
    "standing": {},
    "arms raised": {
        "shoulder_elevation": (80.0, 175.0),
        "shoulder_plane": (-10.0, 100.0),
        "elbow_flexion": (0.0, 60.0),
        "shoulder_rotation": (-50.0, 20.0),
    },
    "reaching": {
        "left_shoulder_elevation": (60.0, 150.0),
        "left_shoulder_plane": (40.0, 115.0),
        "left_elbow_flexion": (0.0, 25.0),
        "trunk_flexion": (0.0, 35.0),
        "trunk_rotation": (-35.0, 10.0),
        "lean": (0.0, 25.0),
        "left_hip_flexion": (0.0, 35.0),
        "knee_flexion": (0.0, 40.0),
    },
    "striding": {
        "left_hip_flexion": (15.0, 45.0),
        "left_knee_flexion": (0.0, 30.0),
        "right_hip_flexion": (-25.0, -5.0),
        "right_knee_flexion": (0.0, 45.0),
        "right_ankle_dorsiflexion": (-20.0, 15.0),
        "right_toe_extension": (0.0, 35.0),
        "left_shoulder_plane": (-90.0, -60.0),
        "left_shoulder_elevation": (15.0, 45.0),
        "right_shoulder_plane": (65.0, 95.0),
        "right_shoulder_elevation": (15.0, 60.0),
        "elbow_flexion": (5.0, 90.0),
        "trunk_rotation": (0.0, 15.0),
        "lean": (0.0, 12.0),
    },
    "lunging": {
        "left_hip_flexion": (50.0, 90.0),
        "left_knee_flexion": (50.0, 100.0),
        "right_hip_flexion": (-25.0, 0.0),
        "right_knee_flexion": (10.0, 60.0),
        "right_ankle_dorsiflexion": (-10.0, 20.0),
        "right_toe_extension": (10.0, 45.0),
        "shoulder_elevation": (15.0, 110.0),
        "shoulder_plane": (0.0, 95.0),
        "elbow_flexion": (0.0, 80.0),
        "lean": (0.0, 20.0),
        "trunk_rotation": (-25.0, 25.0),
    },
    "kicking": {
        "left_hip_flexion": (40.0, 105.0),
        "left_knee_flexion": (0.0, 60.0),
        "left_ankle_dorsiflexion": (-45.0, 15.0),
        "right_knee_flexion": (0.0, 25.0),
        "lean": (-20.0, 5.0),
        "trunk_flexion": (-10.0, 25.0),
        "shoulder_elevation": (20.0, 95.0),
        "shoulder_plane": (-20.0, 80.0),
        "elbow_flexion": (0.0, 80.0),
    },
    "balancing": {
        "left_hip_flexion": (50.0, 110.0),
        "left_hip_abduction": (0.0, 40.0),
        "left_hip_rotation": (0.0, 40.0),
        "left_knee_flexion": (60.0, 130.0),
        "left_ankle_dorsiflexion": (-40.0, 10.0),
        "shoulder_elevation": (50.0, 120.0),
        "shoulder_plane": (-15.0, 45.0),
        "trunk_bend": (-15.0, 15.0),
        "sway": (-10.0, 10.0),
    },
    "crouching": {
        "hip_flexion": (60.0, 105.0),
        "knee_flexion": (80.0, 130.0),
        "hip_abduction": (5.0, 30.0),
        "hip_rotation": (0.0, 25.0),
        "toe_extension": (0.0, 35.0),
        "lean": (0.0, 35.0),
        "trunk_flexion": (0.0, 35.0),
        "shoulder_elevation": (35.0, 90.0),
        "shoulder_plane": (35.0, 105.0),
        "elbow_flexion": (0.0, 90.0),
    },
    "sitting": {
        "hip_flexion": (75.0, 95.0),
        "knee_flexion": (65.0, 105.0),
        "hip_abduction": (0.0, 22.0),
        "lean": (-15.0, 12.0),
        "trunk_flexion": (0.0, 25.0),
        "shoulder_elevation": (20.0, 50.0),
        "shoulder_plane": (30.0, 90.0),
        "elbow_flexion": (20.0, 80.0),
    },
    "kneeling": {
        "hip_flexion": (-5.0, 20.0),
        "knee_flexion": (80.0, 125.0),
        "ankle_dorsiflexion": (-50.0, -15.0),
        "shoulder_elevation": (10.0, 120.0),
        "shoulder_plane": (0.0, 95.0),
        "elbow_flexion": (0.0, 90.0),
    },
    "bending": {
        "lean": (20.0, 70.0),
        "trunk_flexion": (15.0, 60.0),
        "neck_flexion": (-40.0, 20.0),
        "knee_flexion": (0.0, 40.0),
        "hip_flexion": (0.0, 20.0),
        "shoulder_elevation": (40.0, 120.0),
        "shoulder_plane": (50.0, 100.0),
        "elbow_flexion": (0.0, 40.0),
    },
    "twisting": {
        "trunk_rotation": (20.0, 45.0),
        "trunk_flexion": (-10.0, 30.0),
        "trunk_bend": (-20.0, 20.0),
        "neck_rotation": (0.0, 55.0),
        "shoulder_elevation": (20.0, 110.0),
        "shoulder_plane": (-20.0, 100.0),
        "elbow_flexion": (0.0, 100.0),
        "knee_flexion": (0.0, 30.0),
    },
    "leaning aside": {
        "trunk_bend": (15.0, 35.0),
        "sway": (0.0, 15.0),
        "neck_bend": (0.0, 30.0),
        "right_shoulder_elevation": (80.0, 175.0),
        "right_shoulder_plane": (-10.0, 40.0),
        "hip_abduction": (5.0, 30.0),
    },
    "arms crossed": {
        "left_shoulder_elevation": (30.0, 45.0),
        "right_shoulder_elevation": (48.0, 65.0),
        "shoulder_plane": (70.0, 105.0),
        "shoulder_rotation": (35.0, 65.0),
        "elbow_flexion": (80.0, 120.0),
        "finger_curl": (0.0, 20.0),
    },
    "legs crossed": {
        "left_hip_abduction": (-18.0, -6.0),
        "left_hip_flexion": (10.0, 22.0),
        "right_hip_abduction": (-14.0, 0.0),
        "right_hip_flexion": (-12.0, -2.0),
        "hip_rotation": (-5.0, 10.0),
        "shoulder_elevation": (10.0, 90.0),
    },
    "hands on hips": {
        "shoulder_elevation": (30.0, 55.0),
        "shoulder_plane": (-30.0, 10.0),
        "shoulder_rotation": (25.0, 60.0),
        "elbow_flexion": (75.0, 115.0),
        "hip_abduction": (3.0, 20.0),
    },
    "hands at the head": {
        "shoulder_elevation": (85.0, 140.0),
        "shoulder_plane": (0.0, 70.0),
        "shoulder_rotation": (-60.0, 0.0),
        "elbow_flexion": (95.0, 145.0),
        "neck_flexion": (-5.0, 20.0),
    },
    "extreme": {
        **{name: (0.8 * low, 0.8 * high) for name, (low, high) in {**SIDED_RANGES, **MIDDLE_RANGES}.items()},
        "finger_curl": (0.0, 45.0),
        "lean": (-15.0, 45.0),
        "heading": (-10.0, 10.0),
    },
}

# Of gymnasts, dancers and people who lie, crawl or fall.
WIDE_FAMILIES: Mapping[str, Mapping[str, Interval]] = {
    "arching": {
        "lean": (-70.0, -15.0),
        "trunk_flexion": (-45.0, -12.0),
        "neck_flexion": (-45.0, 10.0),
        "knee_flexion": (10.0, 90.0),
        "shoulder_elevation": (30.0, 175.0),
        "shoulder_plane": (-40.0, 110.0),
        "hip_flexion": (-15.0, 15.0),
        "elbow_flexion": (0.0, 90.0),
    },
    "extreme": {
        **SIDED_RANGES,
        **MIDDLE_RANGES,
        "finger_curl": (0.0, 60.0),
        "lean": (-40.0, 60.0),
        "trunk_flexion": (-40.0, 75.0),
        "heading": (-10.0, 10.0),
    },
    "arched chest": {
        "trunk_flexion": (-45.0, -15.0),
        "lean": (-20.0, 10.0),
        "neck_flexion": (-45.0, 0.0),
        "shoulder_elevation": (20.0, 170.0),
        "shoulder_plane": (-60.0, 40.0),
        "knee_flexion": (0.0, 60.0),
    },
    "curled": {
        "hip_flexion": (60.0, 125.0),
        "knee_flexion": (60.0, 135.0),
        "trunk_flexion": (20.0, 80.0),
        "neck_flexion": (0.0, 45.0),
        "shoulder_elevation": (30.0, 90.0),
        "shoulder_plane": (50.0, 105.0),
        "elbow_flexion": (20.0, 130.0),
        "lean": (-10.0, 40.0),
    },
    "crawling": {
        "lean": (50.0, 95.0),
        "hip_flexion": (-20.0, 40.0),
        "knee_flexion": (50.0, 110.0),
        "neck_flexion": (-45.0, 0.0),
        "shoulder_elevation": (70.0, 120.0),
        "shoulder_plane": (70.0, 110.0),
        "elbow_flexion": (0.0, 40.0),
    },
    "kicking high": {
        "left_hip_flexion": (80.0, 125.0),
        "left_hip_abduction": (0.0, 40.0),
        "left_knee_flexion": (0.0, 60.0),
        "lean": (-40.0, 10.0),
        "shoulder_elevation": (20.0, 150.0),
        "shoulder_plane": (-40.0, 100.0),
        "right_knee_flexion": (0.0, 60.0),
        "trunk_flexion": (-25.0, 30.0),
    },
    "flying": {
        "shoulder_elevation": (100.0, 178.0),
        "shoulder_plane": (-10.0, 100.0),
        "hip_flexion": (-40.0, 20.0),
        "knee_flexion": (0.0, 120.0),
        "trunk_flexion": (-40.0, 5.0),
        "neck_flexion": (-40.0, 5.0),
        "lean": (-20.0, 20.0),
    },
    "bowing": {
        "lean": (40.0, 100.0),
        "trunk_flexion": (20.0, 80.0),
        "hip_flexion": (-10.0, 30.0),
        "knee_flexion": (0.0, 60.0),
        "shoulder_elevation": (0.0, 170.0),
        "shoulder_plane": (-20.0, 110.0),
    },
}

# The pose towards which others are scaled down: no limbs touch.
_CALM = {"shoulder_elevation": 30.0, "elbow_flexion": 15.0, "hip_abduction": 6.0, "finger_curl": 5.0}
STANDING: Angles = {name: _CALM.get(name.removeprefix("left_").removeprefix("right_"), 0.0) for name in RANGES}


@dataclass(frozen=True)
class PoseSet:
    """Families of poses, and the ranges of the joints in them."""

    families: Mapping[str, Mapping[str, Interval]]
    ranges: Mapping[str, Interval]


POSE_SETS: Mapping[Poses, PoseSet] = {
    "natural": PoseSet(FAMILIES, RANGES),
    "wide": PoseSet(WIDE_FAMILIES, WIDE_RANGES),
}


def draw_pose(family: str, generator: np.random.Generator, poses: Poses = "natural") -> dict[str, float]:
    """Sample a pose of a family: the angles of all joints, in degrees."""
    known = POSE_SETS[poses]
    intervals = {**both_sides(_BY_DEFAULT, RANGES), **both_sides(known.families[family], RANGES)}
    angles = {name: float(generator.uniform(*intervals.get(name, (-4.0, 4.0)))) for name in RANGES}
    for side in SIDES:
        if f"{side}_ankle_dorsiflexion" not in intervals:
            flat = angles[f"{side}_knee_flexion"] - angles[f"{side}_hip_flexion"]
            angles[f"{side}_ankle_dorsiflexion"] += flat
        angles[f"{side}_hip_flexion"] += angles["lean"]
    return within_ranges(mirrored(angles) if generator.random() < 0.5 else angles, known.ranges)


def scaled_pose(angles: Angles, share: float, standing: Angles = STANDING) -> dict[str, float]:
    """Interpolate between the standing pose, at 0, and a pose, at 1; in degrees, with three digits."""
    return {name: round(standing[name] + share * (angle - standing[name]), 3) for name, angle in angles.items()}


def both_sides(intervals: Mapping[str, Interval], ranges: Mapping[str, Interval]) -> dict[str, Interval]:
    """Intervals by the names of all joints; an interval of one side overrides that of both sides."""
    sided = [(f"{side}_{name}", values) for name, values in intervals.items() for side in SIDES]
    return {name: values for name, values in (*sided, *intervals.items()) if name in ranges}
