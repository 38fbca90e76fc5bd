"""Skins, as glTF calls a skeleton with its skinning weights: read from glTF, and transferred to another shape."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from homolog.core.errors import DataError
from homolog.maps import rigid_motion
from homolog.shapes import Shape
from homolog.transfer.gltf import GltfReader
from homolog.transfer.smooth_map import SurfaceMap

INFLUENCES = 4
"""The largest number of joints that influence one vertex in files that are written."""

# A joint follows the points within _REACH times its distance from the surface, at least _FEWEST_AROUND of them.
_REACH = 1.5
_FEWEST_AROUND = 12
# A vertex of the skin is a point of the shape if they are nearer than this share of the shape's extent.
_SAME = 1e-5


@dataclass(frozen=True, eq=False)
class Skin:
    """A skeleton in its bind pose, and skinning weights.

    Args:
        names: of the joints.
        parents: the parent of each joint, -1 for none (j,).
        frames: the rigid transform of each joint in the bind pose, in the shape's coordinates (j, 4, 4).
        weights: skinning weights (n, j); rows of zeros for points that no joint influences.
    """

    names: tuple[str, ...]
    parents: Int[np.ndarray, " j"]
    frames: Float[np.ndarray, "j 4 4"]
    weights: Float[np.ndarray, "n j"]


def read_skin(path: Path, shape: Shape) -> Skin | None:
    """Read the first skin of a GLB or glTF file; None if it has none, or the file is of another format.

    Args:
        path: the file.
        shape: what ``read_shape`` read from it.

    Raises:
        DataError: if it is damaged.
    """
    if path.suffix.lower() not in (".glb", ".gltf"):
        return None
    file = GltfReader(path)
    skinned = [number for number, node in enumerate(file.nodes) if "skin" in node and "mesh" in node]
    if not skinned:
        return None
    try:
        return _skin_of(file, file.nodes[skinned[0]]["skin"], skinned, shape)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise DataError(f"{path}: its skin cannot be read ({error!r}); export it again") from None


def _skin_of(file: GltfReader, number: int, skinned: list[int], shape: Shape) -> Skin:
    skin = file.header["skins"][number]
    joints: list[int] = list(skin["joints"])
    nodes = [node for node in skinned if file.nodes[node]["skin"] == number]
    vertices, weights = _skinned_vertices(file, nodes, len(joints))
    inverse = _inverse_binds(file, skin, len(joints))
    # Joints in the bind pose, as the file's vertices are, whatever pose the nodes are in.
    frames = file.world(nodes[0]) @ np.linalg.inv(inverse)
    names = tuple(str(file.nodes[joint].get("name", f"joint {joint}")) for joint in joints)
    return Skin(names, _parents(file, joints), _unscaled(frames), _at_points(shape, vertices, weights))


def _skinned_vertices(
    file: GltfReader, nodes: list[int], n_joints: int
) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, "v j"]]:
    """The scene coordinates and skinning weights of the vertices of the nodes' meshes."""
    positions, weights = list[np.ndarray](), list[np.ndarray]()
    for node in nodes:
        world = file.world(node)
        for primitive in file.header["meshes"][file.nodes[node]["mesh"]]["primitives"]:
            attributes: dict[str, int] = primitive["attributes"]
            if "JOINTS_0" not in attributes:
                continue
            local = file.accessor(attributes["POSITION"]).astype(np.float64)
            positions.append(local @ world[:3, :3].T + world[:3, 3])
            weights.append(_weights(file, attributes, len(local), n_joints))
    return np.concatenate(positions), np.concatenate(weights)


def _weights(file: GltfReader, attributes: dict[str, int], count: int, n_joints: int) -> Float[np.ndarray, "v j"]:
    found, rows, layer = np.zeros((count, n_joints)), np.arange(count), 0
    while f"JOINTS_{layer}" in attributes:
        joints = file.accessor(attributes[f"JOINTS_{layer}"]).astype(int)
        weights = file.accessor(attributes[f"WEIGHTS_{layer}"]).astype(np.float64)
        for joint, weight in zip(joints.T, weights.T, strict=True):
            # A joint may occur twice, the second time with the weight zero.
            np.add.at(found, (rows, joint), weight)
        layer += 1
    return found


def _inverse_binds(file: GltfReader, skin: dict[str, Any], n_joints: int) -> Float[np.ndarray, "j 4 4"]:
    if "inverseBindMatrices" not in skin:
        return np.tile(np.eye(4), (n_joints, 1, 1))
    return file.accessor(skin["inverseBindMatrices"]).astype(np.float64).reshape(-1, 4, 4).transpose(0, 2, 1)


def _parents(file: GltfReader, joints: list[int]) -> Int[np.ndarray, " j"]:
    """The nearest ancestor of each joint that is a joint."""
    above = file.parents
    found = np.full(len(joints), -1)
    for number, joint in enumerate(joints):
        file.world(joint)  # refuses circles
        step = above.get(joint)
        while step is not None and step not in joints:
            step = above.get(step)
        found[number] = -1 if step is None else joints.index(step)
    return found


def _unscaled(frames: Float[np.ndarray, "j 4 4"]) -> Float[np.ndarray, "j 4 4"]:
    left, _, right = np.linalg.svd(frames[:, :3, :3])
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    found = np.tile(np.eye(4), (len(frames), 1, 1))
    found[:, :3, :3], found[:, :3, 3] = left @ right, frames[:, :3, 3]
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
    similarity transform that fits the correspondence of the surface nearest to it. New here.

    Args:
        skin: the source's.
        to_source: the map from target to source.
        to_target: the map from source to target.

    Raises:
        DataError: if hardly any point of the source has a counterpart.
    """
    weights = largest_influences(_filled(to_source.surface_points.interpolate(skin.weights), to_source.source.given))
    frames = np.stack([_transfer_frame(frame, to_target) for frame in skin.frames])
    return Skin(skin.names, skin.parents, frames, weights)


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


def _transfer_frame(frame: Float[np.ndarray, "4 4"], to_target: SurfaceMap) -> Float[np.ndarray, "4 4"]:
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
    return found


def strongest_influences(weights: Float[np.ndarray, "n j"]) -> tuple[Int[np.ndarray, "n 4"], Float[np.ndarray, "n 4"]]:
    """The joints and weights of each point's largest influences, for glTF; unused slots have joint 0, weight 0."""
    weights = largest_influences(weights)
    width = min(INFLUENCES, weights.shape[1])
    joints = np.argsort(-weights, axis=1, kind="stable")[:, :width]
    shares = np.take_along_axis(weights, joints, axis=1)
    joints = np.pad(np.where(shares > 0, joints, 0), ((0, 0), (0, INFLUENCES - width)))
    return joints, np.pad(shares, ((0, 0), (0, INFLUENCES - width)))
