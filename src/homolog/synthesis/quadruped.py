"""The quadruped: one closed skin that follows bones, which all animals share.

The skin and its bones are those of the dog of dm_control; see ``animal_data/LICENSE.md``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import files
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix

from homolog.geometry import edge_graph
from homolog.geometry.surface import Surface
from homolog.synthesis.joints import Rotations

LOIN = tuple(f"L_{i}" for i in range(1, 8))
"""The bones of the loin, from the chest backwards."""
NECK = tuple(f"C_{i}" for i in range(7, 0, -1))
"""The bones of the neck, from the chest upwards."""
TAIL = tuple(f"Ca_{i}" for i in range(1, 22))
"""The bones of the tail, from the pelvis backwards."""
FORE_LEG = ("scapula", "upper_arm", "lower_arm", "hand", "finger")
HIND_LEG = ("upper_leg", "lower_leg", "foot", "toe")
LETTERS = {"left": "L", "right": "R"}
"""The last letter of the names of a side's bones."""

# Where bones turn, if that is not their origin: the head turns about the nape, the pelvis about the last vertebra.
_PIVOTS = {
    "skull": (0.0, 0.695, 0.279),
    "pelvis": (0.0, 0.5, -0.25),
    "torso": (0.0, 0.48, 0.04),
}
# Target edge lengths relative to the trunk's, by the prefix of the bone's name.
_FINER = {"skull": 0.7, "ear": 0.6, "toe": 0.6, "finger": 0.6, "foot": 0.8, "hand": 0.75, "Ca_": 0.7, "lower": 0.9}


@dataclass(frozen=True)
class Quadruped:
    """The skin of all animals, as a dog that stands: +y up, facing +z, in metres.

    Args:
        surface: the skin, one closed surface.
        bones: names; each stands after its parent.
        parents: the number of each bone's parent; -1 for the trunk.
        pivots: the point that each bone turns about.
        bone_of: the bones that each vertex follows.
        weight: how much it follows each of them.
        hoof: what must be added to each vertex so that toes become hooves.
        grids: control grids of the forms of bodies and heads, by name.
    """

    surface: Surface
    bones: tuple[str, ...]
    parents: Int[np.ndarray, " b"]
    pivots: Float[np.ndarray, "b 3"]
    bone_of: Int[np.ndarray, "n k"]
    weight: Float[np.ndarray, "n k"]
    hoof: Float[np.ndarray, "n 3"]
    grids: Mapping[str, Float[np.ndarray, "u v 3"]]

    @classmethod
    @cache
    def load(cls) -> Quadruped:
        """The quadruped of the package."""
        with (files("homolog.synthesis") / "animal_data" / "quadruped.npz").open("rb") as file:
            stored = dict(np.load(file, allow_pickle=False))
        names = [str(name) for name in stored["bones"]]
        parent_of = _parent_of()
        bones = tuple(sorted(names, key=lambda bone: _depth(bone, parent_of)))
        renumbered = np.array([bones.index(name) for name in names])
        origins = dict(zip(names, stored["joints"].astype(float), strict=True))
        return cls(
            Surface(stored["vertices"].astype(float), stored["faces"].astype(np.int64)),
            bones,
            np.array([bones.index(parent_of[bone]) if bone in parent_of else -1 for bone in bones]),
            np.array([_pivot(bone, origins) for bone in bones]),
            renumbered[stored["bone_of"]],
            stored["weight"].astype(float) / stored["weight"].astype(float).sum(axis=1, keepdims=True),
            stored["hoof"].astype(float),
            {name: grid.astype(float) for name, grid in stored.items() if name.startswith(("head_", "body_"))},
        )

    def share(self, *starts: str) -> Float[np.ndarray, " n"]:
        """How much each vertex follows the bones whose names begin so."""
        chosen = np.array([bone.startswith(starts) for bone in self.bones])
        return np.asarray((self.weight * chosen[self.bone_of]).sum(axis=1))

    def blended(self, values: Float[np.ndarray, "b ..."]) -> Float[np.ndarray, "n ..."]:
        """Values of bones, blended for each vertex."""
        return np.asarray(np.einsum("nk,nk...->n...", self.weight, values[self.bone_of]))

    def detail(self) -> Float[np.ndarray, " n"]:
        """The relative target edge length at each vertex."""
        lengths = [
            next((length for start, length in _FINER.items() if bone.startswith(start)), 1.0) for bone in self.bones
        ]
        return self.blended(np.array(lengths))

    @cached_property
    def means(self) -> csr_matrix:
        """The matrix that gives the mean over each vertex's neighbours."""
        adjacent = (edge_graph(self.surface.vertices, self.surface.faces) > 0).astype(float)
        return csr_matrix(adjacent.multiply(1.0 / adjacent.sum(axis=1)))

    def followed(
        self,
        vertices: Float[np.ndarray, "n 3"],
        pivots: Float[np.ndarray, "b 3"],
        *,
        turns: Rotations | None = None,
        stretches: Float[np.ndarray, "b 3 3"] | None = None,
        smooth_rounds: int = 0,
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "b 3"], Float[np.ndarray, "n 3 3"]]:
        """Vertices and pivots after bones are stretched, each in itself, and turned, with all that hangs on them.

        Linear blend skinning (N. Magnenat-Thalmann et al., "Joint-dependent local deformations", 1988).

        Args:
            vertices: of the skin.
            pivots: of the bones.
            turns: the rotation of each bone that turns, about axes of the standing animal.
            stretches: a linear map for each bone.
            smooth_rounds: how often the maps are averaged over neighbouring vertices.

        Returns:
            The vertices, the pivots, and the linear part of each vertex's map.
        """
        count = len(self.bones)
        linear = np.tile(np.eye(3), (count, 1, 1)) if stretches is None else stretches
        turned, moved = np.zeros((count, 3, 3)), np.zeros((count, 3))
        for bone, parent in enumerate(self.parents):
            turn = (turns or {}).get(self.bones[bone], np.eye(3))
            if parent < 0:
                turned[bone], moved[bone] = turn, pivots[bone]
            else:
                turned[bone] = turned[parent] @ turn
                moved[bone] = moved[parent] + turned[parent] @ linear[parent] @ (pivots[bone] - pivots[parent])
        matrices = turned @ linear
        offsets = moved - np.einsum("bij,bj->bi", matrices, pivots)
        flat = self.blended(np.concatenate([matrices, offsets[:, :, None]], axis=2).reshape(count, 12))
        for _ in range(smooth_rounds):
            flat = (flat + self.means @ flat) / 2
        maps = flat.reshape(-1, 3, 4)
        followed = np.einsum("nij,nj->ni", maps[:, :, :3], vertices) + maps[:, :, 3]
        return followed, moved, maps[:, :, :3]


def _parent_of() -> dict[str, str]:
    chains = [("torso", *LOIN, "pelvis", *TAIL), ("torso", *NECK, "skull")]
    for letter in LETTERS.values():
        for start, limb in (("torso", FORE_LEG), ("pelvis", HIND_LEG), ("skull", ("ear",))):
            chains.append((start, *(f"{bone}_{letter}" for bone in limb)))
    return {child: parent for chain in chains for parent, child in pairwise(chain)}


def _depth(bone: str, parent_of: Mapping[str, str]) -> int:
    return 1 + _depth(parent_of[bone], parent_of) if bone in parent_of else 0


def _pivot(bone: str, origins: Mapping[str, Float[np.ndarray, " 3"]]) -> Float[np.ndarray, " 3"]:
    """Where a bone turns; right bones mirror left ones, and the others lie in the middle."""
    if bone in _PIVOTS:
        return np.array(_PIVOTS[bone])
    if bone.endswith("_R"):
        return origins[f"{bone[:-1]}L"] * [-1.0, 1.0, 1.0]
    return origins[bone] * [float(bone.endswith("_L") and bone[0] != "L"), 1.0, 1.0]
