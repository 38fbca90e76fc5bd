"""Features of species, as displacements of the dog's skin: head and trunk of other outline, hooves, humps, horns.

All lengths are in metres of the dog, which is 0.8 m high.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from homolog.geometry.surface import unit
from homolog.synthesis.animal_parameters import BODIES, HEADS, Form
from homolog.synthesis.animal_profiles import STATIONS, along, mixed_profile, profile
from homolog.synthesis.joints import smallest_rotation
from homolog.synthesis.quadruped import LETTERS, Quadruped

_Moves = Float[np.ndarray, "n 3"]

# The dog's head lies between these depths, and its trunk between those. Infinigen's bodies have the neck, too.
_HEAD_FROM, _HEAD_TO = 0.245, 0.468
_TRUNK_FROM, _TRUNK_TO, _TRUNK_SHARE = -0.40, 0.22, 0.72
# The height of the spine, and that of the head's axis at its back, between the eyes and at the nose.
_SPINE = 0.5
_HEAD_AXIS = ([0.0, 0.35, 1.0], [0.69, 0.69, 0.672])
# The cranium is the first part of the head, which snouts do not change; its middle is at this station.
_CRANIUM, _CRANIUM_STATION = 0.35, 4
_TALLER = (0.6, 1.35)
# Horns grow out of a disc of the forehead around this point of the left side.
_HORN, _HORN_RADIUS = np.array([0.024, 0.746, 0.335]), 0.015
_HORN_NORMAL = unit(np.array([[0.35, 0.93, 0.1]]))[0]
_HORN_STEPS = np.linspace(0, 1, 33)


def local_features(animal: Quadruped, form: Form) -> tuple[_Moves, dict[str, Float[np.ndarray, " 3"]]]:
    """How far features move each vertex of the skin, and the root of each ear."""
    head, of_ears = _head(animal, form)
    moves = form["hoof"] * animal.hoof + _trunk(animal, form) + _outgrowths(animal, form)
    return moves + head + _horns(animal, form), of_ears


def _head(animal: Quadruped, form: Form) -> tuple[_Moves, dict[str, Float[np.ndarray, " 3"]]]:
    """The head moves with its outline, the ears with their roots."""
    ears = [f"ear_{letter}" for letter in LETTERS.values()]
    roots = animal.pivots[[animal.bones.index(ear) for ear in ears]]
    of_roots = dict(zip(ears, _outlined(roots, form), strict=True))
    moves = animal.share("skull")[:, None] * _outlined(animal.surface.vertices, form)
    for ear, moved in of_roots.items():
        moves += animal.share(ear)[:, None] * moved
    return moves, of_roots


def _outlined(points: Float[np.ndarray, "p 3"], form: Form) -> Float[np.ndarray, "p 3"]:
    """How far points of the head move if the dog's outline becomes that of the form."""
    own = profile("head_carnivore_wolf")
    other, length = mixed_profile(form, HEADS, own), _HEAD_TO - _HEAD_FROM
    at = ((points[:, 2] - _HEAD_FROM) / length).clip(0, 1)
    front = np.interp(at, [0.45, 0.9], [0, 1])
    wider = 1 + (form["head_width"] * along(other.width / own.width, at) - 1) * np.interp(at, [0, 0.3], [0.4, 1])
    taller = form["head_height"] * along((other.height / own.height).clip(*_TALLER), at)
    taller = 1 + (taller - 1) * np.interp(at, [0.1, 0.6], [0, 1])
    wider, taller = wider * form["snout_width"] ** front, taller * form["snout_height"] ** front
    middle = other.middle - own.middle
    lift = length / own.length * along(middle - middle[_CRANIUM_STATION], at)
    longer = np.interp(at, [0, _CRANIUM, 1], [0, _CRANIUM, _CRANIUM + (1 - _CRANIUM) * form["snout_length"]])
    above = points[:, 1] - np.interp(at, *_HEAD_AXIS)
    bridge = form["bridge"] * _bell(at - 0.62, 0.2) * (above / 0.02).clip(0, 1)
    cheeks = form["cheeks"] * _bell(at - 0.45, 0.17) * (-above / 0.03).clip(0, 1)
    up = above * (taller - 1) + lift + bridge - cheeks
    return np.stack([points[:, 0] * (wider - 1), up, (longer * other.length / own.length - at) * length], axis=1)


def _trunk(animal: Quadruped, form: Form) -> _Moves:
    """Width and depth of the trunk along the spine, with the dog's means."""
    own = profile("body_feline_wolf")
    other, rest = mixed_profile(form, BODIES, own), animal.surface.vertices
    at = ((rest[:, 2] - _TRUNK_FROM) / (_TRUNK_TO - _TRUNK_FROM)).clip(0, 1) * _TRUNK_SHARE
    behind = STATIONS < _TRUNK_SHARE + 0.05

    def ratio(of_other: np.ndarray, of_own: np.ndarray) -> np.ndarray:
        ratios = of_other / of_own
        ratios = ratios / ratios[behind].mean()
        return along(np.where(behind, ratios, ratios[behind][-1]), at)

    moves = np.zeros_like(rest)
    moves[:, 0] = rest[:, 0] * (ratio(other.width, own.width) - 1)
    deeper = ratio(other.bottom - other.top[4], own.bottom - own.top[4])
    moves[:, 1] = np.minimum(rest[:, 1] - _SPINE, 0) * (deeper - 1)
    return np.asarray(animal.share("torso", "L_", "pelvis")[:, None] * moves)


def _outgrowths(animal: Quadruped, form: Form) -> _Moves:
    """Withers, hump, paunch, mane and dewlap: smooth bulges of parts of the skin."""
    rest = animal.surface.vertices
    x, y, z = rest.T
    trunk, shoulders = animal.share("torso", "L_", "pelvis"), animal.share("scapula", "C_")
    back = ((y - 0.42) / 0.1).clip(0, 1) * _bell(x, 0.06) * (trunk + shoulders).clip(0, 1)
    up = back * (form["withers"] * _bell(z - 0.1, 0.07) + form["hump"] * _bell(z + 0.1, 0.07))
    belly = form["paunch"] * _bell(z + 0.2, 0.13) * ((_SPINE - y) / 0.12).clip(0, 1) * trunk
    mane = animal.share("C_", "torso", "scapula") * np.exp(
        -((np.linalg.norm((rest - [0, 0.6, 0.22]) * [1.0, 0.8, 0.9], axis=1) / 0.15) ** 3)
    )
    throat = _bell(x, 0.03) * animal.share("C_", "torso") * ((z - 0.18) / 0.04).clip(0, 1)
    moves = form["mane"] * mane[:, None] * unit((rest - [0, 0.6, 0.22]) * [1.0, 1.0, 0.4])
    moves += form["dewlap"] * throat[:, None] * [0.0, -0.5, 0.5]
    moves[:, 0] += 0.4 * belly * np.tanh(x / 0.03)
    moves[:, 1] += up - belly * _bell(x, 0.07)
    return np.asarray(moves)


def _bell(values: np.ndarray, width: float) -> np.ndarray:
    return np.asarray(np.exp(-((values / width) ** 2)))


def _horns(animal: Quadruped, form: Form) -> _Moves:
    """Rings of a disc of the forehead move along a curve, the narrower the further they are from its rim."""
    moves = np.zeros_like(animal.surface.vertices)
    if form["horn_length"] <= 0:
        return moves
    for sign in (1.0, -1.0):
        mirror = np.array([sign, 1.0, 1.0])
        points = animal.surface.vertices * mirror - _HORN
        disc = (np.linalg.norm(points, axis=1) < _HORN_RADIUS) & (animal.share("skull") > 0.5)
        moves[disc] = (_horn(points[disc], form) - points[disc]) * mirror
    return moves


def _horn(points: Float[np.ndarray, "d 3"], form: Form) -> Float[np.ndarray, "d 3"]:
    """Points of the left horn for points of the disc, both from the disc's middle."""
    flat = points - np.outer(points @ _HORN_NORMAL, _HORN_NORMAL)
    ring = np.linalg.norm(flat, axis=1)
    at = 1 - (ring / _HORN_RADIUS).clip(0, 1)
    # Unit vectors that lean to the left and backwards from straight up.
    side = np.deg2rad(form["horn_side"] + form["horn_side_bend"] * _HORN_STEPS)
    back = np.deg2rad(form["horn_back"] + form["horn_back_bend"] * _HORN_STEPS)
    ahead = np.stack([np.sin(side), np.cos(side) * np.cos(back), -np.cos(side) * np.sin(back)], axis=1)
    curve = form["horn_length"] / (len(_HORN_STEPS) - 1) * np.cumsum(ahead, axis=0)
    here, there = (np.stack([np.interp(at, _HORN_STEPS, x) for x in values.T], axis=1) for values in (curve, ahead))
    turned = [smallest_rotation(_HORN_NORMAL, direction) for direction in unit(there)]
    root = np.interp(at, [0, 0.25], [0, 1])
    girth = root * form["horn_radius"] * np.sqrt(1 - at) * (1 - 0.25 * at) + (1 - root) * ring
    grown = here + girth[:, None] * np.einsum("dij,dj->di", np.array(turned), unit(flat))
    return np.asarray(points + np.interp(at, [0, 0.15], [0, 1])[:, None] * (grown - points))
