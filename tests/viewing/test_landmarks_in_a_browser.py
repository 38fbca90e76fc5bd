"""Landmarks that are set on the page, and maps that are chosen there, in Chromium."""

from dataclasses import replace

import numpy as np
import pytest
from viewing_tools import SIDES, colour_at, comes, foremost, on_page

from homolog.pairs import PairOptions
from homolog.transfer import read_landmark_pairs
from homolog.viewing import page_of, scene_of

pytestmark = pytest.mark.browser


def landmarks(one):
    return one.page.evaluate("homolog.landmarks()")


def click_foremost(one, result, side):
    point, x, y = foremost(one.page, scene_of(result), side)
    one.page.mouse.click(x, y)
    return point


def saved(one, side, folder):
    """The file that the page saves."""
    with one.page.expect_download() as waited:
        one.page.click(f"#save-{side}")
    waited.value.save_as(folder / waited.value.suggested_filename)
    return folder / waited.value.suggested_filename


def test_clicks_set_landmarks_that_can_be_read(opened, known, tmp_path):
    """Of a pair, either end may come first; the files then lead back to the points that were clicked."""
    one = opened(known, height=900)
    assert not one.page.is_visible("#with-landmarks")
    one.page.click("#set")
    first = [click_foremost(one, known, side) for side in SIDES]
    assert landmarks(one) == [first] and one.page.evaluate("homolog.marked()") is None
    one.page.mouse.move(225, 300)  # seen from behind
    one.page.mouse.down()
    one.page.mouse.move(500, 340, steps=4)
    one.page.mouse.up()
    second = [click_foremost(one, known, side) for side in SIDES[::-1]][::-1]
    assert landmarks(one) == [first, second] and first != second
    assert one.page.inner_text("#landmarks").split("\n")[:2] == ["1", f"{first[0]} → {first[1]}"]
    assert "--landmarks a_blob-landmarks.mrk.json other-landmarks.mrk.json" in one.page.input_value("#command")
    files = [saved(one, side, tmp_path) for side in (0, 1)]
    assert [file.name for file in files] == ["a_blob-landmarks.mrk.json", "other-landmarks.mrk.json"]
    pairs = read_landmark_pairs(*files)
    assert pairs.names == ("1", "2")
    for side, number in (("source", 0), ("target", 1)):
        wanted = getattr(known, side).points[[first[number], second[number]]]
        np.testing.assert_allclose(pairs.on(side), wanted, atol=1e-6)
    assert one.complaints == []


def test_a_landmark_is_seen_in_one_colour_on_both_shapes(opened, known):
    one = opened(known, height=900)
    one.page.click("#set")
    points = {side: click_foremost(one, known, side) for side in SIDES}
    places = [on_page(one.page, scene_of(known), side, np.array([point])) for side, point in points.items()]
    beside = [(float(x[0]) - 7, float(y[0])) for x, y, _ in places]  # of the number, within the disc
    told = "getComputedStyle(document.querySelector('#landmarks b')).backgroundColor.match(/\\d+/g)"
    disc = np.array(one.page.evaluate(told), dtype=int)

    def is_seen():
        return all(np.abs(np.subtract(colour_at(one.page, *place), disc)).max() < 40 for place in beside)

    assert comes(one.page, is_seen)
    one.page.click("#landmarks button")
    assert comes(one.page, lambda: not is_seen()) and landmarks(one) == []


def test_landmarks_by_keys_alone(opened, known):
    """The list is reached and changed without a pointer; what is no point's number is said to be none."""
    one = opened(known, height=900)
    one.page.focus("#set")
    one.page.keyboard.press("Enter")
    one.page.keyboard.press("Tab")
    for source, target in ((3, 8), (40, 41), (100, 7)):
        one.page.keyboard.type(str(source))
        one.page.keyboard.press("Tab")
        one.page.keyboard.type(str(target))
        one.page.keyboard.press("Enter")  # and the first field has the focus again
    assert landmarks(one) == [[3, 8], [40, 41], [100, 7]]
    one.page.keyboard.type("5")
    one.page.keyboard.press("Tab")
    one.page.keyboard.type("162")
    one.page.keyboard.press("Enter")
    assert len(landmarks(one)) == 3 and one.page.inner_text("#guide") == "The target has points 0 to 161."
    one.page.focus("[aria-label='Remove landmark 2']")
    one.page.keyboard.press("Enter")
    assert landmarks(one) == [[3, 8], [100, 7]]
    one.page.keyboard.press("Enter")  # the next one's button has the focus
    one.page.keyboard.press("Enter")
    assert landmarks(one) == []
    assert one.page.evaluate("document.activeElement.id") == "set"
    one.page.keyboard.press("Enter")
    one.page.focus("#canvas")
    assert not one.page.is_visible("#by-number")


def test_escape_takes_back_an_end_and_clicks_mark_once_more(opened, known):
    one = opened(known, height=900)
    one.page.click("#set")
    click_foremost(one, known, "source")
    assert one.page.inner_text("#guide") == "Now click its counterpart on the target."
    one.page.keyboard.press("Escape")
    click_foremost(one, known, "target")
    assert landmarks(one) == [] and one.page.inner_text("#guide") == "Now click its counterpart on the source."
    one.page.click("#set")
    point = click_foremost(one, known, "target")
    assert one.page.evaluate("homolog.marked()")["point"] == point and landmarks(one) == []


def test_no_more_landmarks_than_can_guide(opened, known):
    many = PairOptions(landmarks=(np.arange(50), np.arange(50)))
    one = opened(replace(known, report={**known.report, "options": many.to_dict()}), height=900)
    assert landmarks(one) == [[number, number] for number in range(50)]
    one.page.click("#set")
    for side in SIDES:
        click_foremost(one, known, side)
    assert len(landmarks(one)) == 50 and "as many as guide a match" in one.page.inner_text("#guide")


def test_a_page_that_takes_no_landmarks(tab, known, tmp_path):
    (tmp_path / "page.html").write_text(page_of(replace(scene_of(known), guide=None)), encoding="utf-8")
    one = tab()
    one.page.goto((tmp_path / "page.html").as_uri())
    one.page.wait_for_selector("body[data-ready]")
    assert not one.page.is_visible("#guiding") and one.complaints == []


def test_another_map_is_chosen(opened, known):
    """What is marked stays, and has its counterpart by that map; colours are those of that map."""
    shifted = np.roll(np.arange(162), 40)
    other = replace(known, source_to_target=shifted, target_to_source=np.argsort(shifted))
    one = opened(known, other, height=900)
    point = click_foremost(one, known, "source")
    assert one.page.evaluate("homolog.marked()")["counterpart"] == known.source_to_target[point]
    there, x, y = foremost(one.page, scene_of(known), "target")
    before = colour_at(one.page, x, y)
    one.page.focus("#map")
    one.page.keyboard.press("ArrowDown")
    assert one.page.evaluate("homolog.marked()") == {
        "side": "source",
        "point": point,
        "counterpart": int(shifted[point]),
    }
    assert "alternative-2" in one.page.inner_text("#map-note")
    colours = [scene_of(match).layers[0].colours["target"][there].astype(int) for match in (known, other)]
    assert np.abs(colours[0] - colours[1]).max() > 30  # so that the picture must change
    assert comes(one.page, lambda: np.abs(np.subtract(colour_at(one.page, x, y), before)).max() > 10)
    one.page.keyboard.press("ArrowUp")
    assert one.page.evaluate("homolog.marked()")["counterpart"] == known.source_to_target[point]
    assert one.complaints == []


def test_one_map_needs_no_menu(opened, known):
    assert not opened(known).page.is_visible("#maps")
