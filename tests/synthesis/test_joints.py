"""Joints: what an angle does to a stick figure, limb by limb."""

import numpy as np
import pytest
from stand_in import stick_skeleton

from homolog.synthesis.joints import RANGES, bone_rotations, mirrored, within_ranges

ARM = ("clavicle", "shoulder01", "upperarm01", "upperarm02", "lowerarm01", "lowerarm02", "wrist")
LEG = ("upperleg01", "lowerleg01", "foot")
TRUNK = ("root", "spine05", "spine04", "spine03", "spine02", "spine01")
AXES = {
    "left": (1, 0, 0),
    "right": (-1, 0, 0),
    "up": (0, 1, 0),
    "down": (0, -1, 0),
    "front": (0, 0, 1),
    "back": (0, 0, -1),
}


def turned(chain, **angles):
    """What all bones of a chain together do."""
    rotations = bone_rotations({**dict.fromkeys(RANGES, 0.0), **angles}, stick_skeleton())
    total = np.eye(3)
    for bone in chain:
        total = total @ rotations.get(bone, np.eye(3))
    return total


def direction(start, end):
    skeleton = stick_skeleton()
    along = skeleton[end] - skeleton[start]
    return along / np.linalg.norm(along)


def left(chain):
    return [f"{bone}.L" for bone in chain]


UPPER = direction("upperarm01.L", "lowerarm01.L")
FORE = direction("lowerarm01.L", "wrist.L")


def upper_arm(**angles):
    return turned(left(ARM[:3]), **{f"left_shoulder_{name}": angle for name, angle in angles.items()}) @ UPPER


@pytest.mark.parametrize(
    ("angles", "towards"),
    [
        ({}, "down"),
        ({"elevation": 90.0}, "left"),
        ({"elevation": 90.0, "plane": 90.0}, "front"),
        ({"elevation": 60.0, "plane": -90.0}, (0.0, -0.5, -np.sqrt(0.75))),
        ({"elevation": 180.0}, "up"),
        ({"elevation": 180.0, "plane": 90.0}, "up"),
        ({"elevation": 90.0, "rotation": 50.0}, "left"),
    ],
)
def test_the_upper_arm(angles, towards):
    np.testing.assert_allclose(upper_arm(**angles), AXES.get(towards, towards), atol=1e-9)


def forearm(**angles):
    return turned(left(ARM[:5]), **{f"left_{name}": angle for name, angle in angles.items()}) @ FORE


@pytest.mark.parametrize(
    ("angles", "towards"),
    [
        ({}, "down"),
        ({"elbow_flexion": 90.0, "shoulder_rotation": 0.0}, "front"),
        ({"elbow_flexion": 90.0, "shoulder_elevation": 90.0, "shoulder_plane": 90.0}, "up"),
        ({"elbow_flexion": 180.0}, "up"),
    ],
)
def test_the_forearm(angles, towards):
    np.testing.assert_allclose(forearm(**angles), AXES[towards], atol=0.12)


def test_turning_the_arm_inwards_brings_the_forearm_to_the_other_side():
    straight = forearm(elbow_flexion=90.0)
    inwards = forearm(elbow_flexion=90.0, shoulder_rotation=45.0)
    assert inwards[0] < straight[0] - 0.5
    assert inwards @ straight == pytest.approx(np.cos(np.pi / 4), abs=0.02)


@pytest.mark.parametrize(
    ("chain", "angles", "start", "towards"),
    [
        (LEG[:1], {"hip_flexion": 90.0}, "down", "front"),
        (LEG[:1], {"hip_abduction": 90.0}, "down", "left"),
        (LEG[:1], {"hip_rotation": 90.0}, "front", "left"),
        (LEG[:2], {"knee_flexion": 90.0}, "down", "back"),
        (LEG[:2], {"hip_flexion": 90.0, "knee_flexion": 90.0}, "down", "down"),
        (LEG, {"ankle_dorsiflexion": 90.0}, "front", "up"),
        (LEG, {"hip_flexion": 30.0, "knee_flexion": 50.0, "ankle_dorsiflexion": 20.0}, "front", "front"),
    ],
)
def test_the_leg(chain, angles, start, towards):
    total = turned(left(chain), **{f"left_{name}": angle for name, angle in angles.items()})
    np.testing.assert_allclose(total @ AXES[start], AXES[towards], atol=1e-9)


@pytest.mark.parametrize(
    ("angles", "start", "towards"),
    [
        ({"trunk_flexion": 90.0}, "up", "front"),
        ({"trunk_rotation": 90.0}, "front", "left"),
        ({"trunk_bend": 90.0}, "up", "left"),
        ({"lean": 90.0}, "up", "front"),
        ({"sway": 90.0}, "up", "left"),
        ({"heading": 90.0}, "front", "left"),
        ({"lean": -40.0, "trunk_flexion": 40.0}, "up", "up"),
    ],
)
def test_the_trunk(angles, start, towards):
    np.testing.assert_allclose(turned(TRUNK, **angles) @ AXES[start], AXES[towards], atol=1e-9)


def test_fingers_curl_towards_the_palm():
    open_hand = turned(["finger3-1.L", "finger3-2.L"]) @ direction("finger3-2.L", "finger3-3.L")
    curled = turned(["finger3-1.L", "finger3-2.L"], left_finger_curl=40.0) @ direction("finger3-2.L", "finger3-3.L")
    first = direction("finger3-1.L", "finger3-2.L")
    bent_at_rest = np.arccos(first @ open_hand)
    assert np.arccos(first @ curled) == pytest.approx(bent_at_rest + np.deg2rad(1.8 * 40.0))


def test_the_right_side_mirrors_the_left():
    generator = np.random.default_rng(0)
    angles = {name: generator.uniform(*limits) for name, limits in RANGES.items()}
    first, second = bone_rotations(angles, stick_skeleton()), bone_rotations(mirrored(angles), stick_skeleton())
    assert mirrored(mirrored(angles)) == angles
    mirror = np.diag([-1.0, 1.0, 1.0])
    swap = {"L": "R", "R": "L"}
    for bone, rotation in first.items():
        stem, _, side = bone.partition(".")
        other = f"{stem}.{swap[side]}" if side else bone
        np.testing.assert_allclose(mirror @ rotation @ mirror, second[other], atol=1e-6 if side else 0.3, err_msg=bone)


def test_everything_is_a_rotation():
    generator = np.random.default_rng(1)
    angles = {name: generator.uniform(*limits) for name, limits in RANGES.items()}
    for rotation in bone_rotations(angles, stick_skeleton()).values():
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) > 0


def test_angles_are_brought_into_range():
    wild = within_ranges(dict.fromkeys(RANGES, 1000.0))
    assert all(wild[name] == high for name, (_, high) in RANGES.items())
    behind = within_ranges(
        {**dict.fromkeys(RANGES, 0.0), "left_shoulder_plane": -90.0, "left_shoulder_elevation": 170.0}
    )
    assert behind["left_shoulder_elevation"] == 60.0
