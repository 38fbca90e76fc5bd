"""An individual: the quadruped with bones stretched in length and girth, and with the features of its species."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float

from homolog.geometry.surface import unit
from homolog.synthesis.animal_features import local_features
from homolog.synthesis.animal_joints import bone_turns
from homolog.synthesis.animal_parameters import JOINTS, Form, complete
from homolog.synthesis.quadruped import LETTERS, LOIN, NECK, TAIL, Quadruped

# How often the maps of bones are averaged over neighbouring vertices.
_SMOOTH_ROUNDS = 25
# Rounds and steps of smoothing without shrinkage, of all but faces and toes.
_SKIN_ROUNDS, _SKIN_STEPS = 8, (0.5, -0.53)
_HIND_LEGS = tuple(f"{bone}_{letter}" for bone in ("upper_leg", "lower_leg", "foot") for letter in LETTERS.values())
_REGIONS = ("chest", "belly", "hip")
_X, _, _Z = np.eye(3)


@dataclass(frozen=True)
class Individual:
    """One animal that stands: the vertices of its skin, and the points that its bones turn about."""

    vertices: Float[np.ndarray, "n 3"]
    pivots: Float[np.ndarray, "b 3"]


def individual(form: Form, bumps: Float[np.ndarray, " n"] | float = 0.0) -> Individual:
    """Give the quadruped a form.

    Args:
        form: its parameters.
        bumps: how far each vertex of the skin moves along its normal, in metres of the dog.
    """
    animal, form = Quadruped.load(), complete(form)
    stretches, turns = _level(animal, _stretches(animal, form), _stance(form)), _stance(form)
    rest = animal.surface.vertices
    vertices, pivots, linear = animal.followed(
        rest, animal.pivots, turns=turns, stretches=stretches, smooth_rounds=_SMOOTH_ROUNDS
    )
    local, of_ears = local_features(animal, form)
    local += np.broadcast_to(bumps, len(rest))[:, None] * animal.surface.vertex_normals
    vertices = _smoothed(animal, vertices + np.einsum("nij,nj->ni", linear, local))
    for bone, moved in of_ears.items():
        pivots[animal.bones.index(bone)] += form["head"] * moved
    return Individual(form["size"] * vertices, form["size"] * pivots)


def _level(animal: Quadruped, stretches: Float[np.ndarray, "b 3 3"], turns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Stretches with hind legs as long as the fore legs need."""
    vertices, pivots, _ = animal.followed(animal.surface.vertices, animal.pivots, turns=turns, stretches=stretches)
    hip = pivots[animal.bones.index("upper_leg_L"), 1]
    fore, hind = (vertices[animal.share(bone) > 0.5, 1].min() for bone in ("finger", "toe"))
    longer = stretches.copy()
    for bone in map(animal.bones.index, _HIND_LEGS):
        axis = _axis(animal.bones[bone])
        longer[bone] += ((hip - fore) / (hip - hind) - 1) * stretches[bone] @ np.outer(axis, axis)
    return longer


def _smoothed(animal: Quadruped, vertices: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """G. Taubin, "A signal processing approach to fair surface design" (SIGGRAPH 1995)."""
    moves = 1 - animal.share("skull", "ear", "toe", "finger").clip(0, 1)[:, None]
    for _ in range(_SKIN_ROUNDS):
        for step in _SKIN_STEPS:
            vertices = vertices + step * moves * (animal.means @ vertices - vertices)
    return vertices


def _stance(form: Form) -> dict[str, np.ndarray]:
    """How bones are turned while the animal stands; limbs stay upright where the trunk slopes."""
    angles = {"rise": form["rise"], "neck_flexion": form["stance_neck"], "head_flexion": form["stance_head"]}
    angles["tail_raise"] = form["stance_tail"]
    for side in LETTERS:
        angles |= {f"{side}_{joint}": form[f"stance_{joint}"] for joint in JOINTS}
        angles[f"{side}_ear_droop"] = form["ear_droop"]
        angles[f"{side}_hip"] -= form["rise"]
        angles[f"{side}_shoulder"] -= form["rise"]
    return dict(bone_turns(angles))


def _stretches(animal: Quadruped, form: Form) -> Float[np.ndarray, "b 3 3"]:
    """The stretch of each bone, as a matrix."""
    found = []
    for bone in animal.bones:
        ahead = _axis(bone)
        side = unit((_X - ahead * ahead[0])[None])[0]
        axes = np.stack([ahead, side, np.cross(ahead, side)])
        found.append(axes.T @ np.diag(_factors(bone, form)) @ axes)
    return np.array(found)


def _factors(bone: str, form: Form) -> tuple[float, float, float]:
    """By how much a bone is stretched along its axis, sideways, and at right angles to both."""
    name = bone[:-2] if bone[-2:] in ("_L", "_R") else bone
    if name in LOIN:
        at = LOIN.index(name) / 6
        width, depth = (_between(at, *(form[f"{region}_{way}"] for region in _REGIONS)) for way in ("width", "depth"))
        return form["loin_length"], width, depth
    if name in NECK:
        girth = _between(NECK.index(name) / 6, form["neck_base"], form["neck_top"])
        return form["neck_length"], girth * form["neck_width"], girth
    if name in TAIL:
        ends = [form["tail_base"], form["tail_middle"], form["tail_tip"], 0.5 * form["tail_tip"]]
        girth = float(np.interp(TAIL.index(name) / 20, [0, 0.4, 0.8, 1], ends))
        return form["tail_length"], girth, girth
    if name in ("torso", "scapula", "pelvis"):
        region = "hip" if name == "pelvis" else "chest"
        return form[f"{region}_length"], form[f"{region}_width"], form[f"{region}_depth"]
    if name in ("finger", "toe"):
        return form["paw"] * form["paw_length"], form["paw"], form["paw"] * form["paw_height"]
    if name == "skull":
        return form["head"], form["head"], form["head"]
    if name == "ear":
        return form["head"] * form["ear_length"], form["head"] * form["ear_width"], form["head"] * form["ear_width"]
    return form[f"{name}_length"], form[f"{name}_girth"], form[f"{name}_girth"]


def _between(at: float, *values: float) -> float:
    """Interpolate values at even steps from 0 to 1."""
    return float(np.interp(at, np.linspace(0, 1, len(values)), values))


@cache
def _axis(bone: str) -> Float[np.ndarray, " 3"]:
    """The direction of a bone that is stretched along itself; others are stretched along the animal."""
    animal = Quadruped.load()
    if bone[:-2] == "ear":
        return np.asarray(unit(np.array([[0.037 if bone.endswith("L") else -0.037, 0.065, 0.0]]))[0])
    here = animal.bones.index(bone)
    (children,) = np.nonzero(animal.parents == here)
    limb = bone[:-2] in ("upper_arm", "lower_arm", "hand", "upper_leg", "lower_leg", "foot")
    if not (limb or bone in (*NECK, *TAIL)):
        return _Z
    if not len(children):
        return _axis(animal.bones[animal.parents[here]])
    along = (animal.pivots[children[0]] - animal.pivots[here]) * [0.0, 1.0, 1.0]
    return np.asarray(unit(along[None])[0])
