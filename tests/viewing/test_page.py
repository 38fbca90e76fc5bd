"""The self-contained page: what it holds, and that it asks for nothing."""

import base64
import re
import zlib
from dataclasses import replace

import numpy as np
import pytest
from viewing_tools import Parts, arrays_of

from homolog.matching import Match
from homolog.shapes import Shape
from homolog.viewing import page_of, scene_of
from homolog.viewing.page import PackedArrays


def test_it_holds_the_scene(known):
    scene = scene_of(known)
    parts = Parts(page_of(scene))
    told, read = arrays_of(parts)
    assert parts.title == scene.title
    assert told["method"] == "axiomatic"
    for side, written in zip(("source", "target"), told["bodies"], strict=True):
        body = scene.bodies[side]
        assert written["title"] == body.title
        np.testing.assert_allclose(read(written["points"]).reshape(-1, 3), body.points, atol=1e-6)
        np.testing.assert_array_equal(read(written["faces"]).reshape(-1, 3), body.faces)
        np.testing.assert_array_equal(read(written["counterpart"]), body.counterpart)
        back = scene.bodies["target" if side == "source" else "source"].counterpart[body.counterpart]
        np.testing.assert_array_equal(read(written["back"]), back)
        np.testing.assert_array_equal(read(written["index"]), np.arange(len(body.points)))
        np.testing.assert_array_equal(np.sort(read(written["rank"])), np.arange(len(body.points)))
        assert written["total"] == len(body.points) and written["spacing"] == body.spacing
        np.testing.assert_allclose(read(written["confidence"]), body.confidence, atol=1e-6)
    assert [layer["name"] for layer in told["layers"]] == ["Match", "Confidence"]
    for layer, written in zip(scene.layers, told["layers"], strict=True):
        for number, side in enumerate(("source", "target")):
            np.testing.assert_array_equal(read(written["colours"][number]).reshape(-1, 3), layer.colours[side])
    assert told["layers"][0]["ramp"] is None and told["layers"][0]["values"] is None
    np.testing.assert_allclose(read(told["layers"][1]["values"][1]), 0.5)


def test_of_a_large_shape_some_points_are_shown(known, monkeypatch):
    """With all that a click on them tells, by the numbers of the files; a small one beside it is whole."""
    monkeypatch.setattr("homolog.viewing.page._MOST_POINTS", 60)
    half = np.flatnonzero(known.target.points[:, 0] < 0)[:50]  # of the target, so that it is small enough
    few = Shape(known.target.points[half], None)
    place = np.full(known.target.n_points, -1)
    place[half] = np.arange(len(half))
    result = replace(
        known,
        target=few,
        source_to_target=np.where(known.source_to_target < 0, -1, place[known.source_to_target]),
        target_to_source=known.target_to_source[half],
        target_confidence=known.target_confidence[half],
    )
    scene = scene_of(result)
    told, read = arrays_of(Parts(page_of(scene)))
    source, target = told["bodies"]
    index = read(source["index"])
    assert 30 < len(index) <= 60 and source["total"] == known.source.n_points
    body = scene.bodies["source"]
    np.testing.assert_allclose(read(source["points"]).reshape(-1, 3), body.points[index], atol=1e-6)
    np.testing.assert_array_equal(read(source["counterpart"]), result.source_to_target[index])
    assert source["place"] is None  # all of the target's points are there
    np.testing.assert_array_equal(read(target["index"]), np.arange(50))
    np.testing.assert_allclose(
        read(target["place"]).reshape(-1, 3), body.points[read(target["counterpart"])], atol=1e-6
    )
    np.testing.assert_array_equal(read(target["back"]), result.source_to_target[result.target_to_source])
    for layer, written in zip(scene.layers, told["layers"], strict=True):
        np.testing.assert_array_equal(read(written["colours"][0]).reshape(-1, 3), layer.colours["source"][index])
    faces = read(source["faces"]).reshape(-1, 3)
    assert 0 < len(faces) < len(known.source.faces) and faces.max() < len(index)


@pytest.mark.slow
def test_a_match_of_a_million_points_is_a_page_that_can_be_sent(make):
    grid = make.grid(1000)
    everything = np.arange(grid.n_points)
    result = Match(grid, grid.as_cloud(), everything, everything, method="axiomatic")
    page = page_of(scene_of(result))
    assert len(page) < 20e6
    told, read = arrays_of(Parts(page))
    for body in told["bodies"]:
        index = read(body["index"])
        assert 80_000 < len(index) <= 100_000 and body["total"] == 1_000_000
        np.testing.assert_array_equal(read(body["counterpart"]), index)
        np.testing.assert_allclose(body["spacing"], np.sqrt(2) / 999 * np.sqrt(1_000_000 / len(index)), rtol=0.5)
    assert 150_000 < told["bodies"][0]["faces"]["length"] / 3 <= 220_000


def test_a_cloud_has_no_faces(known_clouds):
    told, _ = arrays_of(Parts(page_of(scene_of(known_clouds))))
    assert [body["faces"] for body in told["bodies"]] == [None, None]


def test_it_refers_to_nothing(known):
    page = page_of(scene_of(known))
    parts = Parts(page)
    for tag, attributes in parts.elements:
        assert not {"src", "href", "srcset", "action", "data"} & attributes.keys(), tag
        assert tag not in ("link", "iframe", "object", "embed", "img", "base")
    assert re.findall(r"(?:https?:)?//[\w-]+\.\w+|@import|url\(|\bfetch\(|XMLHttpRequest|\bimport\(", page) == []
    policies = [a["content"] for _, a in parts.elements if a.get("http-equiv") == "Content-Security-Policy"]
    assert len(policies) == 1 and policies[0].startswith("default-src 'none';")


@pytest.mark.parametrize(
    "name", ["</script><script>alert(1)</script>", "<!--<script>.off", "@arrays@ & <b>.off", "\N{SNOWMAN}.ply"]
)
def test_names_of_files_stay_names(known, name):
    """Whatever they hold, also what looks like a place to be filled in."""
    known.report["inputs"]["source"]["file"] = name.replace("/", "\N{DIVISION SLASH}")
    parts = Parts(page_of(scene_of(known)))
    assert len([tag for tag, _ in parts.elements if tag == "script"]) == 3
    assert "<" not in parts.scripts["scene"]  # neither ends the script nor begins a comment in it
    told, _ = arrays_of(parts)
    assert told["bodies"][0]["title"] == name.replace("/", "\N{DIVISION SLASH}")
    assert parts.title.startswith(told["bodies"][0]["title"])


def test_arrays_begin_where_a_browser_can_read_them():
    """A view of four-byte numbers must begin at a multiple of four, or the browser refuses to make it."""
    arrays = PackedArrays()
    arrays.add(np.arange(3), "uint8")
    place = arrays.add(np.array([0.5, 2.0]), "float32")
    block = zlib.decompress(base64.b64decode(arrays.packed()))
    assert place["begin"] % 4 == 0
    assert np.frombuffer(block, "<f4", 2, place["begin"]).tolist() == [0.5, 2.0]


def test_the_same_match_gives_the_same_bytes(known):
    assert page_of(scene_of(known)) == page_of(scene_of(known))
