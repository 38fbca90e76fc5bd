"""Shapes in rows: each in its place, in its colours, at one scale."""

import numpy as np
import pytest

from homolog.core.errors import ArgumentError
from homolog.viewing import MOST_TILES, Tile, contact_sheet

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


def test_one_shape_in_other_units_leaves_the_others_as_they_are(make):
    sphere = make.sphere(2)

    def sizes(*factors):
        colours = np.tile(np.uint8(COLOURS[0]), (sphere.n_points, 1))
        sheet = contact_sheet([Tile("ball", (), f * sphere.points, sphere.faces, colours) for f in factors], columns=4)
        masks = (coloured(places(sheet, 4, 1, number)) for number in range(4))
        return [np.ptp(np.argwhere(mask)[:, 0]) + 1 for mask in masks]

    alone = sizes(1, 0.5, 1, 1)
    for factor in (1000, 0.001):
        mixed = sizes(1, 0.5, factor, 1)
        assert mixed[:2] == alone[:2] and mixed[3] == alone[3]
        assert mixed[2] == alone[0]  # as large as fits, and not a dot or all of the sheet


def test_a_shape_at_its_own_scale_says_so(make):
    sphere = make.sphere(1)
    colours = np.tile(np.uint8(COLOURS[0]), (sphere.n_points, 1))

    def ball(factor, *lines):
        return Tile("ball", lines, factor * sphere.points, sphere.faces, colours)

    others = [ball(1, "of a kind"), ball(1, "of a kind")]
    told = contact_sheet([*others, ball(1, "not to scale", "of a kind")])
    np.testing.assert_array_equal(contact_sheet([*others, ball(1024, "of a kind")]), told)


def test_letters_that_the_font_lacks_are_no_boxes():
    """They give way to letters that it has, where there are such."""
    for name, written in (("caf\u00e9", "cafe"), ("cafe\u0301", "cafe"), ("12. \u5de6\u80ba_01", "12. ??_01")):
        np.testing.assert_array_equal(contact_sheet([Tile(name)]), contact_sheet([Tile(written)]))


def test_what_is_left_out_is_said():
    tiles = [Tile(str(number)) for number in range(MOST_TILES + 3)]
    all_of_them, too_many = contact_sheet(tiles[:MOST_TILES]), contact_sheet(tiles)
    height = len(all_of_them)
    np.testing.assert_array_equal(too_many[:height], all_of_them)
    assert coloured(too_many[height:].astype(int)).any()
    assert (contact_sheet(tiles[:-1])[height:] != too_many[height:]).any()  # it says how many


def test_nothing_to_draw():
    with pytest.raises(ArgumentError, match="tiles is empty"):
        contact_sheet([])
