"""Joint angles of a hand: ranges of motion, families of poses, and the bone rotations that they give.

Angles are in degrees, relative to a hand at rest, whose fingers are a little bent. The left hand is computed.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from homolog.geometry.surface import unit
from homolog.synthesis.joints import Angles, Skeleton, about, curl_axis, direction

Interval = tuple[float, float]

FINGERS = {"index": 2, "middle": 3, "ring": 4, "little": 5}
"""The fingers' numbers in the names of bones; the thumb is 1."""

# Active motion: American Academy of Orthopaedic Surgeons, "Joint Motion: Method of Measuring and Recording" (1965).
# Knuckle, middle and last joint are the three of a finger; spread is towards the thumb.
_OF_FINGER: Mapping[str, Interval] = {
    "knuckle": (-25.0, 85.0),
    "spread": (-14.0, 14.0),
    "middle_joint": (-15.0, 95.0),
    "last_joint": (-10.0, 65.0),
}
_OF_THUMB: Mapping[str, Interval] = {
    "thumb_opposition": (-20.0, 35.0),
    "thumb_spread": (-20.0, 25.0),
    "thumb_knuckle": (-20.0, 50.0),
    "thumb_last_joint": (-20.0, 60.0),
}
RANGES: Mapping[str, Interval] = {
    **{f"{finger}_{joint}": limits for finger in FINGERS for joint, limits in _OF_FINGER.items()},
    **_OF_THUMB,
}
"""The range of motion of each joint."""

AT_REST: Angles = dict.fromkeys(RANGES, 0.0)

_STRAIGHT: Mapping[str, Interval] = {"knuckle": (-18.0, 5.0), "middle_joint": (-14.0, 5.0), "last_joint": (-8.0, 5.0)}
_CURLED: Mapping[str, Interval] = {"knuckle": (45.0, 70.0), "middle_joint": (55.0, 82.0), "last_joint": (5.0, 30.0)}
_HALF: Mapping[str, Interval] = {"knuckle": (10.0, 45.0), "middle_joint": (15.0, 55.0), "last_joint": (5.0, 35.0)}
_OPEN_THUMB = {"thumb_spread": (5.0, 22.0), "thumb_opposition": (-15.0, 5.0)}
_THUMB_ACROSS = {
    "thumb_opposition": (5.0, 30.0),
    "thumb_knuckle": (5.0, 45.0),
    "thumb_last_joint": (5.0, 50.0),
    "thumb_spread": (-12.0, 8.0),
}
# Fingers apart; the middle finger stays.
_FAN = {
    "index_spread": (6.0, 14.0),
    "middle_spread": (-1.0, 3.0),
    "ring_spread": (-9.0, -3.0),
    "little_spread": (-14.0, -7.0),
}

# Names of joints without a finger stand for all fingers, sampled independently; the more special name overrides.
FAMILIES: Mapping[str, Mapping[str, Interval]] = {
    "at rest": {"knuckle": (-5.0, 12.0), "middle_joint": (-5.0, 15.0), "last_joint": (-4.0, 10.0)},
    "flat": {**_STRAIGHT, "spread": (-2.0, 2.0), "thumb_spread": (-12.0, 8.0)},
    "spread": {**_STRAIGHT, **_FAN, **_OPEN_THUMB},
    "fist": {**_CURLED, **_THUMB_ACROSS},
    "pointing": {
        **_CURLED,
        **_THUMB_ACROSS,
        **{f"index_{joint}": interval for joint, interval in _STRAIGHT.items()},
    },
    "two fingers": {
        **_CURLED,
        **_THUMB_ACROSS,
        **{f"{finger}_{joint}": interval for finger in ("index", "middle") for joint, interval in _STRAIGHT.items()},
        "index_spread": (2.0, 12.0),
        "middle_spread": (-8.0, 0.0),
    },
    "thumb up": {**_CURLED, "thumb_spread": (5.0, 25.0), "thumb_opposition": (-20.0, 0.0)},
    "grasping": {**_HALF, **_FAN, "thumb_opposition": (10.0, 35.0), "thumb_spread": (0.0, 20.0)},
    "pinching": {
        **_HALF,
        "index_knuckle": (35.0, 60.0),
        "index_middle_joint": (25.0, 50.0),
        "thumb_opposition": (15.0, 35.0),
        "thumb_knuckle": (0.0, 25.0),
        "thumb_last_joint": (0.0, 30.0),
    },
    "clawing": {
        "knuckle": (-20.0, 10.0),
        "middle_joint": (40.0, 85.0),
        "last_joint": (20.0, 55.0),
        "thumb_last_joint": (0.0, 45.0),
    },
    "bent at the knuckles": {**_STRAIGHT, "knuckle": (35.0, 75.0), "thumb_opposition": (0.0, 30.0)},
    "one by one": {
        "knuckle": (-15.0, 70.0),
        "middle_joint": (-10.0, 85.0),
        "last_joint": (-5.0, 50.0),
        "spread": (-8.0, 8.0),
        **_OF_THUMB,
    },
}
"""Intervals of the joints by family of poses."""

# Of joints that a family does not list.
_BY_DEFAULT: Interval = (-6.0, 6.0)


def draw_pose(family: str, generator: np.random.Generator) -> dict[str, float]:
    """Sample a pose of a family: the angles of all joints, in degrees, within their ranges."""
    known = FAMILIES[family]
    of_fingers = {f"{finger}_{joint}": known[joint] for finger in FINGERS for joint in _OF_FINGER if joint in known}
    intervals = {**dict.fromkeys(RANGES, _BY_DEFAULT), **of_fingers, **known}
    drawn = {name: generator.uniform(*intervals[name]) for name in RANGES}
    return {name: float(np.clip(angle, *RANGES[name])) for name, angle in drawn.items()}


def bone_rotations(angles: Angles, skeleton: Skeleton) -> dict[str, Float[np.ndarray, "3 3"]]:
    """The rotation of each bone of the left hand for given joint angles.

    Args:
        angles: one for each name in ``RANGES``.
        skeleton: of the mean body in the rest pose.
    """
    frame = hand_frame(skeleton)
    rotations = _thumb(angles, skeleton, frame)
    for finger, number in FINGERS.items():
        of_finger = {joint: angles[f"{finger}_{joint}"] for joint in _OF_FINGER}
        # Fingers bend to the palm about nearly the same axis, so that they do not meet.
        ahead = direction(skeleton, f"finger{number}-1.L", f"finger{number}-2.L")
        axis = unit((ahead * (frame[0] @ ahead) - frame[0])[None])[0]
        spread = about(frame[2], -of_finger["spread"])
        rotations[f"finger{number}-1.L"] = (spread * about(axis, of_finger["knuckle"])).as_matrix()
        rotations[f"finger{number}-2.L"] = about(axis, of_finger["middle_joint"]).as_matrix()
        rotations[f"finger{number}-3.L"] = about(axis, of_finger["last_joint"]).as_matrix()
    return rotations


def _thumb(angles: Angles, skeleton: Skeleton, frame: Float[np.ndarray, "3 3"]) -> dict[str, Float[np.ndarray, "3 3"]]:
    axis = curl_axis(skeleton, 1)
    opposed = about(frame[1], angles["thumb_opposition"])
    return {
        "finger1-1.L": (opposed * about(frame[2], -angles["thumb_spread"])).as_matrix(),
        "finger1-2.L": about(axis, angles["thumb_knuckle"]).as_matrix(),
        "finger1-3.L": about(axis, angles["thumb_last_joint"]).as_matrix(),
    }


def hand_frame(skeleton: Skeleton) -> Float[np.ndarray, "3 3"]:
    """Axes of the left hand as rows: to the thumb's side, along the fingers, and out of the back of the hand."""
    ahead = direction(skeleton, "wrist.L", "finger3-1.L")
    across = skeleton["finger2-1.L"] - skeleton["finger5-1.L"]
    across = unit((across - (across @ ahead) * ahead)[None])[0]
    return np.stack([across, ahead, np.cross(across, ahead)])
