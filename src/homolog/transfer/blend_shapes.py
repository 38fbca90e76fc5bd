"""Blend shapes, as glTF's morph targets: read from glTF, and transferred to another shape."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from homolog.core.errors import DataError
from homolog.core.memory import expansion_fault
from homolog.core.progress import Progress, ignore
from homolog.core.reasons import reason_of
from homolog.shapes import Shape
from homolog.shapes.formats.gltf import Gltf, default_weights, morph_offsets, parts
from homolog.shapes.formats.parsing import CUT_OFF, UnreadableError
from homolog.transfer.animations import Animation, unique, weight_animations
from homolog.transfer.deformation_transfer import DeformationTransfer
from homolog.transfer.smooth_map import SurfaceMap

# Of an offset of a point.
_OFFSET_BYTES = 24


@dataclass(frozen=True, eq=False)
class BlendShapes:
    """Named deformations of a mesh, which are added with weights.

    Args:
        names: such as ARKit's ``jawOpen``.
        offsets: what each adds to the points at the weight one, in the shape's coordinates (k, n, 3).
        weights: at which the shape is as it lies (k,), mostly zero.
        animations: of the weights.
    """

    names: tuple[str, ...]
    offsets: Float[np.ndarray, "k n 3"]
    weights: Float[np.ndarray, " k"]
    animations: tuple[Animation, ...] = ()


def read_blend_shapes(path: Path, shape: Shape) -> BlendShapes | None:
    """Read the morph targets of a GLB or glTF file; None if it has none, or the file is of another format.

    Morph targets of one name are one blend shape, as those of face and teeth are. Where meshes do not name them
    (``extras.targetNames``) they are numbered.

    Args:
        path: the file.
        shape: what ``read_shape`` read from it.

    Raises:
        DataError: if they are damaged.
    """
    if path.suffix.lower() not in (".glb", ".gltf") or shape.faces is None:
        return None
    try:
        file = Gltf(path)
        return _blend_shapes_of(file, shape) if _names_of(file) else None
    except (UnreadableError, OSError, KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise DataError(f"{path}: its morph targets cannot be read ({reason_of(error)}); export it again") from None


def _blend_shapes_of(file: Gltf, shape: Shape) -> BlendShapes:
    names_of = _names_of(file)
    names = tuple(dict.fromkeys(name for own in names_of.values() for name in own))
    if fault := expansion_fault(_OFFSET_BYTES * len(names) * shape.n_points, file.size):
        raise UnreadableError(f"it has {len(names)} morph targets; {fault}")
    place = {name: number for number, name in enumerate(names)}
    offsets, weights = np.zeros((len(names), shape.n_points, 3)), np.zeros(len(names))
    for part in parts(file):
        if not len(part.points):
            continue
        own = names_of.get(part.node, ())
        for name, added in zip(own, morph_offsets(file, part), strict=True):
            offsets[place[name], part.first : part.first + len(added)] = added
        for name, weight in zip(own, default_weights(file, part.node), strict=False):
            weights[place[name]] = weight
    if not np.isfinite(offsets).all():
        raise UnreadableError(f"they hold numbers that are not finite; {CUT_OFF}")
    return BlendShapes(names, offsets, weights, weight_animations(file, names_of, names, weights))


def _names_of(file: Gltf) -> dict[int, tuple[str, ...]]:
    """For each node of the scene with morph targets their names."""
    found = dict[int, tuple[str, ...]]()
    for node in file.shown():
        if "mesh" not in file.nodes[node]:
            continue
        number = file.nodes[node]["mesh"]
        mesh: dict[str, Any] = file.header["meshes"][number]
        count = max((len(primitive.get("targets", [])) for primitive in mesh["primitives"]), default=0)
        extras = mesh.get("extras")
        told = extras.get("targetNames") if isinstance(extras, dict) else None
        named = [str(name) for name in told[:count]] if isinstance(told, list) else []
        named += [f"mesh {number} target {target}" for target in range(len(named), count)]
        if named:
            found[node] = tuple(unique(named))
    return found


def transfer_blend_shapes(shapes: BlendShapes, to_source: SurfaceMap, progress: Progress = ignore) -> BlendShapes:
    """Transfer blend shapes from source to target; see ``DeformationTransfer``.

    Args:
        shapes: the source's.
        to_source: the map from target to source.
        progress: called before each.

    Raises:
        ArgumentError: if either shape has no faces.
    """
    along, found = DeformationTransfer(to_source), np.zeros((len(shapes.names), to_source.source.given.n_points, 3))
    for number, (name, offsets) in enumerate(zip(shapes.names, shapes.offsets, strict=True)):
        progress(number, len(shapes.names), name)
        found[number] = along.offsets(offsets)
    return replace(shapes, offsets=found)
