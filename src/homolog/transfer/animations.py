"""Animations of glTF: how joints, and the weights of blend shapes, change with time; read, and done to other joints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from homolog.core.memory import expansion_fault
from homolog.geometry.deformation import nearest_rotations
from homolog.shapes.formats.gltf import Gltf, local_transform
from homolog.shapes.formats.parsing import CUT_OFF, UnreadableError

Animated = Literal["translation", "rotation", "scale", "weights"]
"""What a track changes, by glTF's names: a part of a joint's transform, or the weights of all blend shapes."""

_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
_AT_REST = {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0), "scale": (1.0, 1.0, 1.0)}
# Splines are written as this many straight steps from key to key.
_PIECES = 8
# What reading takes for each key of each channel, with its transforms.
_KEY_BYTES = 800
# What differs less from the bind pose is not animated; of lengths, relative to the skeleton's.
_STILL = 1e-6


@dataclass(frozen=True, eq=False)
class Track:
    """How one value changes with time, linearly between keys; rotations on the shortest way.

    Args:
        path: what changes.
        times: of the keys in seconds, ascending (t,).
        values: at each key (t, k): positions and scales of joints relative to the joint above, quaternions (x, y, z,
            w), or weights.
        joint: its number; -1 for weights.
        steps: whether a value holds until the next key.
    """

    path: Animated
    times: Float[np.ndarray, " t"]
    values: Float[np.ndarray, "t k"]
    joint: int = -1
    steps: bool = False


@dataclass(frozen=True, eq=False)
class Animation:
    """A named movement.

    Args:
        name: as in the file; numbered where it has none.
        tracks: all that moves.
    """

    name: str
    tracks: tuple[Track, ...]


class _Sampler(NamedTuple):
    """The keys of one channel.

    Args:
        times: ascending.
        values: at each key: the tangent before it, the value, and the tangent behind it (t, 3, k).
        kind: ``STEP``, ``LINEAR`` or ``CUBICSPLINE``.
    """

    times: Float[np.ndarray, " t"]
    values: Float[np.ndarray, "t 3 k"]
    kind: str

    def at(self, times: Float[np.ndarray, " s"], *, rotation: bool = False) -> Float[np.ndarray, "s k"]:
        """The values at any times; before the first key, and after the last one, they hold."""
        last = len(self.times) - 1
        start = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, last)
        end = np.minimum(start + 1, last)
        length = np.where(end > start, self.times[end] - self.times[start], 1.0)
        share = np.clip((times - self.times[start]) / length, 0.0, 1.0)[:, None]
        first, second = self.values[start, 1], self.values[end, 1]
        if self.kind == "STEP":
            return np.asarray(np.where(share < 1.0, first, second))
        if self.kind == "CUBICSPLINE":
            out, into = length[:, None] * self.values[start, 2], length[:, None] * self.values[end, 0]
            cubes = 2 * share**3 - 3 * share**2
            return np.asarray(
                (1 + cubes) * first
                - cubes * second
                + (share**3 - 2 * share**2 + share) * out
                + (share**3 - share**2) * into
            )
        if not rotation:
            return np.asarray((1 - share) * first + share * second)
        turn = Rotation.from_quat(first)
        return np.asarray(
            (turn * Rotation.from_rotvec(share * (turn.inv() * Rotation.from_quat(second)).as_rotvec())).as_quat()
        )


Channels = Mapping[tuple[int, str], _Sampler]


def channels_of(file: Gltf, widths: Mapping[int, int]) -> Iterator[tuple[str, Channels]]:
    """The animations of a file: name, and by node and path what changes.

    Args:
        file: the file.
        widths: for each node with morph targets how many its mesh has.

    Raises:
        UnreadableError: if they are damaged, or would not fit.
    """
    entries = file.header.get("animations", [])
    names = unique([str(entry.get("name", f"animation {number}")) for number, entry in enumerate(entries)])
    wanted = [(entry, channel) for entry in entries for channel in entry["channels"]]
    counts = [file.header["accessors"][_sampler_entry(*each)["input"]]["count"] for each in wanted]
    if fault := expansion_fault(_KEY_BYTES * sum(counts), file.size):
        raise UnreadableError(f"its animations have {sum(counts)} keys; {fault}")
    for name, entry in zip(names, entries, strict=True):
        found = dict[tuple[int, str], _Sampler]()
        for channel in entry["channels"]:
            node, path = channel["target"].get("node"), channel["target"]["path"]
            width = widths.get(node, 0) if path == "weights" else _WIDTHS.get(path, 0)
            if node is not None and width:
                found[node, path] = _sampler(file, _sampler_entry(entry, channel), width)
        yield name, found


def unique(names: Sequence[str]) -> list[str]:
    """Names of which none occurs twice: later ones get a number.

    Examples:
        >>> unique(["wave", "nod", "wave"])
        ['wave', 'nod', 'wave 2']
    """
    found = dict[str, None]()
    for name in names:
        number, free = 1, name
        while free in found:
            number += 1
            free = f"{name} {number}"
        found[free] = None
    return list(found)


def _sampler_entry(animation: dict[str, Any], channel: dict[str, Any]) -> dict[str, Any]:
    number = channel["sampler"]
    if not 0 <= number < len(animation["samplers"]):
        raise UnreadableError(f"it refers to sampler {number} of an animation that does not exist; {CUT_OFF}")
    entry: dict[str, Any] = animation["samplers"][number]
    return entry


def _sampler(file: Gltf, entry: dict[str, Any], width: int) -> _Sampler:
    kind = str(entry.get("interpolation", "LINEAR"))
    given = file.accessor(entry["input"], "SCALAR")[:, 0].astype(np.float64)
    rows = file.accessor(entry["output"]).astype(np.float64)
    parts = 3 if kind == "CUBICSPLINE" else 1
    if not len(given) or not np.isfinite(given).all() or rows.size != len(given) * parts * width:
        raise UnreadableError(f"an animation has {len(given)} keys, but {rows.size} numbers for them; {CUT_OFF}")
    times, first = np.unique(given, return_index=True)
    values = rows.reshape(len(given), parts, width)[first]
    return _Sampler(times, np.repeat(values, 3, axis=1) if parts == 1 else values, kind)


def _keys(samplers: Sequence[_Sampler]) -> tuple[Float[np.ndarray, " t"], bool]:
    """The times at which samplers have keys, with pieces of splines, and whether all hold their values."""
    times = list[np.ndarray]()
    for sampler in samplers:
        if sampler.kind == "CUBICSPLINE":
            count = len(sampler.times)
            at = np.linspace(0, count - 1, _PIECES * (count - 1) + 1)
            times.append(np.interp(at, np.arange(count), sampler.times))
        else:
            times.append(sampler.times)
    return np.unique(np.concatenate(times)), all(sampler.kind == "STEP" for sampler in samplers)


def joint_animations(
    file: Gltf, joints: Sequence[int], parents: Int[np.ndarray, " j"], frames: Float[np.ndarray, "j 4 4"]
) -> tuple[Animation, ...]:
    """How the joints of a skin move, for joints without scales that lie where the file's lie.

    Nodes between two joints, and those above the first one, move the joint below them.

    Args:
        file: the file.
        joints: the number of each joint's node.
        parents: the joint above each, -1 for none.
        frames: of the joints in the bind pose, in the scene.

    Raises:
        UnreadableError: if an animation is damaged.
    """
    unscaled = np.stack([np.linalg.pinv(file.world(joint)) for joint in joints]) @ frames
    found = list[Animation]()
    for name, channels in channels_of(file, {}):
        tracks = list[Track]()
        for number, joint in enumerate(joints):
            parent = int(parents[number])
            chain, above = list[int](), None if parent < 0 else joints[parent]
            step: int | None = joint
            while step is not None and step != above:
                chain.append(step)
                step = file.parents.get(step)
            moving = [channels[node, path] for node in chain for path in _WIDTHS if (node, path) in channels]
            if not moving:
                continue
            times, steps = _keys(moving)
            local = np.tile(np.eye(4), (len(times), 1, 1))
            for node in reversed(chain):
                local = local @ _transforms(file, node, channels, times)
            before = np.eye(4) if parent < 0 else np.linalg.inv(unscaled[parent])
            rest = frames[number] if parent < 0 else np.linalg.inv(frames[parent]) @ frames[number]
            tracks += _tracks(number, times, before @ local @ unscaled[number], rest, steps)
        if tracks:
            found.append(Animation(name, tuple(tracks)))
    return tuple(found)


def _transforms(
    file: Gltf, node: int, channels: Channels, times: Float[np.ndarray, " t"]
) -> Float[np.ndarray, "t 4 4"]:
    """The transform of a node relative to the one above it at some times."""
    entry = file.nodes[node]
    own = {path: channels[node, path] for path in _WIDTHS if (node, path) in channels}
    if not own:
        return np.tile(local_transform(entry, f"node {node}"), (len(times), 1, 1))
    values = {
        path: own[path].at(times, rotation=path == "rotation")
        if path in own
        else np.tile(np.asarray(entry.get(path, rest), dtype=np.float64), (len(times), 1))
        for path, rest in _AT_REST.items()
    }
    found = np.tile(np.eye(4), (len(times), 1, 1))
    found[:, :3, :3] = Rotation.from_quat(values["rotation"]).as_matrix() * values["scale"][:, None, :]
    found[:, :3, 3] = values["translation"]
    return found


def _tracks(
    joint: int,
    times: Float[np.ndarray, " t"],
    local: Float[np.ndarray, "t 4 4"],
    rest: Float[np.ndarray, "4 4"],
    steps: bool,
) -> Iterator[Track]:
    """Translations, rotations and scales of transforms, of those that ever differ from a joint's bind pose."""
    turns = nearest_rotations(local[:, :3, :3])
    scales = np.einsum("tki,tki->ti", turns, local[:, :3, :3])
    if not np.allclose(
        local[:, :3, 3], rest[:3, 3], rtol=0, atol=_STILL * max(float(np.abs(rest[:3, 3]).max()), _STILL)
    ):
        yield Track("translation", times, local[:, :3, 3], joint, steps)
    if not np.allclose(turns, rest[:3, :3], rtol=0, atol=_STILL):
        yield Track("rotation", times, _quaternions(turns), joint, steps)
    if not np.allclose(scales, 1.0, rtol=0, atol=_STILL):
        yield Track("scale", times, scales, joint, steps)


def _quaternions(turns: Float[np.ndarray, "t 3 3"]) -> Float[np.ndarray, "t 4"]:
    """Of each rotation the quaternion that is nearer to the one before it."""
    found = Rotation.from_matrix(turns).as_quat()
    signs = np.sign(np.einsum("tk,tk->t", found[1:], found[:-1]))
    return np.asarray(found * np.cumprod([1.0, *np.where(signs == 0, 1.0, signs)])[:, None])


def weight_animations(
    file: Gltf, names_of: Mapping[int, Sequence[str]], names: Sequence[str], weights: Float[np.ndarray, " k"]
) -> tuple[Animation, ...]:
    """How the weights of blend shapes change.

    Args:
        file: the file.
        names_of: for each node with morph targets their names.
        names: of all blend shapes.
        weights: of each where nothing changes it.

    Raises:
        UnreadableError: if an animation is damaged.
    """
    found = list[Animation]()
    for name, channels in channels_of(file, {node: len(own) for node, own in names_of.items()}):
        moving = {node: sampler for (node, path), sampler in channels.items() if path == "weights" and node in names_of}
        if not moving:
            continue
        times, steps = _keys([*moving.values()])
        values = np.tile(weights, (len(times), 1))
        for node, sampler in moving.items():
            values[:, [names.index(own) for own in names_of[node]]] = sampler.at(times)
        found.append(Animation(name, (Track("weights", times, values, steps=steps),)))
    return tuple(found)


def carried_animations(
    animations: Sequence[Animation],
    parents: Int[np.ndarray, " j"],
    before: Float[np.ndarray, "j 4 4"],
    after: Float[np.ndarray, "j 4 4"],
    scales: Float[np.ndarray, " j"],
) -> tuple[Animation, ...]:
    """The movements of joints for a skeleton whose joints have been moved, turned and scaled.

    A joint turns about its own axes as it did, and shifts in the axes of the joint above it, times its scale. New here.

    Args:
        animations: of the joints.
        parents: the joint above each, -1 for none.
        before: the joints in the bind pose.
        after: the same of the other skeleton.
        scales: of the surroundings of each.
    """
    roots: Bool[np.ndarray, " j"] = parents < 0
    old, new = (
        np.where(roots[:, None, None], frames, np.linalg.inv(frames[parents]) @ frames) for frames in (before, after)
    )
    axes = np.where(roots[:, None, None], (after @ np.linalg.inv(before))[:, :3, :3], np.eye(3))

    def carried(track: Track) -> Track:
        joint = track.joint
        if track.path == "translation":
            shifts = scales[joint] * (track.values - old[joint, :3, 3]) @ axes[joint].T
            return replace(track, values=new[joint, :3, 3] + shifts)
        if track.path == "rotation":
            turn = Rotation.from_matrix(new[joint, :3, :3] @ old[joint, :3, :3].T)
            return replace(track, values=_quaternions((turn * Rotation.from_quat(track.values)).as_matrix()))
        return track

    return tuple(Animation(each.name, tuple(map(carried, each.tracks))) for each in animations)
