"""UV unwrapping of a mesh, and baking colours into its texture.

Texture coordinates cannot be copied from the source's vertices to the target's: where the corners of a triangle lie in
different charts of the source's atlas, everything between these charts would be drawn in it. So the target is unwrapped
anew, and each texel gets the colour of its counterpart on the source.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.ndimage import distance_transform_edt

from homolog.core.choices import TEXTURE_SIZE
from homolog.core.errors import needs_extra
from homolog.geometry.grouping import runs
from homolog.transfer.appearance import NO_COLOUR
from homolog.transfer.projection import SurfacePoints, SurfaceProjector

# Texels between charts, so that filtering does not mix them.
_PADDING = 4
# How many texels are baked at a time.
_AT_ONCE = 200_000


@dataclass(frozen=True, eq=False)
class Atlas:
    """A UV atlas: a mesh cut into flat charts, side by side in an image.

    Args:
        point_of: the mesh's point that each vertex of the cut mesh is (v,), as an index of the shape as given.
        faces: triangles of the cut mesh (m, 3).
        face_of: the face of the shape as given that each of them is (m,).
        uv: texture coordinates of each vertex; (0, 0) is the upper left corner of the image, (1, 1) the lower right
            one (v, 2).
        shape: rows and columns of texels that the image is to have.
    """

    point_of: Int[np.ndarray, " v"]
    faces: Int[np.ndarray, "m 3"]
    face_of: Int[np.ndarray, " m"]
    uv: Float[np.ndarray, "v 2"]
    shape: tuple[int, int]


def unwrap(projector: SurfaceProjector, *, size: int = TEXTURE_SIZE) -> Atlas:
    """UV-unwrap a mesh: cut it into charts and pack these into an image, by xatlas.

    Args:
        projector: a mesh; of its faces, those that repair keeps.
        size: the image's width in texels; its height follows.

    Raises:
        MissingExtraError: if xatlas is not installed.
    """
    with needs_extra("making a texture", "transfer"):
        import xatlas
    shape = projector.shape
    assert shape.faces is not None
    atlas = xatlas.Atlas()
    # Around the origin and of one size, as it works in single precision.
    points = (shape.points - shape.points.mean(axis=0)) / projector.unit
    atlas.add_mesh(points.astype(np.float32), shape.faces.astype(np.uint32))
    packing = xatlas.PackOptions()
    packing.resolution, packing.padding, packing.bilinear = size, _PADDING, True
    atlas.generate(pack_options=packing)
    point_of, faces, uv = atlas[0]
    height = max(1, round(size * atlas.height / max(atlas.width, 1)))
    return Atlas(
        projector.repaired.kept[point_of.astype(np.int64)],
        faces.astype(np.int64),
        projector.given_faces,
        uv.astype(np.float64),
        (height, size),
    )


@dataclass(frozen=True, eq=False)
class Texels:
    """The texels of an image that lie in some triangle.

    Args:
        rows: their rows (t,).
        columns: their columns (t,).
        triangles: the triangle that each lies in (t,).
        weights: its barycentric weights there (t, 3).
    """

    rows: Int[np.ndarray, " t"]
    columns: Int[np.ndarray, " t"]
    triangles: Int[np.ndarray, " t"]
    weights: Float[np.ndarray, "t 3"]


def texels(atlas: Atlas) -> Texels:
    """All texels whose middles lie in a triangle of the atlas."""
    height, width = atlas.shape
    corners = atlas.uv[atlas.faces] * [width, height] - 0.5
    low, high = np.ceil(corners.min(axis=1)).astype(int), np.floor(corners.max(axis=1)).astype(int)
    low, high = np.maximum(low, 0), np.minimum(high, [width - 1, height - 1])
    spans = np.maximum(high - low + 1, 0)
    triangle, number = runs(spans.prod(axis=1))
    column, row = low[triangle, 0] + number % spans[triangle, 0], low[triangle, 1] + number // spans[triangle, 0]
    weights, inside = _barycentric(corners[triangle], np.stack([column, row], axis=1))
    return Texels(row[inside], column[inside], triangle[inside], weights[inside])


def _barycentric(
    triangles: Float[np.ndarray, "t 3 2"], points: Int[np.ndarray, "t 2"]
) -> tuple[Float[np.ndarray, "t 3"], Bool[np.ndarray, " t"]]:
    """The weights of points in flat triangles, and which points lie within them."""
    x, y = np.moveaxis(triangles - points[:, None], 2, 0)
    areas = x[:, [1, 2, 0]] * y[:, [2, 0, 1]] - y[:, [1, 2, 0]] * x[:, [2, 0, 1]]  # opposite of each corner, doubled
    doubled = areas.sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = areas / doubled[:, None]
    return weights, np.asarray((weights >= 0).all(axis=1) & (doubled != 0))


def bake_texture(
    atlas: Atlas, projector: SurfaceProjector, colours: Callable[[SurfacePoints], UInt8[np.ndarray, "p 3"]]
) -> UInt8[np.ndarray, "h w 3"]:
    """Bake colours of a mesh into the image of its atlas.

    Texels outside all charts get the colour of the nearest texel inside one, so that filtering at the borders of charts
    mixes no other colour.

    Args:
        atlas: of the projector's mesh.
        projector: the mesh.
        colours: gives the colour at points of the mesh.
    """
    image = np.full((*atlas.shape, 3), NO_COLOUR, dtype=np.uint8)
    inside = texels(atlas)
    assert projector.given.faces is not None
    for start in range(0, len(inside.rows), _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        of_shape = atlas.face_of[inside.triangles[some]]
        points = SurfacePoints(projector.given.faces[of_shape], inside.weights[some], of_shape)
        image[inside.rows[some], inside.columns[some]] = colours(points)
    return _spread(image, inside)


def _spread(image: UInt8[np.ndarray, "h w 3"], inside: Texels) -> UInt8[np.ndarray, "h w 3"]:
    empty = np.ones(image.shape[:2], dtype=bool)
    empty[inside.rows, inside.columns] = False
    if empty.all():
        return image
    rows, columns = distance_transform_edt(empty, return_distances=False, return_indices=True)
    return np.asarray(image[rows, columns])
