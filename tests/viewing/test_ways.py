"""Several maps between two shapes in one scene: what they are called, and which one exchanges left and right."""

from dataclasses import replace

import numpy as np
import pytest
from viewing_tools import Parts, arrays_of

from homolog.matching import Match, exchanges_sides
from homolog.shapes import Shape, rotation_about
from homolog.viewing import page_of, scene_of, scene_of_all


@pytest.fixture(scope="module")
def mirrored_maps(make):
    """A shape that is its own mirror image, matched rightly, left for right, and rightly in another pose."""
    blob = make.blob(2)
    half = blob.points + np.array([2.5, 0, 0])  # of two halves, so that the partner of each point is known
    n = len(half)
    other = Shape(np.concatenate([half, half * [-1, 1, 1]]), np.concatenate([blob.faces, blob.faces[:, ::-1] + n]))
    partner = np.roll(np.arange(2 * n), n)

    def match(found, degrees, misfit):
        report = {
            "orientation": {
                "source": {"rotation": rotation_about(1, degrees).tolist(), "degrees": degrees},
                "target": {"rotation": np.eye(3).tolist(), "degrees": 0.0},
                "misfit": misfit,
            }
        }
        return Match(other, other, found, found, report=report)

    return [match(np.arange(2 * n), 90, 0.1), match(partner, 270, 0.2), match(np.arange(2 * n), 180, 0.3)]


def test_a_map_that_exchanges_left_and_right_is_called_so(mirrored_maps):
    scene = scene_of_all(mirrored_maps)
    assert [each.name for each in (scene, *scene.alternatives)] == [
        "1: the likeliest",
        "2: left and right exchanged, turned by 180\N{DEGREE SIGN}",
        "3: turned by 90\N{DEGREE SIGN}",
    ]
    assert scene.note == "Misfit 0.100, mean confidence 1.00."
    assert "Misfit 0.200" in scene.alternatives[0].note and "alternative-2" in scene.alternatives[0].note
    assert "--alternatives 3" in scene.guide.command


def test_left_and_right_of_bodies(demo):
    """The true map of the demo bodies keeps them, that to mirrored points does not, and so with clouds."""
    points = np.arange(len(demo.amber_points))
    source, target = Shape(demo.amber.points[demo.amber_points]), Shape(demo.boris.points[demo.boris_points])
    reflected = replace(target, points=target.points * [-1, 1, 1])
    assert not exchanges_sides(Match(source, target, points, points))
    assert exchanges_sides(Match(source, reflected, points, points))
    # What one expects where one of them is a mirror image is no exchange.
    assert not exchanges_sides(Match(source, reflected, points, points, report={"options": {"mirror": "target"}}))


def test_without_counterparts_or_orientation(known):
    nowhere = replace(known, source_to_target=np.full(162, -1))
    assert not exchanges_sides(nowhere)
    assert [each.name for each in scene_of_all([known, nowhere]).alternatives] == ["2: another way round"]


def test_one_map_is_a_scene_as_ever(known):
    scene = scene_of_all([known])
    assert scene.alternatives == () and scene.name == "" and page_of(scene) == page_of(scene_of(known))


def test_the_page_holds_all_maps(mirrored_maps):
    told, read = arrays_of(Parts(page_of(scene_of_all(mirrored_maps))))
    assert len(told["maps"]) == 3
    for match, written in zip(mirrored_maps, told["maps"], strict=True):
        np.testing.assert_array_equal(read(written["sides"][0]["counterpart"]), match.source_to_target)
        np.testing.assert_array_equal(read(written["sides"][1]["back"]), np.arange(324))


def test_the_more_maps_the_fewer_points_of_large_shapes(mirrored_maps, monkeypatch):
    monkeypatch.setattr("homolog.viewing.page._MOST_POINTS", 330)
    alone, all_of_them = (
        arrays_of(Parts(page_of(scene_of_all(maps))))[0] for maps in (mirrored_maps[:1], mirrored_maps)
    )
    assert alone["bodies"][0]["index"]["length"] == 324 and 40 < all_of_them["bodies"][0]["index"]["length"] <= 110


def test_layers_of_each_map(mirrored_maps):
    from homolog.viewing import error_layer

    errors = [error_layer(dict.fromkeys(("source", "target"), np.full(324, number)), "m") for number in (1.0, 2.0, 3.0)]
    scene = scene_of_all(mirrored_maps, [[layer] for layer in errors])
    assert [each.layers[2] for each in (scene, *scene.alternatives)] == errors
