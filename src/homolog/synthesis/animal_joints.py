"""Joint angles of animals, and the turns of bones that they give.

Angles are in degrees, and 0 everywhere is the animal that stands. Axes are those of the standing animal: x to its left,
y up, z to the front. The left side is computed; the right one is its mirror image.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from homolog.synthesis.joints import Angles, Rotations
from homolog.synthesis.quadruped import LETTERS, LOIN, NECK, TAIL

# The ranges of the dog of dm_control, rounded. Limbs go forward with "shoulder" and "hip"; the other joints bend, or
# stretch where negative.
SIDED_RANGES = {
    "shoulder": (-45.0, 65.0),
    "shoulder_abduction": (-8.0, 25.0),
    "elbow": (-25.0, 105.0),
    "wrist": (-15.0, 110.0),
    "finger": (-60.0, 90.0),
    "hip": (-70.0, 110.0),
    "hip_abduction": (-8.0, 45.0),
    "knee": (-25.0, 120.0),
    "hock": (-35.0, 105.0),
    "toe": (-40.0, 80.0),
    "ear_droop": (-25.0, 25.0),
    "ear_turn": (-30.0, 30.0),
}
MIDDLE_RANGES = {
    # The orientation of the trunk; no joint limits it.
    "rise": (-30.0, 75.0),
    "sway": (-25.0, 25.0),
    "heading": (-15.0, 15.0),
    "back_flexion": (-25.0, 45.0),
    "back_bend": (-45.0, 45.0),
    "back_twist": (-20.0, 20.0),
    "neck_flexion": (-35.0, 105.0),
    "neck_bend": (-75.0, 75.0),
    "neck_twist": (-30.0, 30.0),
    "head_flexion": (-30.0, 40.0),
    "head_bend": (-25.0, 25.0),
    "head_twist": (-20.0, 20.0),
    "tail_raise": (-40.0, 80.0),
    "tail_bend": (-120.0, 120.0),
    "tail_curl": (-60.0, 120.0),
}
RANGES = {f"{side}_{name}": limits for side in LETTERS for name, limits in SIDED_RANGES.items()} | MIDDLE_RANGES

# The bones of the left side that turn about x with one joint each, by how much; positive lets a hanging limb go back.
_LIMBS = {
    "shoulder": {"scapula": -0.35, "upper_arm": -0.65},
    "elbow": {"lower_arm": -1.0},
    "wrist": {"hand": 1.0},
    "finger": {"finger": 1.0},
    "hip": {"upper_leg": -1.0},
    "knee": {"lower_leg": 1.0},
    "hock": {"foot": -1.0},
    "toe": {"toe": 1.0},
}
_ABDUCTED = {"upper_arm": "shoulder_abduction", "upper_leg": "hip_abduction"}
# The bones of the tail that raise it; the others curl.
_TAIL_ROOT = TAIL[:6]
_MIRROR = np.diag([-1.0, 1.0, 1.0])
_MIRRORED = (
    *("sway", "heading", "back_bend", "back_twist", "neck_bend", "neck_twist"),
    *("head_bend", "head_twist", "tail_bend"),
)


def within_ranges(angles: Angles) -> dict[str, float]:
    """Clip angles to the joints' ranges of motion."""
    return {name: float(np.clip(angle, *RANGES[name])) for name, angle in angles.items()}


def mirrored(angles: Angles) -> dict[str, float]:
    """The mirror image of a pose."""
    found = {}
    for name, angle in angles.items():
        side, _, rest = name.partition("_")
        other = {"left": "right", "right": "left"}.get(side)
        found[f"{other}_{rest}" if other else name] = -angle if name in _MIRRORED else angle
    return found


def bone_turns(angles: Mapping[str, float]) -> Rotations:
    """The rotation of each bone that turns, about the axes of the standing animal; child bones follow.

    Args:
        angles: by the names of ``RANGES``; missing ones are 0.
    """
    turns = _middle({name: angles.get(name, 0.0) for name in MIDDLE_RANGES})
    for side, letter in LETTERS.items():
        limbs = _limbs({name: angles.get(f"{side}_{name}", 0.0) for name in SIDED_RANGES})
        for bone, turn in limbs.items():
            turns[f"{bone}_{letter}"] = turn if letter == "L" else _MIRROR @ turn @ _MIRROR
    return turns


def _middle(angles: Angles) -> dict[str, np.ndarray]:
    turns = {"torso": _turn("yxz", angles["heading"], -angles["rise"], angles["sway"])}
    for region, bones in (("back", (*LOIN, "pelvis")), ("neck", NECK)):
        sign = -1.0 if region == "back" else 1.0
        bend, flexion, twist = (angles[f"{region}_{way}"] / len(bones) for way in ("bend", "flexion", "twist"))
        turns |= dict.fromkeys(bones, _turn("yxz", sign * bend, sign * flexion, twist))
    turns["skull"] = _turn("yxz", angles["head_bend"], angles["head_flexion"], angles["head_twist"])
    for bone in TAIL:
        way, of = ("tail_raise", _TAIL_ROOT) if bone in _TAIL_ROOT else ("tail_curl", TAIL[len(_TAIL_ROOT) :])
        turns[bone] = _turn("yxz", -angles["tail_bend"] / len(TAIL), angles[way] / len(of), 0.0)
    return turns


def _limbs(angles: Angles) -> dict[str, np.ndarray]:
    """The left limbs and the left ear."""
    bent = {bone: share * angles[joint] for joint, bones in _LIMBS.items() for bone, share in bones.items()}
    turns = {bone: _turn("zx", angles.get(_ABDUCTED.get(bone, ""), 0.0), degrees) for bone, degrees in bent.items()}
    return {**turns, "ear": _turn("zy", -angles["ear_droop"], angles["ear_turn"])}


def _turn(axes: str, *degrees: float) -> np.ndarray:
    """Rotations about axes of the animal, the last one first."""
    return np.asarray(Rotation.from_euler(axes.upper(), degrees, degrees=True).as_matrix())
