"""The page from disk and the live view, in Chromium: clicks land where the camera sees known points."""

import re
import socket
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from homolog.viewing import LiveView, page_of, scene_of

pytestmark = pytest.mark.browser
SIDES = ("source", "target")


def counterpart(result, side, point):
    found = result.found
    return int((found.source_to_target if side == "source" else found.target_to_source)[point])


# ---- the page


@pytest.fixture
def opened(tab, tmp_path):
    """``opened(result)`` is a tab with the result's page, loaded from disk with the network off."""

    def load(result, **size):
        file = tmp_path / "page.html"
        file.write_text(page_of(scene_of(result)), encoding="utf-8")
        one = tab(**size)
        one.page.context.set_offline(True)
        one.page.goto(file.as_uri())
        one.page.wait_for_selector("body[data-ready]")
        return one

    return load


def on_page(page, scene, side, points):
    """Where on the page points are seen, and how deep, by the camera's own matrices."""
    camera = page.evaluate("side => homolog.camera(side)", SIDES.index(side))
    view, clip = (np.reshape(camera[name], (4, 4)).T for name in ("view", "clip"))
    homogeneous = np.concatenate([scene.bodies[side].points[points], np.ones((len(points), 1))], axis=1)
    x, y, depth, w = clip @ view @ homogeneous.T
    part = camera["part"]
    return part["left"] + (x / w + 1) / 2 * part["width"], (1 - y / w) / 2 * part["height"], depth / w


def foremost(page, scene, side):
    """The point nearest to the camera, and where it is seen."""
    everything = np.arange(len(scene.bodies[side].points))
    x, y, depth = on_page(page, scene, side, everything)
    point = int(depth.argmin())
    return point, float(x[point]), float(y[point])


def check_clicks(one, result):
    scene = scene_of(result)
    for side in SIDES:
        point, x, y = foremost(one.page, scene, side)
        one.page.mouse.click(x, y)
        expected = {"side": side, "point": point, "counterpart": counterpart(result, side, point)}
        assert one.page.evaluate("homolog.marked()") == expected
        told = dict(re.findall(r"(\w[\w ]*)\t(.*)", one.page.inner_text("#marked")))
        assert told["source" if side == "source" else "target"] == f"point {point}"
        assert told["target" if side == "source" else "source"] == f"point {expected['counterpart']}"
        assert told["and back"] == "the same point"


def test_page_marks_what_is_clicked(opened, known):
    one = opened(known)
    check_clicks(one, known)
    one.page.mouse.move(225, 300)  # and so it does after a turn, seen from behind and from above
    one.page.mouse.down()
    one.page.mouse.move(420, 340, steps=4)
    one.page.mouse.up()
    one.page.mouse.wheel(0, -200)
    check_clicks(one, known)
    one.page.select_option("#surface", "points")
    check_clicks(one, known)
    one.page.click("#clear")
    assert one.page.evaluate("homolog.marked()") is None
    assert one.complaints == []
    assert len(one.requests) == 1 and one.requests[0].startswith("file:")


def test_page_of_clouds(opened, known_clouds):
    one = opened(known_clouds, width=500, height=900)
    assert not one.page.is_visible("#drawing")
    check_clicks(one, known_clouds)
    assert one.complaints == []


def test_a_mark_is_seen_on_both_shapes(opened, known):
    """Its colour is on the canvas where both points are, and nowhere before."""
    one, scene = opened(known), scene_of(known)
    point, x, y = foremost(one.page, scene, "source")
    other = counterpart(known, "source", point)
    there = [(x, y), tuple(float(place[0]) for place in on_page(one.page, scene, "target", np.array([other]))[:2])]
    assert not any(magenta(one.page, *place) for place in there)
    one.page.mouse.click(x, y)
    one.page.wait_for_timeout(200)
    assert all(magenta(one.page, *place) for place in there)


def magenta(page, x, y):
    red, green, blue = colour_at(page, x, y)
    return red > 150 and green < 60 and 60 < blue < 200


def colour_at(page, x, y):
    """What is drawn at a place of the page."""
    image = pytest.importorskip("PIL.Image")
    from io import BytesIO

    shot = page.screenshot(clip={"x": round(x) - 1, "y": round(y) - 1, "width": 3, "height": 3})
    return image.open(BytesIO(shot)).convert("RGB").getpixel((1, 1))


def test_colours_and_sliders_of_the_page(opened, known):
    """A light confidence is light where it is drawn; above it, it is pale; a hidden point cannot be clicked."""
    one, scene = opened(known), scene_of(known)
    point, x, y = foremost(one.page, scene, "source")
    ramp = scene.layer("Confidence").colours["source"][point].astype(float)
    one.page.select_option("#layer", "Confidence")
    one.page.wait_for_timeout(200)
    drawn = np.array(colour_at(one.page, x, y), dtype=float)
    assert drawn @ ramp / np.linalg.norm(drawn) / np.linalg.norm(ramp) > 0.97  # the hue, whatever the light
    one.page.fill("#confidence", "1")
    one.page.wait_for_timeout(200)
    assert np.ptp(colour_at(one.page, x, y)) < 12
    one.page.select_option("#surface", "points")
    one.page.mouse.click(x, y)
    marked = one.page.evaluate("homolog.marked()")
    assert marked is None or known.found.source_confidence[marked["point"]] >= 1
    assert one.complaints == []


# ---- the live view


@pytest.fixture
def live():
    """``live(result)`` is a live view of it, at a port that was free."""
    pytest.importorskip("viser", reason="viser is missing; pip install 'homolog[view]'")
    running = []

    def start(result, port=0):
        running.append(LiveView(scene_of(result), port=port))
        return running[-1]

    yield start
    for one in running:
        one.stop()


@pytest.fixture
def served(live):
    """The same, being served."""
    running = []

    def start(result):
        one = live(result)
        running.append((one, threading.Thread(target=one.serve)))
        running[-1][1].start()
        return one

    yield start
    for one, thread in running:
        one.end()
        thread.join(timeout=30)


def on_live_page(server, box, place):
    """Where a point is seen by the camera that the server knows, in a canvas: plain projective geometry."""
    (client,) = server.get_clients().values()
    camera = client.camera
    forward = camera.look_at - camera.position
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0, 1, 0])
    right = right / np.linalg.norm(right)
    seen = np.stack([right, np.cross(right, forward), forward]) @ (place - camera.position)
    pixels = box["height"] / 2 / np.tan(camera.fov / 2)
    x = box["x"] + box["width"] / 2 + pixels * seen[0] / seen[2]
    return float(x), float(box["y"] + box["height"] / 2 - pixels * seen[1] / seen[2])


def test_live_view_marks_what_is_clicked(served, tab, known):
    view, scene, one = served(known), scene_of(known), tab(800, 450)
    one.page.goto(view.address)
    one.page.wait_for_selector("text=Click a point to mark its counterpart.")
    one.page.wait_for_selector("canvas")
    one.page.wait_for_timeout(3000)  # until the canvas has its size and both shapes have come
    box = one.page.locator("canvas").first.bounding_box()
    for side in SIDES:
        body = scene.bodies[side]
        point = int(body.points[:, 2].argmax())
        one.page.mouse.click(*on_live_page(view._server, box, body.points[point] + body.offset))
        other = counterpart(known, side, point)
        names = {side: f"point {point}", "target" if side == "source" else "source": f"point {other}"}
        one.page.wait_for_selector(f"text=point {point}")
        rows = dict(re.findall(r"(\w[\w ]*?)\s*\t(.*)", one.page.locator("table").first.inner_text()))
        assert {name: rows[name] for name in SIDES} == names
        places = scene.places(scene.mark(side, point))
        for name in SIDES:
            marker = view._server.scene.get_handle_by_name(f"/{name}/mark")
            np.testing.assert_allclose(marker.position, places[name])
    assert one.complaints == []
    assert all(re.match(rf"(blob:)?{view.address}|data:", url) for url in one.requests)


def test_live_view_recolours_and_shows_points(live, known):
    """Without a browser: what a control changes is sent anew."""
    view, scene = live(known), scene_of(known)
    view._choice.value, view._drawn.value, view._share.value = "Confidence", "points", 50
    view._changed(None)
    view.redraw()
    for side in SIDES:
        drawn = view._server.scene.get_handle_by_name(f"/{side}/shape")
        half = scene.bodies[side].rank < np.ceil(len(scene.bodies[side].points) / 2)
        np.testing.assert_allclose(drawn.points, scene.bodies[side].points[half], atol=1e-6)
        np.testing.assert_array_equal(drawn.colors, scene.layer("Confidence").colours[side][half])
        assert view._server.scene.get_handle_by_name(f"/{side}/beneath") is not None
    view._drawn.value = "surfaces"
    view._changed(None)
    view.redraw()
    assert view._server.scene.get_handle_by_name("/source/beneath") is None


def test_live_view_reaches_a_few_pixels_around_a_click(live, known_clouds):
    """A pixel of a tiny window is 0.08 wide at a distance of nine: seven reach to 0.56 from the leftmost point."""
    view, body = live(known_clouds), scene_of(known_clouds).bodies["source"]
    leftmost = int(body.points[:, 0].argmin())
    camera = SimpleNamespace(fov=np.pi / 6, image_height=60)
    for away, told in ((0.8, "Click a point"), (0.4, f"point {leftmost}<")):
        origin = body.points[leftmost] + body.offset + np.array([-away, 0, 9])
        view._clicked(
            SimpleNamespace(client=SimpleNamespace(camera=camera), ray_origin=origin, ray_direction=(0, 0, -1))
        )
        assert told in view._told.content


def test_live_view_takes_the_next_free_port(live, known):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert live(known, port).port > port
