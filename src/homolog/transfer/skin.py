"""Skins, as glTF calls a skeleton with its skinning weights: read from glTF, and transferred to another shape."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from homolog.core.errors import DataError
from homolog.core.memory import expansion_fault
from homolog.core.reasons import reason_of
from homolog.geometry.deformation import nearest_rotations
from homolog.maps import rigid_motion
from homolog.shapes import Shape
from homolog.shapes.formats.gltf import Gltf, influences, parts
from homolog.shapes.formats.parsing import UnreadableError
from homolog.transfer.animations import Animation, carried_animations, joint_animations
from homolog.transfer.smooth_map import SurfaceMap

INFLUENCES = 4
"""The largest number of joints that influence one vertex in files that are written."""

# A joint follows the points within _REACH times its distance from the surface, at least _FEWEST_AROUND of them.
_REACH = 1.5
_FEWEST_AROUND = 12
# A vertex of the skin is a point of the shape if they are nearer than this share of the shape's extent.
_SAME = 1e-5
# Of a joint's share in moving a point, when it is weighed against the file; large skins of many joints are no bombs.
_WEIGHT_BYTES = 4


@dataclass(frozen=True, eq=False)
class Skin:
    """A skeleton in its bind pose, and skinning weights.

    Args:
        names: of the joints.
        parents: the parent of each joint, -1 for none (j,).
        frames: the rigid transform of each joint in the bind pose, in the shape's coordinates (j, 4, 4).
        weights: skinning weights (n, j); rows of zeros for points that no joint influences.
        animations: of the joints.
    """

    names: tuple[str, ...]
    parents: Int[np.ndarray, " j"]
    frames: Float[np.ndarray, "j 4 4"]
    weights: Float[np.ndarray, "n j"]
    animations: tuple[Animation, ...] = ()


def read_skin(path: Path, shape: Shape) -> Skin | None:
    """Read the first skin of a GLB or glTF file, with animations of its joints.

    None if the file has none, or is of another format.

    Args:
        path: the file.
        shape: what ``read_shape`` read from it.

    Raises:
        DataError: if it is damaged.
    """
    if path.suffix.lower() not in (".glb", ".gltf"):
        return None
    try:
        file = Gltf(path)
        skinned = [number for number, node in enumerate(file.nodes) if "skin" in node and "mesh" in node]
        return _skin_of(file, file.nodes[skinned[0]]["skin"], skinned, shape) if skinned else None
    except (UnreadableError, OSError, KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise DataError(f"{path}: its skin cannot be read ({reason_of(error)}); export it again") from None


def _skin_of(file: Gltf, number: int, skinned: list[int], shape: Shape) -> Skin:
    joints: list[int] = list(file.header["skins"][number]["joints"])
    nodes = [node for node in skinned if file.nodes[node]["skin"] == number]
    if fault := expansion_fault(_WEIGHT_BYTES * shape.n_points * len(joints), file.size):
        raise UnreadableError(f"it has {len(joints)} joints; {fault}")
    vertices, weights = _skinned_vertices(file, nodes, len(joints))
    # The shape is as its joints pose it in the file.
    frames = np.stack([file.world(joint) for joint in joints])
    names = tuple(str(file.nodes[joint].get("name", f"joint {joint}")) for joint in joints)
    frames[:, :3, :3] = nearest_rotations(frames[:, :3, :3])  # without scales
    parents = _parents(file, joints)
    animations = joint_animations(file, joints, parents, frames)
    return Skin(names, parents, frames, _at_points(shape, vertices, weights), animations)


def _skinned_vertices(
    file: Gltf, nodes: list[int], n_joints: int
) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, "v j"]]:
    """Where the vertices of the nodes' meshes lie in the scene, and each joint's share in moving them."""
    positions, weights = list[np.ndarray](), list[np.ndarray]()
    for part in parts(file):
        if part.node not in nodes or "JOINTS_0" not in part.primitive["attributes"] or not len(part.points):
            continue
        shares, rows = np.zeros((len(part.points), n_joints)), np.arange(len(part.points))
        for joint, share in influences(file, part.primitive["attributes"]):
            # A joint may occur twice, the second time with the weight zero.
            np.add.at(shares, (rows, joint), share)
        positions.append(part.points)
        weights.append(shares)
    return np.concatenate(positions), np.concatenate(weights)


def _parents(file: Gltf, joints: list[int]) -> Int[np.ndarray, " j"]:
    """The nearest joint above each."""
    found = np.full(len(joints), -1)
    for number, joint in enumerate(joints):
        step = file.parents.get(joint)
        while step is not None and step not in joints:
            step = file.parents.get(step)
        found[number] = -1 if step is None else joints.index(step)
    return found


def _at_points(
    shape: Shape, vertices: Float[np.ndarray, "v 3"], weights: Float[np.ndarray, "v j"]
) -> Float[np.ndarray, "n j"]:
    """Skinning weights of the shape's points, which are the skin's vertices in any order."""
    finite = np.nan_to_num(shape.points)
    away, near = cKDTree(vertices).query(finite)
    same = away <= _SAME * float(np.ptp(finite, axis=0).max())
    if not same.any():
        raise ValueError("no vertex of the skin is a point of the shape")
    return np.where(same[:, None], weights[near], 0.0)


def transfer_skin(skin: Skin, to_source: SurfaceMap, to_target: SurfaceMap) -> Skin:
    """Transfer a skin from source to target: interpolated weights, and joints moved by local similarity transforms.

    Each point keeps its ``INFLUENCES`` largest weights, normalised. A point without a counterpart gets the weights of
    the nearest point that has one, as programs draw a point without influences at the origin. A joint is moved by the
    similarity transform that fits the correspondence of the surface nearest to it, and moves as it did
    (``carried_animations``). New here.

    Args:
        skin: the source's.
        to_source: the map from target to source.
        to_target: the map from source to target.

    Raises:
        DataError: if hardly any point of the source has a counterpart.
    """
    weights = largest_influences(_filled(to_source.surface_points.interpolate(skin.weights), to_source.source.given))
    moved = [_transfer_frame(frame, to_target) for frame in skin.frames]
    frames, scales = np.stack([frame for frame, _ in moved]), np.array([scale for _, scale in moved])
    animations = carried_animations(skin.animations, skin.parents, skin.frames, frames, scales)
    return Skin(skin.names, skin.parents, frames, weights, animations)


def _filled(weights: Float[np.ndarray, "n j"], shape: Shape) -> Float[np.ndarray, "n j"]:
    held = np.nan_to_num(weights).sum(axis=1) > 0
    if held.all() or not held.any():
        return weights
    points = np.nan_to_num(shape.points)
    _, near = cKDTree(points[held]).query(points)
    return np.where(held[:, None], weights, weights[held][near])


def largest_influences(weights: Float[np.ndarray, "n j"]) -> Float[np.ndarray, "n j"]:
    """Keep the ``INFLUENCES`` largest weights of each row, normalised; zeros where there are none, or NaN."""
    weights = np.nan_to_num(weights).clip(0.0)
    if weights.shape[1] > INFLUENCES:
        least = np.argsort(-weights, axis=1, kind="stable")[:, INFLUENCES:]
        weights[np.arange(len(weights))[:, None], least] = 0.0
    total = weights.sum(axis=1, keepdims=True)
    return np.asarray(weights / np.where(total > 0, total, 1.0))


def _transfer_frame(frame: Float[np.ndarray, "4 4"], to_target: SurfaceMap) -> tuple[Float[np.ndarray, "4 4"], float]:
    """The frame of a joint on the target, and the scale of its surroundings."""
    known = np.flatnonzero(to_target.surface_points.valid)
    if len(known) < _FEWEST_AROUND:
        raise DataError("fewer than a dozen of the source's points have a counterpart, too few to position joints by")
    points, images = to_target.source.given.points[known], to_target.positions[known]
    joint = frame[:3, 3]
    distances = np.linalg.norm(points - joint, axis=1)
    reach = max(_REACH * distances.min(), np.partition(distances, _FEWEST_AROUND - 1)[_FEWEST_AROUND - 1])
    around = distances <= reach
    rotation, _ = rigid_motion(points[around], images[around])
    before, after = points[around].mean(axis=0), images[around].mean(axis=0)
    spread, spread_after = points[around] - before, images[around] - after
    scale = float(np.sqrt((spread_after**2).sum() / (spread**2).sum())) if len(spread) > 1 else 1.0
    found = np.eye(4)
    found[:3, :3] = rotation @ frame[:3, :3]
    found[:3, 3] = after + scale * (rotation @ (joint - before))
    return found, scale


def strongest_influences(weights: Float[np.ndarray, "n j"]) -> tuple[Int[np.ndarray, "n 4"], Float[np.ndarray, "n 4"]]:
    """The joints and weights of each point's largest influences, for glTF; unused slots have joint 0, weight 0."""
    weights = largest_influences(weights)
    width = min(INFLUENCES, weights.shape[1])
    joints = np.argsort(-weights, axis=1, kind="stable")[:, :width]
    shares = np.take_along_axis(weights, joints, axis=1)
    joints = np.pad(np.where(shares > 0, joints, 0), ((0, 0), (0, INFLUENCES - width)))
    return joints, np.pad(shares, ((0, 0), (0, INFLUENCES - width)))
