"""The parameters of an animal's form: factors, relative to the dog, and amounts, which are 0 for the dog."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

Form = Mapping[str, float]
"""The parameters of one animal; those that are missing are the dog's."""

FACTORS = (
    *("size", "chest_length", "chest_width", "chest_depth", "loin_length", "belly_width", "belly_depth"),
    *("hip_length", "hip_width", "hip_depth", "neck_length", "neck_base", "neck_top", "neck_width"),
    *("head", "head_width", "head_height", "snout_length", "snout_width", "snout_height", "ear_length", "ear_width"),
    *(f"{bone}_{way}" for bone in ("upper_arm", "lower_arm", "hand") for way in ("length", "girth")),
    *(f"{bone}_{way}" for bone in ("upper_leg", "lower_leg", "foot") for way in ("length", "girth")),
    *("paw", "paw_length", "paw_height", "tail_length", "tail_base", "tail_middle", "tail_tip"),
)
"""Lengths, widths and depths of parts, each 1 for the dog; girth is that of a bone's cross section."""

HEADS = ("head_carnivore_tiger", *(f"head_herbivore_{name}" for name in ("cow", "giraffe", "goat", "llama")))
"""Shares of other species in the head; what they leave is the dog's."""

BODIES = (
    *(f"body_feline_{name}" for name in ("cheetah", "housecat", "tiger", "tiger_2")),
    *(f"body_herbivore_{name}" for name in ("cow", "giraffe", "goat", "llama")),
)
"""Shares of other species in the trunk; what they leave is the dog's."""

JOINTS = ("hip", "knee", "hock", "toe", "shoulder", "elbow", "wrist", "finger")

AMOUNTS: Mapping[str, float] = {
    **dict.fromkeys((*HEADS, *BODIES), 0.0),
    # How far toes are hooves, from 0 to 1.
    "hoof": 0.0,
    # Degrees by which joints are bent in the standing animal; see ``animal_joints``.
    **{f"stance_{joint}": 0.0 for joint in (*JOINTS, "neck", "head", "tail")},
    "rise": 0.0,
    "ear_droop": 0.0,
    # Metres of the dog that the skin stands out.
    **dict.fromkeys(("withers", "hump", "paunch", "mane", "dewlap", "bridge", "cheeks"), 0.0),
    # Metres, and degrees to the side and backwards where the horn begins and added to its tip.
    "horn_length": 0.0,
    "horn_radius": 0.012,
    "horn_side": 25.0,
    "horn_back": 30.0,
    "horn_side_bend": 0.0,
    "horn_back_bend": 0.0,
}
"""All other parameters, as they are for the dog."""


def complete(form: Form) -> dict[str, float]:
    """A form with all its parameters."""
    return {**dict.fromkeys(FACTORS, 1.0), **AMOUNTS, **form}


def mixed(forms: Sequence[Form], shares: Sequence[float]) -> dict[str, float]:
    """The mean of forms with shares that sum to one: geometric of factors, arithmetic of amounts."""
    parts = [(share, complete(form)) for form, share in zip(forms, shares, strict=True)]
    means = {name: sum(share * form[name] for share, form in parts) for name in AMOUNTS}
    factors = {name: float(np.exp(sum(share * np.log(form[name]) for share, form in parts))) for name in FACTORS}
    return {**factors, **means}
