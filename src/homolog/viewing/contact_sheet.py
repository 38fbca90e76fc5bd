"""Many shapes in one image, in rows, each with a caption."""

from __future__ import annotations

import unicodedata
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from homolog.core.errors import ArgumentError, needs_extra
from homolog.viewing.drawing import RADIUS, Canvas, averaged, shape_drawing, view_rotation
from homolog.viewing.scene import typical_spacing

MOST_TILES = 240
"""More would take long to draw and longer to look at; the first ones are those to look at."""

# In pixels: of a shape's place, and of a line of words below it.
_WIDTH, _HEIGHT, _LINE = 200, 230, 17
_FONT_SIZE = 13
_MARGIN = 0.06  # of a shape's place
# Which neighbour of a point is a spacing away. Registered points come in clumps: the nearest says little.
_AROUND = 4
# So many times as large or small as the middle one, a shape would be a dot, or make dots of all others.
_MUCH_LARGER = 5.0
_OWN_SCALE = "not to scale"
_LEAST = 1e-100  # of a shape's extent, so that one that is a point has a scale
_NO_LETTER = "\U0010ffff"  # that no font has
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
    """Draw shapes in rows, in one scale; of more than 240 the first, and a line below that says how many are left out.

    A shape more than five times as large or as small as the middle one has a scale of its own, and says so. Letters
    that the font lacks, which is most but those of English, lose their accents or become question marks: to tell shapes
    by their titles whatever they are called, number them.

    Args:
        tiles: at least one, in their order.
        columns: how many in a row; by default some more than there are rows.

    Raises:
        ArgumentError: if there is nothing to draw.
        MissingExtraError: without the extra ``picture``.
    """
    if not tiles:
        raise ArgumentError("tiles is empty; give at least one")
    shown, left_out = tiles[:MOST_TILES], max(0, len(tiles) - MOST_TILES)
    columns = min(len(shown), columns or max(6, int(np.ceil(np.sqrt(1.6 * len(shown))))))
    bodies = [_Body.of(tile) for tile in shown]
    units, common = _units(bodies)
    shown = [
        tile if body is None or one else replace(tile, lines=(_OWN_SCALE, *tile.lines))
        for tile, body, one in zip(shown, bodies, common, strict=True)
    ]
    height = _HEIGHT + (1 + max(len(tile.lines) for tile in shown)) * _LINE + _LINE // 2
    rows = -(-len(shown) // columns)
    sheet = np.full((rows * height + (2 * _LINE if left_out else 0), columns * _WIDTH, 3), 255, dtype=np.uint8)
    for number, (body, unit) in enumerate(zip(bodies, units, strict=True)):
        top, left = number // columns * height, number % columns * _WIDTH
        if body is not None:
            sheet[top : top + _HEIGHT, left : left + _WIDTH] = body.drawn(float(unit))
    return _labelled(sheet, shown, columns, height, left_out)


@dataclass(frozen=True, eq=False)
class _Body:
    """What is drawn of a tile.

    Args:
        points: as the viewer sees them, around the middle of what is seen.
        faces: triangles, or None for a cloud.
        colours: of the points.
        reach: how far what is drawn of a point reaches beyond it.
    """

    points: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"] | None
    colours: UInt8[np.ndarray, "n 3"]
    reach: float

    @classmethod
    def of(cls, tile: Tile) -> _Body | None:
        """That of a tile, if there is anything."""
        if tile.points is None or tile.colours is None:
            return None
        seen = tile.points @ view_rotation().T
        reach = RADIUS * typical_spacing(tile.points, neighbour=_AROUND) if tile.faces is None else 0.0
        return cls(seen - (seen.min(axis=0) + seen.max(axis=0)) / 2, tile.faces, tile.colours, reach)

    @property
    def unit(self) -> float:
        """How many pixels its unit has where it just fits."""
        extents = np.ptp(self.points, axis=0)[:2] + 2 * self.reach
        free = (1 - 2 * _MARGIN) * np.array([_WIDTH, _HEIGHT])
        return float((free / np.maximum(extents, _LEAST)).min())

    def drawn(self, unit: float) -> UInt8[np.ndarray, "h w 3"]:
        """It alone, with so many pixels to its unit."""
        canvas = Canvas.blank(_HEIGHT, _WIDTH)
        height, width = canvas.depth.shape
        per_unit = unit * width / _WIDTH
        places = per_unit * self.points * [1, -1, 1] + [width / 2, height / 2, 0]
        canvas.draw(shape_drawing(places, self.faces, self.colours.astype(np.float64), per_unit * self.reach))
        return averaged(canvas.image)


def _units(bodies: Sequence[_Body | None]) -> tuple[Float[np.ndarray, " t"], Bool[np.ndarray, " t"]]:
    """How many pixels the unit of each has, and whether that is the scale of most, in which all of these fit."""
    own = np.array([np.nan if body is None else body.unit for body in bodies])
    ordered = np.sort(own[np.isfinite(own)])
    if not len(ordered):
        return own, np.zeros(len(own), dtype=bool)
    middle = ordered[len(ordered) // 2]
    common = (own > middle / _MUCH_LARGER) & (own < middle * _MUCH_LARGER)
    return np.where(common, own[common].min(), own), common


def _labelled(
    sheet: UInt8[np.ndarray, "h w 3"], tiles: Sequence[Tile], columns: int, height: int, left_out: int
) -> UInt8[np.ndarray, "h w 3"]:
    with needs_extra("contact sheets", "picture"):
        from PIL import Image, ImageDraw, ImageFont
    image, font = Image.fromarray(sheet), ImageFont.load_default(_FONT_SIZE)
    pen = ImageDraw.Draw(image)
    for number, tile in enumerate(tiles):
        top, middle = number // columns * height + _HEIGHT, (number % columns + 0.5) * _WIDTH
        for place, line in enumerate((tile.title, *tile.lines)):
            colour = _ALARM if tile.alarming and place == len(tile.lines) else _GREY if place else _INK
            words = _fitting(_in_letters(line, font), font.getlength)
            pen.text((middle, top + place * _LINE), words, fill=colour, font=font, anchor="ma")
    if left_out:
        said = f"{left_out} more are left out"
        pen.text((_WIDTH / 2, sheet.shape[0] - 1.5 * _LINE), said, fill=_ALARM, font=font, anchor="ma")
    return np.asarray(image)


def _in_letters(line: str, font: Any) -> str:
    """A line in letters that a font has: without accents where it lacks them, or question marks."""
    lacking = bytes(font.getmask(_NO_LETTER))

    def written(letter: str) -> str:
        if unicodedata.combining(letter):
            return ""
        plain = unicodedata.normalize("NFKD", letter)[0]
        return next((one for one in (letter, plain) if bytes(font.getmask(one)) != lacking), "?")

    return "".join(map(written, unicodedata.normalize("NFC", line)))


def _fitting(line: str, length: Callable[[str], float]) -> str:
    """A line, cut so that it does not reach its neighbour's."""
    if length(line) <= _WIDTH - 10:
        return line
    while line and length(line + "...") > _WIDTH - 10:
        line = line[:-1]
    return line + "..."
