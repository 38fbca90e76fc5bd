"""Shapes in rows: each in its place, in its colours, at one scale."""

import numpy as np
import pytest

from homolog.errors import ArgumentError
from homolog.viewing import Tile, contact_sheet

pytest.importorskip("PIL")
COLOURS = [(220, 40, 40), (40, 180, 40), (40, 40, 220)]


def places(sheet, columns, rows, tile):
    """The part of the sheet that a tile has."""
    height, width = sheet.shape[0] // rows, sheet.shape[1] // columns
    row, column = divmod(tile, columns)
    return sheet[row * height : (row + 1) * height, column * width : (column + 1) * width].astype(int)


def coloured(part):
    return np.ptp(part, axis=2) > 60


def test_each_shape_is_in_its_place(make):
    sphere = make.sphere(2)
    tiles = [
        Tile(
            f"ball {number}", (), sphere.points * size, faces, np.tile(np.uint8(COLOURS[number]), (sphere.n_points, 1))
        )
        for number, (size, faces) in enumerate([(1, sphere.faces), (0.5, sphere.faces), (1, None)])
    ]
    sheet = contact_sheet([*tiles, Tile("nothing", ("to see",), alarming=True)], columns=2)
    sizes = []
    for number in range(3):
        part = places(sheet, 2, 2, number)
        mask = coloured(part)
        assert part[mask].sum(axis=0).argmax() == np.argmax(COLOURS[number])
        ((top, left), (bottom, right)) = (np.argwhere(mask).min(axis=0), np.argwhere(mask).max(axis=0))
        assert bottom - top == pytest.approx(right - left, abs=3)
        sizes.append(right - left + 1)
    assert sizes[1] / sizes[0] == pytest.approx(0.5, abs=0.03)
    assert 120 < sizes[0] < sheet.shape[1] / 2
    words = places(sheet, 2, 2, 3)
    assert coloured(words).any() and (words == 255).mean() > 0.95  # a line in red, and no shape


def test_long_names_do_not_reach_their_neighbours(make):
    blank = contact_sheet([Tile("x" * 300), Tile("y")], columns=2)
    middle = blank.shape[1] // 2
    assert (blank[:, middle - 4 : middle + 4] == 255).all() and (blank < 200).any()


def test_nothing_to_draw():
    with pytest.raises(ArgumentError, match="tiles is empty"):
        contact_sheet([])
