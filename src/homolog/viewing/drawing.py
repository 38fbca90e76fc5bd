"""Drawing surfaces and balls into an image with a depth buffer, by the processor alone: the same on any machine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8

from homolog.geometry.grouping import runs

SAMPLES = 3
"""Samples along each side of a pixel."""

RADIUS = 0.75
"""Of the balls that are the points of a cloud, in spacings."""

# From where the shapes are seen: from above, and from their left, in degrees.
_ELEVATION, _AZIMUTH = 8.0, 20.0
_LIGHT = np.array([-0.25, 0.45, 0.86]) / np.linalg.norm([-0.25, 0.45, 0.86])
_AMBIENT = 0.45
# Balls are discs with so many corners.
_CORNERS = 10
# Triangles and samples are met in portions of about so many.
_PORTION = 2_000_000


@dataclass(frozen=True, eq=False)
class Drawing:
    """Triangles in samples of the image (x, y down) and depths towards the viewer, with normals and colours."""

    corners: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    colours: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]


@dataclass(frozen=True, eq=False)
class Canvas:
    """An image in the making: samples on white, and how near to the viewer what is seen in each is.

    Args:
        image: red, green and blue of the samples, 0 to 255.
        depth: of the samples, towards the viewer.
    """

    image: Float[np.ndarray, "h w 3"]
    depth: Float[np.ndarray, "h w"]

    @classmethod
    def blank(cls, height: int, width: int) -> Canvas:
        """A white one of so many pixels."""
        size = (height * SAMPLES, width * SAMPLES)
        return cls(np.full((*size, 3), 255.0, dtype=np.float32), np.full(size, -np.inf))

    def draw(self, drawing: Drawing) -> None:
        """Draw triangles; the nearest to the viewer is seen."""
        image, depth = self.image, self.depth
        triangles = drawing.corners[drawing.faces]
        low = np.ceil(triangles[:, :, :2].min(axis=1) - 0.5).astype(np.int64).clip(0)
        high = np.floor(triangles[:, :, :2].max(axis=1) - 0.5).astype(np.int64)
        high = np.minimum(high, [depth.shape[1] - 1, depth.shape[0] - 1])
        spread = (high - low + 1).clip(0)
        ends = np.cumsum(spread.prod(axis=1))
        first = np.full(depth.size, -1)
        cuts = np.searchsorted(ends, np.arange(_PORTION, ends[-1], _PORTION))
        for portion in np.split(np.arange(len(triangles)), np.unique(cuts)):
            _meet(triangles, portion, low, spread, depth.reshape(-1), first, depth.shape[1])
        (seen,) = np.nonzero(first >= 0)
        for part in np.array_split(seen, len(seen) // _PORTION + 1):
            image.reshape(-1, 3)[part] = _shaded(drawing, first[part], part, depth.shape[1])


def view_rotation() -> Float[np.ndarray, "3 3"]:
    """From where shapes that stand upright are seen: from above a little, and from their left."""
    up, around = np.radians([_ELEVATION, -_AZIMUTH])
    tilt = np.array([[1, 0, 0], [0, np.cos(up), -np.sin(up)], [0, np.sin(up), np.cos(up)]])
    spin = np.array([[np.cos(around), 0, np.sin(around)], [0, 1, 0], [-np.sin(around), 0, np.cos(around)]])
    turn: np.ndarray = tilt @ spin
    return turn


def seen_normals(places: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> Float[np.ndarray, "n 3"]:
    """Of the points, as seen (y up), from the triangles around them by area."""
    first, second, third = (places[faces] * [1, -1, 1]).transpose(1, 0, 2)
    weighted = np.cross(second - first, third - first)
    normals = np.zeros_like(places)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], weighted)
    return normals


def balls(places: Float[np.ndarray, "n 3"], colours: Float[np.ndarray, "n 3"], radius: float) -> Drawing:
    """A disc per point that faces the viewer and is shaded as a ball."""
    angles = 2 * np.pi * np.arange(_CORNERS) / _CORNERS
    rim = np.stack([np.cos(angles), np.sin(angles), np.zeros(_CORNERS)], axis=1)
    offsets = np.concatenate([[[0, 0, 0]], rim])
    corners = places[:, None] + radius * offsets
    normals = np.broadcast_to(offsets * [0.8, -0.8, 0] + [0, 0, 1], corners.shape)
    around = np.arange(_CORNERS)
    fan = np.stack([np.zeros_like(around), 1 + around, 1 + (around + 1) % _CORNERS], axis=1)
    faces = (fan + (_CORNERS + 1) * np.arange(len(places))[:, None, None]).reshape(-1, 3)
    return Drawing(corners.reshape(-1, 3), normals.reshape(-1, 3), np.repeat(colours, _CORNERS + 1, axis=0), faces)


def shape_drawing(
    places: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"] | None,
    colours: Float[np.ndarray, "n 3"],
    radius: float,
) -> Drawing:
    """A surface with the normals that are seen, or, without faces, balls of a radius in samples."""
    if faces is None:
        return balls(places, colours, radius)
    return Drawing(places, seen_normals(places, faces), colours, faces)


def _meet(
    triangles: Float[np.ndarray, "m 3 3"],
    portion: Int[np.ndarray, " p"],
    low: Int[np.ndarray, "m 2"],
    spread: Int[np.ndarray, "m 2"],
    depth: Float[np.ndarray, " s"],
    first: Int[np.ndarray, " s"],
    width: int,
) -> None:
    """Note which samples some triangles cover and how near, where nothing is nearer."""
    run, place = runs(spread[portion].prod(axis=1))
    triangle = portion[run]
    columns = spread[triangle, 0]
    sample = (low[triangle, 1] + place // columns) * width + low[triangle, 0] + place % columns
    weights = _weights(triangles[triangle], sample, width)
    met = (weights >= 0).all(axis=1)
    triangle, sample, weights = triangle[met], sample[met], weights[met]
    nearness = np.einsum("ck,ck->c", weights, triangles[triangle, :, 2])
    np.maximum.at(depth, sample, nearness)
    nearest = depth[sample] == nearness
    first[sample[nearest]] = triangle[nearest]


def _weights(
    triangles: Float[np.ndarray, "c 3 3"], sample: Int[np.ndarray, " c"], width: int
) -> Float[np.ndarray, "c 3"]:
    """Barycentric weights of samples in triangles; negative outside, and NaN in triangles seen from the edge."""
    at = np.stack([sample % width, sample // width], axis=1) + 0.5
    a, b, c = (triangles[:, corner, :2] - at for corner in range(3))
    doubled = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights: np.ndarray = doubled / doubled.sum(axis=1, keepdims=True)
    return weights


def _cross(a: Float[np.ndarray, "c 2"], b: Float[np.ndarray, "c 2"]) -> Float[np.ndarray, " c"]:
    area: np.ndarray = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return area


def _shaded(
    drawing: Drawing, triangle: Int[np.ndarray, " c"], sample: Int[np.ndarray, " c"], width: int
) -> Float[np.ndarray, "c 3"]:
    """Lambert's law from either side, and ambient light."""
    faces = drawing.faces[triangle]
    weights = _weights(drawing.corners[faces], sample, width)
    normals = np.einsum("ck,ckd->cd", weights, drawing.normals[faces])
    normals *= np.where(normals[:, 2:] < 0, -1, 1) / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    light = _AMBIENT + (1.08 - _AMBIENT) * (normals @ _LIGHT).clip(0)
    shaded: np.ndarray = np.einsum("ck,ckd->cd", weights, drawing.colours[faces]) * light[:, None]
    return shaded.clip(0, 255)


def averaged(image: Float[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "k l 3"]:
    """Pixels of an image of samples."""
    height, width = (length // SAMPLES for length in image.shape[:2])
    pixels = image.reshape(height, SAMPLES, width, SAMPLES, 3).mean(axis=(1, 3))
    rounded: np.ndarray = pixels.round().astype(np.uint8)
    return rounded
