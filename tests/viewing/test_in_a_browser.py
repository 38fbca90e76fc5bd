"""The page in Chromium, from disk and served: clicks land where the camera sees known points."""

import re
import threading
from dataclasses import replace

import numpy as np
import pytest
from viewing_tools import SIDES, colour_at, comes, foremost, on_page

from homolog.serving import PageServer
from homolog.viewing import page_of, scene_of

pytestmark = pytest.mark.browser


def counterpart(result, side, point):
    return int((result.source_to_target if side == "source" else result.target_to_source)[point])


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
    assert comes(one.page, lambda: all(magenta(one.page, *place) for place in there))


def magenta(page, x, y):
    red, green, blue = colour_at(page, x, y)
    return red > 150 and green < 60 and 60 < blue < 200


def test_colours_and_sliders_of_the_page(opened, known):
    """A light confidence is light where it is drawn; above it, it is pale; a hidden point cannot be clicked."""
    one, scene = opened(known), scene_of(known)
    point, x, y = foremost(one.page, scene, "source")
    ramp = scene.layers[1].colours["source"][point].astype(float)
    one.page.select_option("#layer", "Confidence")

    def has_hue():  # whatever the light
        drawn = np.array(colour_at(one.page, x, y), dtype=float)
        return drawn @ ramp / np.linalg.norm(drawn) / np.linalg.norm(ramp) > 0.97

    assert comes(one.page, has_hue)
    one.page.fill("#confidence", "1")
    assert comes(one.page, lambda: np.ptp(colour_at(one.page, x, y)) < 12)
    one.page.select_option("#surface", "points")
    one.page.mouse.click(x, y)
    marked = one.page.evaluate("homolog.marked()")
    assert marked is None or known.source_confidence[marked["point"]] >= 1
    assert one.complaints == []


def test_page_as_it_is_served(tab, known):
    """Its policy has it from nowhere; it works all the same."""
    server = PageServer(page_of(scene_of(known)), port=0)
    thread = threading.Thread(target=server.serve)
    thread.start()
    try:
        one = tab()
        one.page.goto(server.address)
        one.page.wait_for_selector("body[data-ready]")
        check_clicks(one, known)
        assert one.page.evaluate("window.origin") == "null"
        assert [url.removeprefix(server.address) for url in one.requests] == ["/"]
    finally:
        server.end()
        thread.join(timeout=60)
        server.close()
    assert not thread.is_alive()


def test_a_click_on_a_large_shape_tells_the_number_of_the_file(opened, known, monkeypatch):
    """Of those points that are shown; the counterpart is marked where it is, though it may not be shown itself."""
    monkeypatch.setattr("homolog.viewing.page._MOST_POINTS", 80)
    one, scene = opened(known), scene_of(known)
    assert re.search(r"showing \d\d of 162 points", one.page.inner_text("#caption-0"))
    shown = one.page.evaluate("[0, 1].map((side) => [...homolog.shown(side)])")
    for side, index in zip(SIDES, shown, strict=True):
        x, y, depth = on_page(one.page, scene, side, np.array(index))
        first = int(depth.argmin())
        one.page.mouse.click(float(x[first]), float(y[first]))
        other = counterpart(known, side, index[first])
        assert one.page.evaluate("homolog.marked()") == {"side": side, "point": index[first], "counterpart": other}
        opposite = "target" if side == "source" else "source"
        place = [float(at[0]) for at in on_page(one.page, scene, opposite, np.array([other]))[:2]]
        assert comes(one.page, lambda place=place: magenta(one.page, *place))


def test_a_point_without_a_counterpart(opened, known):
    nowhere = np.full(known.source.n_points, -1)
    result = replace(known, source_to_target=nowhere)
    one = opened(result)
    point, x, y = foremost(one.page, scene_of(result), "source")
    one.page.mouse.click(x, y)
    assert one.page.evaluate("homolog.marked()") == {"side": "source", "point": point, "counterpart": -1}
    told = dict(re.findall(r"(\w[\w ]*)\t(.*)", one.page.inner_text("#marked")))
    assert told == {"source": f"point {point}", "target": "no counterpart"}


# ---- picking, against triangles solved one by one and points looked at one by one


@pytest.fixture
def picking(opened, known):
    """The page's functions, called with arrays; of many rays at once."""
    page = opened(known).page

    def surface(points, faces, rays):
        body = {"points": np.ravel(points).tolist(), "faces": np.ravel(faces).tolist()}
        return page.evaluate("([body, rays]) => rays.map((ray) => homolog.hitSurface(body, ray))", [body, rays])

    def cloud(points, shown, ray, spacing, before=1e9):
        body = {"points": np.ravel(points).tolist(), "spacing": spacing}
        call = "([body, shown, ray, before]) => homolog.hitPoints(body, shown, ray, before)"
        return page.evaluate(call, [body, np.asarray(shown).astype(int).tolist(), ray, before])

    surface.of_points = cloud
    return surface


def aimed(origin, place, slope=0.0):
    direction = np.subtract(place, origin) / np.linalg.norm(np.subtract(place, origin))
    return {"origin": list(map(float, origin)), "direction": direction.tolist(), "slope": slope}


def slow_hit(points, faces, ray):
    """A 3 x 3 system per triangle: origin + t direction = a + u (b - a) + v (c - a)."""
    met = []
    for face in faces:
        a, b, c = points[face]
        columns = [-np.array(ray["direction"]), b - a, c - a]
        t, u, v = np.linalg.solve(np.stack(columns, axis=1), ray["origin"] - a)
        if min(u, v, 1 - u - v) >= 0 and t > 0:
            met.append((t, int(face[np.argmax([1 - u - v, u, v])])))
    return min(met, default=None)


def test_rays_meet_a_surface_where_equations_say(picking, make):
    """Of rays from anywhere to near the surface, some miss it and most meet it several times."""
    blob, rng = make.blob(2), np.random.default_rng(0)
    near = blob.points[rng.integers(blob.n_points, size=45)] + 0.1 * rng.standard_normal((45, 3))
    rays = [aimed(4 * rng.standard_normal(3), place) for place in near]
    found, expected = picking(blob.points, blob.faces, rays), [slow_hit(blob.points, blob.faces, ray) for ray in rays]
    assert [hit is None for hit in found] == [hit is None for hit in expected]
    met = [(hit, true) for hit, true in zip(found, expected, strict=True) if true]
    assert 15 < len(met) < 45
    for hit, (depth, point) in met:
        assert hit["depth"] == pytest.approx(depth) and hit["point"] == point


def test_a_surface_from_behind_and_through_an_edge(picking):
    points, faces = [[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]]
    rays = [
        aimed([0.9, 0.9, 2], [0.9, 0.9, 0]),
        aimed([0.9, 0.9, -2], [0.9, 0.9, 0]),
        aimed([0.2, 0.2, 1], [0.2, 0.2, 2]),  # it lies behind
        aimed([-1, 0.5, 0], [1, 0.5, 0]),  # along the surface
    ]
    assert [hit and hit["point"] for hit in picking(points, faces, rays)] == [2, 2, None, None]


def test_the_nearest_of_the_points_in_front(picking):
    """Of two square grids of points, one eight units behind the other, shifted by half a spacing."""
    x, y = np.meshgrid(np.arange(5.0), np.arange(5.0), indexing="ij")
    front = np.stack([x.ravel(), y.ravel(), np.zeros(25)], axis=1)
    points = np.concatenate([front, front + np.array([0.5, 0.5, -8.0])])
    everything, rear = np.ones(50), np.arange(50) >= 25
    for i in range(25):
        near = points[i] + [0.2, 0.1, 0]
        assert picking.of_points(points, everything, aimed(near + np.array([0, 0, 10]), near), 1.0)["point"] == i
    # Past hidden points the ray goes on to those behind, unless a surface is before these.
    behind = picking.of_points(points, rear, aimed([2.4, 2.4, 10], [2.4, 2.4, 0]), 1.0)
    assert behind["point"] == 25 + 2 * 5 + 2 and behind["depth"] == pytest.approx(18)
    assert picking.of_points(points, rear, aimed([2, 2, 10], [2, 2, 0]), 1.0, before=10) is None


def test_points_are_met_within_a_spacing_or_some_pixels(picking):
    """The slope is what a few pixels are at a distance of one."""
    for slope, spacing, met in ((0, 0.5, False), (0, 1.1, True), (0.05, 0.5, False), (0.11, 0.5, True)):
        found = picking.of_points([[0.0, 0, 0]], [1], aimed([1, 0, 10], [1, 0, 0], slope), spacing)
        assert (found is not None) == met
    assert picking.of_points([[0.0, 0, 0]], [1], aimed([0, 0, 10], [0, 0, 11]), 1.0) is None
