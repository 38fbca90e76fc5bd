"""Many shapes in one image, in rows, each with a few words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.spatial import KDTree

from homolog.errors import ArgumentError, needs_extra
from homolog.viewing.drawing import RADIUS, Canvas, Drawing, averaged, balls, seen_normals, view_rotation

# In pixels: of a shape's place, and of a line of words below it.
_WIDTH, _HEIGHT, _LINE = 200, 230, 17
_FONT_SIZE = 13
_MARGIN = 0.06  # of a shape's place
_AROUND = 4  # neighbours of a point, of which the farthest is a spacing away
# More would take long to draw and longer to look at; the first ones are those to look at.
_MOST = 240
_INK, _GREY, _ALARM = (38, 40, 43), (107, 111, 117), (190, 20, 60)


@dataclass(frozen=True, eq=False)
class Tile:
    """A shape in a contact sheet.

    Args:
        title: the first line below it.
        lines: further ones.
        points: upright (+y up), all shapes in one unit (n, 3); None if there is nothing to draw.
        faces: triangles, or None for a cloud.
        colours: of the points (n, 3).
        alarming: write the last line in red.
    """

    title: str
    lines: tuple[str, ...] = ()
    points: Float[np.ndarray, "n 3"] | None = None
    faces: Int[np.ndarray, "m 3"] | None = None
    colours: UInt8[np.ndarray, "n 3"] | None = None
    alarming: bool = False


def contact_sheet(tiles: Sequence[Tile], *, columns: int | None = None) -> UInt8[np.ndarray, "h w 3"]:
    """Draw shapes in rows, all in one scale; of more than 240 the first.

    Args:
        tiles: at least one, in their order.
        columns: how many in a row; by default some more than there are rows.

    Raises:
        ArgumentError: if there is nothing to draw.
        MissingExtraError: without the extra ``picture``.
    """
    if not tiles:
        raise ArgumentError("tiles is empty; give at least one")
    tiles = tiles[:_MOST]
    columns = min(len(tiles), columns or max(6, int(np.ceil(np.sqrt(1.6 * len(tiles))))))
    words = 1 + max(len(tile.lines) for tile in tiles)
    height = _HEIGHT + words * _LINE + _LINE // 2
    sheet = np.full((-(-len(tiles) // columns) * height, columns * _WIDTH, 3), 255, dtype=np.uint8)
    unit = _unit(tiles)
    for number, tile in enumerate(tiles):
        top, left = number // columns * height, number % columns * _WIDTH
        sheet[top : top + _HEIGHT, left : left + _WIDTH] = _drawn(tile, unit)
    return _labelled(sheet, tiles, columns, height)


def _seen(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """A shape as the viewer sees it, around the middle of what is seen."""
    seen = points @ view_rotation().T
    return np.asarray(seen - (seen.min(axis=0) + seen.max(axis=0)) / 2)


def _unit(tiles: Sequence[Tile]) -> float:
    """How many pixels a shape's unit has, so that all of them fit."""
    extents = [
        np.ptp(_seen(tile.points), axis=0)[:2] + 2 * _reach(tile.points, tile.faces)
        for tile in tiles
        if tile.points is not None
    ]
    free = (1 - 2 * _MARGIN) * np.array([_WIDTH, _HEIGHT])
    return float((free / np.max(extents, axis=0, initial=np.finfo(float).tiny)).min()) if extents else 1.0


def _drawn(tile: Tile, unit: float) -> UInt8[np.ndarray, "h w 3"]:
    canvas = Canvas.blank(_HEIGHT, _WIDTH)
    if tile.points is not None and tile.colours is not None:
        canvas.draw(_drawing(tile.points, tile.faces, tile.colours.astype(np.float64), unit, canvas))
    return averaged(canvas.image)


def _drawing(
    points: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"] | None,
    colours: Float[np.ndarray, "n 3"],
    unit: float,
    canvas: Canvas,
) -> Drawing:
    height, width = canvas.depth.shape
    per_unit = unit * width / _WIDTH
    places = per_unit * _seen(points) * [1, -1, 1] + [width / 2, height / 2, 0]
    if faces is not None:
        return Drawing(places, seen_normals(places, faces), colours, faces)
    return balls(places, colours, per_unit * _reach(points, faces))


def _reach(points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"] | None) -> float:
    """How far what is drawn of a point reaches beyond it."""
    if faces is not None:
        return 0.0
    # Placed points come in clumps: the nearest one says little of how densely they lie.
    return RADIUS * float(np.median(KDTree(points).query(points, k=_AROUND + 1)[0][:, -1]))


def _labelled(
    sheet: UInt8[np.ndarray, "h w 3"], tiles: Sequence[Tile], columns: int, height: int
) -> UInt8[np.ndarray, "h w 3"]:
    with needs_extra("contact sheets", "picture"):
        from PIL import Image, ImageDraw, ImageFont
    image, font = Image.fromarray(sheet), ImageFont.load_default(_FONT_SIZE)
    pen = ImageDraw.Draw(image)
    for number, tile in enumerate(tiles):
        top, middle = number // columns * height + _HEIGHT, (number % columns + 0.5) * _WIDTH
        for place, line in enumerate((tile.title, *tile.lines)):
            colour = _ALARM if tile.alarming and place == len(tile.lines) else _GREY if place else _INK
            pen.text((middle, top + place * _LINE), _fitting(line, font.getlength), fill=colour, font=font, anchor="ma")
    return np.asarray(image)


def _fitting(line: str, length: Callable[[str], float]) -> str:
    """A line, cut so that it does not reach its neighbour's."""
    if length(line) <= _WIDTH - 10:
        return line
    while line and length(line + "...") > _WIDTH - 10:
        line = line[:-1]
    return line + "..."
