"""Statistical models of bones: the mean and the modes of a leg and a pelvis, from the package musculoskeletal-models.

The package holds the bones of 26 people as meshes of polynomial patches (J. Zhang et al., "The MAP Client", 2014), with
a principal component model of all their nodes together. Its data are read where the user installed them.
"""

from __future__ import annotations

import json
import pickletools
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from homolog.core.choices import Bone
from homolog.core.errors import DataError, needs_extra
from homolog.geometry.surface import Surface
from homolog.shapes.topology import components

ASSETS = (
    {
        "asset": "statistical model of pelvis, femur, patella, tibia and fibula (LLP26), and the patches of each",
        "package": "musculoskeletal-models",
        "licence": "MPL-2.0",
        "source": "https://github.com/musculoskeletal/models",
    },
)
"""What bones are made from, with its licence."""

_MODEL = "shape_models/LLP26_rigid.pc"
# The files of patches, in the order in which the model holds their nodes, and how many there are.
_MESHES = {
    "pelvis_combined_cubic_flat": 1946,
    "femur_left_quartic_flat": 634,
    "patella_11_left": 74,
    "tibia_fibula_left_cubic_flat": 571,
}
_N_MODES = 26
# The file that each bone is in, and which of the surfaces there it is, the largest coordinate x of its centre first.
_PLACES: dict[Bone, tuple[str, int]] = {
    "hip": ("pelvis_combined_cubic_flat", 0),
    "sacrum": ("pelvis_combined_cubic_flat", 1),
    "femur": ("femur_left_quartic_flat", 0),
    "patella": ("patella_11_left", 0),
    "fibula": ("tibia_fibula_left_cubic_flat", 0),
    "tibia": ("tibia_fibula_left_cubic_flat", 1),
}
# The package names a patch by its shape and its nodes: "tri15", or "quad54" for five nodes along and four across.
_KIND = re.compile(r"(?P<shape>tri|quad)(?P<nodes>\d\d)")
# Each side of a patch is divided so often.
_DIVISIONS = 8
# Neighbouring patches have the same points along their edges, up to rounding, in millimetres.
_DIGITS = 4


@dataclass(frozen=True)
class BoneModel:
    """The mean surface of a bone, and how bones of people differ from it.

    Args:
        mean: a closed mesh: +y up, facing +z, in millimetres, its centre in the origin.
        modes: displacements of its vertices, one standard deviation each (k, n, 3).
    """

    mean: Surface
    modes: Float[np.ndarray, "k n 3"]

    @classmethod
    def of(cls, bone: Bone) -> BoneModel:
        """The model of a bone of the left side.

        Raises:
            MissingExtraError: if musculoskeletal-models is not installed.
            DataError: if its files are not those of version 0.2.

        Examples:
            >>> BoneModel.of("femur").modes.shape  # doctest: +SKIP
            (25, 2626, 3)
        """
        with needs_extra("making bones", "synth"):
            from musculoskeletal import models
        root = Path(str(models.__file__)).parent
        file, place = _PLACES[bone]
        patches = _Patches.read(root / "atlas_meshes" / f"{file}.mesh", _MESHES[file])
        mean, modes = _nodes(root / _MODEL)
        start = sum(list(_MESHES.values())[: list(_MESHES).index(file)])
        own = slice(start, start + _MESHES[file])
        surfaces, weights = patches.surfaces(mean[own])
        surface, rows = surfaces[place], weights[place]
        centre = surface.vertices.mean(axis=0)
        moved = np.einsum("vn,nkm->mvk", rows, modes[own])
        return cls(
            Surface(_upright(surface.vertices - centre), surface.faces), _upright(moved - moved.mean(1, keepdims=True))
        )

    def vertices(self, amounts: Float[np.ndarray, " k"]) -> Float[np.ndarray, "n 3"]:
        """The bone that lies so many standard deviations from the mean along each mode."""
        return np.asarray(self.mean.vertices + np.einsum("k,knc->nc", amounts, self.modes[: len(amounts)]))


def _upright(vectors: np.ndarray) -> np.ndarray:
    """From x to the left, y to the back and z up, as the package has it, to y up and z to the front."""
    return np.stack([vectors[..., 0], vectors[..., 2], -vectors[..., 1]], axis=-1)


def _nodes(path: Path) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 k"]]:
    """The mean positions of all nodes, and the modes of which each is one standard deviation."""
    n = sum(_MESHES.values())
    found = _stored_numbers(path)
    sizes = {"mean": 3 * n, "modes": 3 * n * _N_MODES, "weights": _N_MODES}
    if any(len(found.get(name, ())) != size for name, size in sizes.items()):
        raise DataError(f"{path} is not the model of version 0.2 of musculoskeletal-models; install that version again")
    deviations = np.sqrt(found["weights"])
    # As many people were measured as there are modes, so that the last one is empty.
    modes = found["modes"].reshape(3, n, _N_MODES).transpose(1, 0, 2) * deviations
    return found["mean"].reshape(3, n).T, modes[:, :, :-1]


def _stored_numbers(path: Path) -> dict[str, Float[np.ndarray, " n"]]:
    """The arrays of a pickled dictionary, flat: its operations are listed, and none is carried out.

    Of each name that stands alone, the bytes of the array that follows are read as little-endian numbers.
    """
    name, found = "", dict[str, np.ndarray]()
    try:
        for operation, argument, _ in pickletools.genops(path.read_bytes()):
            if operation.name == "SHORT_BINUNICODE" and argument in ("mean", "modes", "weights"):
                name = str(argument)
            elif operation.name in ("BINBYTES", "SHORT_BINBYTES") and isinstance(argument, bytes) and len(argument) > 8:
                found.setdefault(name, np.frombuffer(argument, "<f8"))
    except (OSError, ValueError) as error:
        raise DataError(f"{path} cannot be read ({error}); install musculoskeletal-models again") from None
    return found


@dataclass(frozen=True)
class _Patch:
    """A polynomial patch.

    Args:
        shape: "tri" or "quad".
        along: nodes along its first side.
        across: rows of nodes; each is one shorter than the one before in a triangle.
        nodes: their numbers, row by row.
    """

    shape: str
    along: int
    across: int
    nodes: Int[np.ndarray, " p"]

    def grid(self, along: int, across: int) -> Int[np.ndarray, "p 2"]:
        """Places of a lattice row by row, counted along and across."""
        rows = range(across)
        return np.array([(i, j) for j in rows for i in range(along - j if self.shape == "tri" else along)])

    def weights(self) -> Float[np.ndarray, "v p"]:
        """What each point of the fine lattice takes of each node: Lagrange interpolation."""
        powers = self.grid(self.along, self.across)

        def monomials(places: np.ndarray) -> np.ndarray:
            return np.asarray((places[:, None, :] ** powers[None]).prod(axis=2))

        coarse = powers / [self.along - 1, self.across - 1]
        return monomials(self.grid(_DIVISIONS + 1, _DIVISIONS + 1) / _DIVISIONS) @ np.linalg.inv(monomials(coarse))

    def faces(self) -> Int[np.ndarray, "m 3"]:
        """Triangles of the fine lattice."""
        places = [tuple(place) for place in self.grid(_DIVISIONS + 1, _DIVISIONS + 1).tolist()]
        number = {place: i for i, place in enumerate(places)}
        cells = [((i, j), (i + 1, j), (i, j + 1)) for i, j in places]
        cells += [((i + 1, j), (i + 1, j + 1), (i, j + 1)) for i, j in places]
        return np.array([[number[corner] for corner in cell] for cell in cells if all(c in number for c in cell)])


@dataclass(frozen=True)
class _Patches:
    """The patches of a file, whose nodes are shared along their edges."""

    patches: tuple[_Patch, ...]

    @classmethod
    def read(cls, path: Path, n_nodes: int) -> _Patches:
        """Patches from a file of the package: their kinds, and which of their nodes are one."""
        try:
            stored = json.loads(path.read_text())
            kinds = [_KIND.fullmatch(stored["elements"][str(i)].split()[1]) for i in range(len(stored["elements"]))]
            sides = [_sides(kind) for kind in kinds if kind]
            starts = np.concatenate([[0], np.cumsum([count for *_, count in sides])])
            joined = [
                (starts[int(a)] + int(i), starts[int(b)] + int(j))
                for key, others in stored["connectivity"].items()
                for a, i in [key.split("_")]
                for b, j in (other.split("_") for other in others.split())
            ]
            one, other = np.array(joined).T
            label = components(one, other, int(starts[-1]))
            _, first, which = np.unique(label, return_index=True, return_inverse=True)
        except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
            raise DataError(f"{path} cannot be read ({error}); install musculoskeletal-models again") from None
        if len(first) != n_nodes or None in kinds:
            raise DataError(f"{path} is not that of version 0.2 of musculoskeletal-models; install that version again")
        number = np.argsort(np.argsort(first))[which]  # in the order in which nodes are met
        return cls(
            tuple(
                _Patch(*side[:3], number[start : start + side[3]])
                for side, start in zip(sides, starts[:-1], strict=True)
            )
        )

    @cached_property
    def weights(self) -> Float[np.ndarray, "v n"]:
        """What each point of all fine lattices takes of each node."""
        n_nodes = 1 + max(int(patch.nodes.max()) for patch in self.patches)
        rows = []
        for patch in self.patches:
            own = patch.weights()
            rows.append(np.zeros((len(own), n_nodes)))
            rows[-1][:, patch.nodes] = own
        return np.concatenate(rows)

    def surfaces(self, nodes: Float[np.ndarray, "n 3"]) -> tuple[list[Surface], list[Float[np.ndarray, "v n"]]]:
        """The closed surfaces of the patches, the largest centre along x first, and what vertices take of the nodes."""
        lattices = [patch.faces() for patch in self.patches]
        starts = np.concatenate([[0], np.cumsum([faces.max() + 1 for faces in lattices])])
        faces = np.concatenate([each + start for each, start in zip(lattices, starts[:-1], strict=True)])
        _, first, which = np.unique(
            (self.weights @ nodes).round(_DIGITS), axis=0, return_index=True, return_inverse=True
        )
        faces, weights = which.reshape(-1)[faces], self.weights[first]
        vertices = weights @ nodes
        label = components(faces[:, 0], faces[:, 1], len(vertices), faces[:, 2])
        found = []
        for each in np.unique(label):
            kept = np.flatnonzero(label == each)
            own = np.searchsorted(kept, faces[label[faces[:, 0]] == each])
            found.append((Surface(vertices[kept], own), weights[kept]))
        found.sort(key=lambda one: -one[0].vertices[:, 0].mean())
        return [surface for surface, _ in found], [rows for _, rows in found]


def _sides(kind: re.Match[str]) -> tuple[str, int, int, int]:
    """The shape of a patch, its nodes along and across, and how many they are."""
    shape, nodes = kind["shape"], kind["nodes"]
    if shape == "quad":
        return shape, int(nodes[0]), int(nodes[1]), int(nodes[0]) * int(nodes[1])
    side = round((np.sqrt(8 * int(nodes) + 1) - 1) / 2)
    return shape, side, side, int(nodes)
