"""Joint angles of the body: ranges of motion, and the bone rotations that they give.

Angles are in degrees and anatomical: 0 everywhere is a person standing upright with hanging arms. Axes are those of the
standing body: x to its left, y up, z to the front. The left side is computed; the right one is its mirror image.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from homolog.geometry.surface import unit

Angles = Mapping[str, float]
Skeleton = Mapping[str, Float[np.ndarray, " 3"]]
"""The origin of each bone, on the mean body in the rest pose."""
Rotations = Mapping[str, Float[np.ndarray, "3 3"]]
"""The rotation of each rotated bone about the axes of the standing body; child bones follow."""

# Active motion of healthy people: American Academy of Orthopaedic Surgeons, "Joint Motion: Method of Measuring and
# Recording" (1965), and D. C. Boone and S. P. Azen, "Normal range of motion of joints in male subjects" (J. Bone Joint
# Surg. 61-A, 1979). The planes of the raised arm are those of G. Wu et al., "ISB recommendation on definitions of joint
# coordinate systems, part II" (J. Biomech. 38, 2005): 0 to the side, 90 to the front.
SIDED_RANGES = {
    "shoulder_elevation": (0.0, 180.0),
    "shoulder_plane": (-90.0, 130.0),
    "shoulder_rotation": (-90.0, 70.0),
    "elbow_flexion": (0.0, 150.0),
    "forearm_pronation": (-80.0, 80.0),
    "wrist_flexion": (-70.0, 80.0),
    "wrist_deviation": (-20.0, 30.0),
    "finger_curl": (0.0, 90.0),
    "hip_flexion": (-30.0, 120.0),
    "hip_abduction": (-30.0, 45.0),
    "hip_rotation": (-45.0, 45.0),
    "knee_flexion": (0.0, 135.0),
    "ankle_dorsiflexion": (-50.0, 20.0),
    "toe_extension": (0.0, 60.0),
}
MIDDLE_RANGES = {
    "trunk_flexion": (-25.0, 80.0),
    "trunk_bend": (-35.0, 35.0),
    "trunk_rotation": (-45.0, 45.0),
    "neck_flexion": (-45.0, 45.0),
    "neck_bend": (-45.0, 45.0),
    "neck_rotation": (-60.0, 60.0),
    # The orientation of the pelvis, and with it of the body; no joint limits it.
    "lean": (-30.0, 80.0),
    "sway": (-20.0, 20.0),
    "heading": (-15.0, 15.0),
}
SIDES = ("left", "right")
RANGES = {f"{side}_{name}": limits for side in SIDES for name, limits in SIDED_RANGES.items()} | MIDDLE_RANGES

WIDE_RANGES = RANGES | {
    "trunk_flexion": (-45.0, 80.0),
    "lean": (-80.0, 100.0),
    **{f"{side}_hip_flexion": (-45.0, 125.0) for side in SIDES},
}
"""Ranges of gymnasts, in the same order."""

# The largest elevation of the arm backwards.
_BACKWARD_ELEVATION = 60.0
# The shoulder blade contributes a third of an arm's elevation beyond 30 degrees, here in two bones (V. T. Inman et al.,
# "Observations on the function of the shoulder joint", J. Bone Joint Surg. 26, 1944).
_GIRDLE = {"clavicle": 0.13, "shoulder01": 0.2}
_GIRDLE_FROM = 30.0
# Shares of the spine's bones, from below, and the neck's in bending and axial rotation: the lumbar spine hardly
# rotates, the thoracic spine hardly bends.
_SPINE = ("spine05", "spine04", "spine03", "spine02", "spine01")
_SPINE_BENDS = (0.25, 0.25, 0.2, 0.15, 0.15)
_SPINE_ROTATIONS = (0.05, 0.1, 0.2, 0.3, 0.35)
_NECK = ("neck01", "neck02", "neck03", "head")
_NECK_SHARES = (0.2, 0.25, 0.25, 0.3)

_X, _Y, _Z = np.eye(3)
_MIRROR = np.diag([-1.0, 1.0, 1.0])


def within_ranges(angles: Angles, ranges: Mapping[str, tuple[float, float]] = RANGES) -> dict[str, float]:
    """Clip angles to the joints' ranges of motion."""
    allowed = {name: float(np.clip(angle, *ranges[name])) for name, angle in angles.items()}
    for side in SIDES:
        # The largest elevation decreases linearly from sideways to backwards.
        behind = max(-allowed[f"{side}_shoulder_plane"], 0.0) / 90.0
        most = 180.0 + behind * (_BACKWARD_ELEVATION - 180.0)
        allowed[f"{side}_shoulder_elevation"] = min(allowed[f"{side}_shoulder_elevation"], most)
    return allowed


def mirrored(angles: Angles) -> dict[str, float]:
    """The mirror image of a pose."""
    swapped = {"left": "right", "right": "left"}
    signed = ("trunk_bend", "trunk_rotation", "neck_bend", "neck_rotation", "sway", "heading")
    found = {}
    for name, angle in angles.items():
        side, _, rest = name.partition("_")
        found[f"{swapped[side]}_{rest}" if side in swapped else name] = -angle if name in signed else angle
    return found


def bone_rotations(angles: Angles, skeleton: Skeleton) -> dict[str, Float[np.ndarray, "3 3"]]:
    """The rotation of each bone for given joint angles.

    Args:
        angles: one for each name in ``RANGES``.
        skeleton: of the mean body in the rest pose, whose arms are half raised and half bent.
    """
    rotations = _middle(angles)
    for side, letter in zip(SIDES, "LR", strict=True):
        of_side = {name: angles[f"{side}_{name}"] for name in SIDED_RANGES}
        limbs = {**_arm(of_side, skeleton), **_hand(of_side, skeleton), **_leg(of_side)}
        rotations |= {f"{bone}.{letter}": rotation for bone, rotation in limbs.items()}
    return {
        bone: _MIRROR @ rotation.as_matrix() @ _MIRROR if bone.endswith(".R") else rotation.as_matrix()
        for bone, rotation in rotations.items()
    }


def about(axis: Float[np.ndarray, " 3"], degrees: float) -> Rotation:
    """The rotation about an axis of unit length."""
    return Rotation.from_rotvec(np.deg2rad(degrees) * axis)


def _middle(angles: Angles) -> dict[str, Rotation]:
    """Trunk, neck, and the orientation of the whole body."""
    stand = about(_Y, angles["heading"]) * about(_X, angles["lean"]) * about(_Z, -angles["sway"])
    shares = zip(_SPINE + _NECK, _SPINE_BENDS + _NECK_SHARES, _SPINE_ROTATIONS + _NECK_SHARES, strict=True)
    rotations = {"root": stand}
    for bone, bends, twists in shares:
        region = "trunk" if bone in _SPINE else "neck"
        twist = about(_Y, twists * angles[f"{region}_rotation"])
        bend = about(_Z, -bends * angles[f"{region}_bend"])
        rotations[bone] = twist * bend * about(_X, bends * angles[f"{region}_flexion"])
    return rotations


def neck_rotations(angles: Angles) -> dict[str, Float[np.ndarray, "3 3"]]:
    """The rotations of the bones of trunk and neck for angles of the neck alone."""
    turned = _middle({**dict.fromkeys(MIDDLE_RANGES, 0.0), **angles})
    return {bone: rotation.as_matrix() for bone, rotation in turned.items()}


def _arm(angles: Angles, skeleton: Skeleton) -> dict[str, Rotation]:
    """The left shoulder girdle, shoulder, elbow and forearm."""
    upper, fore = direction(skeleton, "upperarm01.L", "lowerarm01.L"), direction(skeleton, "lowerarm01.L", "wrist.L")
    elbow_axis = _unit(np.cross(upper, fore))
    bent_at_rest = np.rad2deg(np.arccos(upper @ fore))
    plane, elevation = np.deg2rad(angles["shoulder_plane"]), angles["shoulder_elevation"]
    axis = np.cos(plane) * _Z - np.sin(plane) * _X
    hanging = Rotation.from_matrix(smallest_rotation(upper, -_Y))
    half_axial = about(upper, angles["shoulder_rotation"] / 2.0)
    lifted = max(elevation - _GIRDLE_FROM, 0.0)
    rotations = {bone: about(axis, share * lifted) for bone, share in _GIRDLE.items()}
    girdle = rotations["clavicle"] * rotations["shoulder01"]
    rotations["upperarm01"] = girdle.inv() * about(axis, elevation) * hanging * half_axial
    rotations["upperarm02"] = half_axial
    rotations["lowerarm01"] = about(elbow_axis, angles["elbow_flexion"] - bent_at_rest)
    rotations["lowerarm02"] = about(fore, 0.6 * angles["forearm_pronation"])
    return rotations


def _hand(angles: Angles, skeleton: Skeleton) -> dict[str, Rotation]:
    """The left wrist, with the rest of the forearm's pronation, and fingers."""
    fore, ahead = direction(skeleton, "lowerarm01.L", "wrist.L"), direction(skeleton, "wrist.L", "finger3-1.L")
    curls = {i: curl_axis(skeleton, i) for i in range(1, 6)}
    flexion_axis = _unit(curls[3] - (curls[3] @ ahead) * ahead)
    palm = np.cross(flexion_axis, ahead)
    twist = about(fore, 0.4 * angles["forearm_pronation"])
    bend = about(palm, -angles["wrist_deviation"]) * about(flexion_axis, angles["wrist_flexion"])
    rotations = {"wrist": twist * bend}
    for i, axis in curls.items():
        shares = (0.0, 0.5, 0.5) if i == 1 else (0.8, 1.0, 0.7)
        for joint, share in enumerate(shares, 1):
            rotations[f"finger{i}-{joint}"] = about(axis, share * angles["finger_curl"])
    return rotations


def _leg(angles: Angles) -> dict[str, Rotation]:
    """The left hip, knee, ankle and toes."""
    hip = about(_X, -angles["hip_flexion"]) * about(_Z, angles["hip_abduction"])
    toes = {f"toe{i}-1": about(_X, -angles["toe_extension"]) for i in range(1, 6)}
    return {
        "upperleg01": hip * about(_Y, angles["hip_rotation"]),
        "lowerleg01": about(_X, angles["knee_flexion"]),
        "foot": about(_X, -angles["ankle_dorsiflexion"]),
        **toes,
    }


def direction(skeleton: Skeleton, start: str, end: str) -> Float[np.ndarray, " 3"]:
    """The unit vector from the origin of a bone to that of another."""
    return _unit(skeleton[end] - skeleton[start])


def curl_axis(skeleton: Skeleton, finger: int) -> Float[np.ndarray, " 3"]:
    """The axis about which a left finger, a little bent at rest, bends further."""
    first = direction(skeleton, f"finger{finger}-1.L", f"finger{finger}-2.L")
    return _unit(np.cross(first, direction(skeleton, f"finger{finger}-2.L", f"finger{finger}-3.L")))


def _unit(vector: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    return np.asarray(unit(vector[None])[0])


def smallest_rotation(start: Float[np.ndarray, " 3"], end: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """The smallest rotation of one direction to another, not opposite one (Rodrigues' formula)."""
    cross = np.cross(start, end)
    skew = np.cross(np.eye(3), cross)
    return np.asarray(np.eye(3) + skew + skew @ skew / (1.0 + start @ end))
