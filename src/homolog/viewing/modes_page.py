"""One self-contained page of a shape model, with a slider for each mode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8

from homolog.viewing.page import PackedArrays, assembled
from homolog.viewing.scene import typical_spacing

# Standard deviations of a mode that its slider reaches to, either way; so far the picture has room, and colours go.
_FARTHEST = 3.0


@dataclass(frozen=True, eq=False)
class ModesScene:
    """A shape model to look at.

    Args:
        title: of the page.
        summary: a sentence on it.
        mean: upright (+y up), in the shapes' unit (n, 3).
        faces: triangles, or None for a cloud.
        colours: of the points (n, 3).
        offsets: what a standard deviation of each mode adds to the mean; at least one mode (k, n, 3).
        shares: of the variance, per mode (k,).
        names: of the shapes that the model was made of.
        coefficients: of these shapes, in standard deviations (s, k).
    """

    title: str
    summary: str
    mean: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"] | None
    colours: UInt8[np.ndarray, "n 3"]
    offsets: Float[np.ndarray, "k n 3"]
    shares: Float[np.ndarray, " k"]
    names: Sequence[str]
    coefficients: Float[np.ndarray, "s k"]


def modes_page_of(scene: ModesScene) -> str:
    """The page as text: it opens from disk, and its policy forbids the browser to load anything."""
    arrays = PackedArrays()
    centred = scene.mean - (scene.mean.min(axis=0) + scene.mean.max(axis=0)) / 2
    ends = [centred + way * offset for offset in scene.offsets for way in (-_FARTHEST, _FARTHEST)]
    unit = float(np.linalg.norm([centred, *ends], axis=2).max())
    offsets = scene.offsets / unit
    described = {
        "summary": scene.summary,
        "unit": unit,
        "farthest": _FARTHEST,
        "reach": _FARTHEST * float(np.linalg.norm(offsets, axis=2).max()),
        "room": _room(np.stack([centred, *ends]) / unit),
        "bodies": [_body(scene, centred / unit, arrays)],
        "modes": [
            {"share": float(share), "offsets": arrays.add(offset, "float32")}
            for share, offset in zip(scene.shares, offsets, strict=True)
        ],
        "subjects": [
            {"name": name, "coefficients": np.round(row, 4).tolist()}
            for name, row in zip(scene.names, scene.coefficients, strict=True)
        ],
    }
    return assembled("modes", scene.title, described, arrays)


def _room(shapes: Float[np.ndarray, "s n 3"]) -> dict[str, float]:
    """What shapes take up however they are turned about the vertical, to either side of the middle."""
    return {
        "width": float(np.hypot(shapes[:, :, 0], shapes[:, :, 2]).max()),
        "height": float(np.abs(shapes[:, :, 1]).max()),
    }


def _body(scene: ModesScene, points: Float[np.ndarray, "n 3"], arrays: PackedArrays) -> dict[str, Any]:
    """The mean, as the renderer wants it."""
    return {
        "title": f"{len(scene.names):,} shapes, {len(points):,} points",
        "spacing": typical_spacing(points),
        "points": arrays.add(points, "float32"),
        "faces": None if scene.faces is None else arrays.add(scene.faces, "uint32"),
        "colours": arrays.add(scene.colours, "uint8"),
    }
