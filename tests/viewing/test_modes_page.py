"""The page of a shape model: what it holds, and that its sliders bend the shape as the model says."""

import base64
import json
import re
import zlib
from html.parser import HTMLParser

import numpy as np
import pytest

from homolog.viewing import ModesScene, modes_page_of


@pytest.fixture
def model(make):
    """A blob with two modes: its height, and a shear."""
    blob = make.blob(2)
    offsets = np.stack([blob.points * [0, 0.2, 0], blob.points[:, [1, 0, 2]] * [0.1, 0, 0]])
    return ModesScene(
        title="Modes of <blobs> & more",
        summary="3 shapes vary in 2 modes.",
        mean=blob.points + 5,
        faces=blob.faces,
        colours=np.full((blob.n_points, 3), (200, 60, 40), dtype=np.uint8),
        offsets=offsets,
        shares=np.array([0.8, 0.2]),
        names=["a", "</script>", "c"],
        coefficients=np.array([[1.0, -2.0], [0.5, 0.0], [-4.0, 0.25]]),
    )


def told(page):
    """The scene of a page, and its arrays."""
    scripts, inside = {}, None

    class Parts(HTMLParser):
        def handle_starttag(self, tag, attributes):
            nonlocal inside
            inside = dict(attributes).get("id") if tag == "script" else None

        def handle_endtag(self, tag):
            nonlocal inside
            inside = None

        def handle_data(self, data):
            if inside:
                scripts[inside] = scripts.get(inside, "") + data

    Parts().feed(page)
    block = zlib.decompress(base64.b64decode(scripts["arrays"]))
    return json.loads(scripts["scene"]), lambda place: np.frombuffer(
        block, dtype=place["kind"], count=place["length"], offset=place["begin"]
    )


def test_it_holds_the_model(model):
    scene, read = told(modes_page_of(model))
    (body,), unit = scene["bodies"], scene["unit"]
    middle = (model.mean.min(axis=0) + model.mean.max(axis=0)) / 2
    np.testing.assert_allclose(unit * read(body["points"]).reshape(-1, 3) + middle, model.mean, atol=1e-5)
    np.testing.assert_array_equal(read(body["faces"]).reshape(-1, 3), model.faces)
    for mode, offset in zip(scene["modes"], model.offsets, strict=True):
        np.testing.assert_allclose(unit * read(mode["offsets"]).reshape(-1, 3), offset, atol=1e-6)
    assert [subject["coefficients"] for subject in scene["subjects"]] == model.coefficients.tolist()
    assert scene["reach"] * unit == pytest.approx(3 * np.linalg.norm(model.offsets, axis=2).max())


def test_the_picture_has_room_for_all_that_sliders_ask_for(model):
    """Along any one mode, and however the shape is turned about the vertical."""
    scene, read = told(modes_page_of(model))
    mean = read(scene["bodies"][0]["points"]).reshape(-1, 3)
    assert scene["farthest"] == 3
    for mode in scene["modes"]:
        for way in (-scene["farthest"], scene["farthest"]):
            x, y, z = (mean + way * read(mode["offsets"]).reshape(-1, 3)).T
            assert np.hypot(x, z).max() <= scene["room"]["width"] + 1e-6
            assert np.abs(y).max() <= scene["room"]["height"] + 1e-6


def test_it_refers_to_nothing(model):
    page = modes_page_of(model)
    assert re.findall(r"(?:https?:)?//[\w-]+\.\w+|@import|url\(|\bfetch\(|XMLHttpRequest|\bimport\(", page) == []
    assert "default-src 'none'" in page and "Modes of &lt;blobs&gt; &amp; more" in page
    assert page.count("<script") == 3


@pytest.mark.browser
@pytest.mark.parametrize("faces", [True, False])
def test_dragging_a_slider_bends_the_shape(model, tab, tmp_path, faces):
    file = tmp_path / "modes.html"
    shown = model if faces else ModesScene(**{**vars(model), "faces": None})
    file.write_text(modes_page_of(shown), encoding="utf-8")
    one = tab()
    one.page.context.set_offline(True)
    one.page.goto(file.as_uri())
    one.page.wait_for_selector("body[data-ready]")
    scene, read = told(modes_page_of(shown))
    mean = read(scene["bodies"][0]["points"])
    offsets = [read(mode["offsets"]) for mode in scene["modes"]]

    def picture():
        one.page.evaluate("new Promise(drawn => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
        return one.page.locator("#canvas").screenshot()

    def moved():
        # Not wait_for_function: asking twice it evaluates text in the page, which the policy of the page forbids.
        return one.page.evaluate("homolog.where()")[0] != 0

    still = picture()
    box = one.page.locator("#mode-0").bounding_box()
    one.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    one.page.mouse.down()
    one.page.mouse.move(box["x"] + 0.9 * box["width"], box["y"] + box["height"] / 2, steps=4)
    one.page.mouse.up()
    where = one.page.evaluate("homolog.where()")
    assert 1.5 < where[0] <= 3 and where[1] == 0
    np.testing.assert_allclose(one.page.evaluate("homolog.points()"), mean + where[0] * offsets[0], atol=1e-5)
    bent = picture()
    assert bent != still
    one.page.select_option("#colours", "away")
    assert one.page.is_visible("#ramp") and picture() != bent
    one.page.select_option("#subject", "</script>")
    assert one.page.evaluate("homolog.where()") == [0.5, 0]
    one.page.select_option("#subject", "c")
    assert one.page.evaluate("homolog.where()") == [-4, 0.25]  # farther than a slider shows
    one.page.click("#mean")
    one.page.select_option("#colours", "place")
    assert one.page.evaluate("homolog.where()") == [0, 0] and picture() == still
    one.page.click("#play")
    assert any(moved() or one.page.wait_for_timeout(100) for _ in range(300))
    one.page.locator("#canvas").press("Escape")
    assert one.page.evaluate("homolog.where()") == [0, 0]
    assert one.complaints == [] and len(one.requests) == 1
