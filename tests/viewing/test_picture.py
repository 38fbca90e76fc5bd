"""The picture of a match, against the scene it shows."""

import colorsys
from dataclasses import replace

import numpy as np
import pytest

from homolog.core.errors import ArgumentError, MissingExtraError
from homolog.viewing import picture_of, scene_of, write_picture
from homolog.viewing.drawing import SAMPLES
from homolog.viewing.picture import _projected

WIDTH = 400
SIZE = (WIDTH // 2 * SAMPLES, WIDTH * SAMPLES)


@pytest.fixture(params=["meshes", "clouds"])
def scene(request, known, known_clouds):
    return scene_of(known if request.param == "meshes" else known_clouds)


def one_colour(scene, colour):
    layer = scene.layers[0]
    colours = {side: np.full_like(layer.colours[side], colour) for side in layer.colours}
    return replace(scene, layers=(replace(layer, colours=colours),))


def hue(colour):
    return colorsys.rgb_to_hsv(*(np.asarray(colour, float) / 255))[0]


def test_both_shapes_are_there_and_whole(scene):
    image = picture_of(scene, width=WIDTH)
    assert (image.shape, image.dtype) == ((WIDTH // 2, WIDTH, 3), np.uint8)
    drawn = (image < 250).any(axis=2)
    for half in np.split(drawn, 2, axis=1):
        assert half.mean() > 0.1
    for border in (image[:5], image[-5:], image[:, :5], image[:, -5:], image[:, WIDTH // 2 - 2 : WIDTH // 2 + 2]):
        assert (border == 255).all()


def test_a_wide_pair_is_not_cut(known):
    wide = replace(known, source=replace(known.source, points=known.source.points * [4, 1, 1]))
    drawn = (picture_of(scene_of(wide), width=WIDTH) < 250).any(axis=2)
    assert not drawn[:, :5].any() and not drawn[:, -5:].any() and drawn.any()


def test_colours_are_those_of_the_layer(scene):
    image = picture_of(one_colour(scene, (200, 60, 20)), width=WIDTH)
    dark = image[(image < 200).any(axis=2) & (image[..., 2] < 30)]
    assert len(dark) > 1000
    np.testing.assert_allclose([hue(pixel) for pixel in dark], hue((200, 60, 20)), atol=0.02)


def test_the_foremost_point_has_its_colour(known):
    scene = scene_of(known)
    image = picture_of(scene, width=WIDTH)
    places, _ = _projected(scene, SIZE)
    for side in ("source", "target"):
        front = int(places[side][:, 2].argmax())
        column, row = (places[side][front, :2] / SAMPLES).astype(int)
        expected = scene.layers[0].colours[side][front].astype(float)
        ratio = image[row, column] / expected
        assert ratio.min() > 0.5 and ratio.max() / ratio.min() < 1.15


def test_lines_join_counterparts(known):
    scene = one_colour(scene_of(known), (40, 80, 240))
    plain, lined = picture_of(scene, width=WIDTH), picture_of(scene, width=WIDTH, lines=1)
    places, _ = _projected(scene, SIZE)
    changed = np.argwhere((abs(plain.astype(int) - lined) > 20).any(axis=2))[:, ::-1]
    between = changed[(plain == 255).all(axis=2)[changed[:, 1], changed[:, 0]]] + 0.5
    assert len(between) > 20
    begin, end = changed[changed[:, 0].argmin()] + 0.5, changed[changed[:, 0].argmax()] + 0.5
    found = scene.bodies["source"].counterpart
    near = np.linalg.norm(places["source"][:, :2] / SAMPLES - begin, axis=1)
    points = np.flatnonzero((near < 5) & (found >= 0))
    ends = places["target"][found[points], :2] / SAMPLES
    assert np.linalg.norm(ends - end, axis=1).min() < 5


def test_the_same_bytes(scene, tmp_path):
    for name in ("a.png", "b.png"):
        write_picture(tmp_path / name, scene, width=200, lines=5)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_what_is_refused(known, tmp_path, monkeypatch):
    scene = scene_of(known)
    for wrong in ({"width": 50}, {"width": 10**6}, {"width": 200.5}, {"lines": -1}):
        with pytest.raises(ArgumentError, match=next(iter(wrong))):
            picture_of(scene, **wrong)
    with pytest.raises(ArgumentError, match=r"must end in \.png"):
        write_picture(tmp_path / "a.jpg", scene)
    monkeypatch.setitem(__import__("sys").modules, "PIL", None)
    with pytest.raises(MissingExtraError, match=r"homolog\[picture\]"):
        write_picture(tmp_path / "a.png", scene)
    assert list(tmp_path.iterdir()) == []
