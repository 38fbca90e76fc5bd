"""The scene of a match, against the match it shows."""

from dataclasses import replace

import numpy as np
import pytest

from homolog.matching import Match, matched_colours
from homolog.shapes import Shape, upright_rotation
from homolog.viewing import scene_of

SIDES = ("source", "target")


def test_shapes_keep_their_proportions(known):
    scene = scene_of(known)
    source, target = (scene.bodies[side] for side in SIDES)
    for body, shape in ((source, known.source), (target, known.target)):
        low, high = body.points.min(axis=0), body.points.max(axis=0)
        np.testing.assert_allclose(low + high, 0, atol=1e-12)
        spread = np.ptp(shape.points, axis=0)
        np.testing.assert_allclose((high - low) / spread, ((high - low) / spread)[0])
    radii = [np.linalg.norm(scene.bodies[side].points, axis=1).max() for side in SIDES]
    assert max(radii) == pytest.approx(1)
    assert np.ptp(target.points[:, 0]) == pytest.approx(np.ptp(source.points[:, 0]))  # in the same unit
    assert scene.title == "a blob.off \N{RIGHTWARDS ARROW} other.off"


def resized(known: Match, factor, **options):
    target = Shape(known.target.points * factor, known.target.faces)
    return scene_of(replace(known, target=target, report={"options": options}))


def test_sizes(known):
    """Other units are told by sizes that cannot be meant; a part's are known."""

    def ratio(scene):
        return np.ptp(scene.bodies["target"].points[:, 0]) / np.ptp(scene.bodies["source"].points[:, 0])

    assert ratio(resized(known, 2.0)) == pytest.approx(2)
    assert 0.5 < ratio(resized(known, 1000.0)) < 2
    assert ratio(resized(known, 0.1, partial="target")) == pytest.approx(0.1)
    assert ratio(resized(known, 100.0, partial="target", partial_scale=0.001)) == pytest.approx(0.1)


def test_shapes_that_lie_are_stood_upright(known):
    lying = Shape(known.target.points @ upright_rotation("z"), known.target.faces)
    report = known.report | {"options": {"source_up": "y", "target_up": "z"}}
    scene = scene_of(replace(known, target=lying, report=report))
    np.testing.assert_allclose(scene.bodies["target"].points, scene_of(known).bodies["target"].points, atol=1e-12)


def test_counterparts_and_confidences_are_those_of_the_match(known):
    bodies, found = scene_of(known).bodies, known
    assert bodies["source"].counterpart is found.source_to_target
    assert bodies["source"].confidence is found.source_confidence
    assert bodies["target"].counterpart is found.target_to_source
    assert bodies["target"].confidence is found.target_confidence
    assert scene_of(known).method == "axiomatic"


def test_the_first_colours_are_those_of_the_correspondence(known):
    layer = scene_of(known).layers[0]
    assert layer.name == "Match"
    for side, expected in zip(SIDES, matched_colours(known), strict=True):
        np.testing.assert_array_equal(layer.colours[side], expected)


def test_spacing(make, known):
    grid = make.grid(20)
    scene = scene_of(Match(grid, grid, np.arange(grid.n_points), np.arange(grid.n_points)))
    assert scene.bodies["source"].spacing == pytest.approx(np.sqrt(2) / 19)
