"""The scene of a match, against the match it shows."""

from dataclasses import replace

import numpy as np
import pytest

from homolog.matching import Match, matched_colours
from homolog.shapes import Shape, upright_rotation
from homolog.viewing import Ray, Scene, Shown, scene_of
from homolog.viewing.colours import HIDDEN

SIDES = ("source", "target")


def seen_from_front(scene: Scene, side, point):
    """A ray from far ahead to a point, where both shapes stand side by side."""
    body = scene.bodies[side]
    return Ray(body.points[point] + body.offset + [0, 0, 9.0], np.array([0.0, 0, -1]), 0.01)


def foremost(scene, side):
    return int(scene.bodies[side].points[:, 2].argmax())


def test_shapes_stand_side_by_side_in_their_own_proportions(known):
    scene = scene_of(known)
    source, target = (scene.bodies[side] for side in SIDES)
    for body, shape in ((source, known.source), (target, known.target)):
        low, high = body.points.min(axis=0), body.points.max(axis=0)
        np.testing.assert_allclose(low + high, 0, atol=1e-12)
        spread = np.ptp(shape.points, axis=0)
        np.testing.assert_allclose((high - low) / spread, ((high - low) / spread)[0])
    assert (source.points + source.offset)[:, 0].max() + 0.2 < (target.points + target.offset)[:, 0].min()
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
    report = known.report | {"options": {"up": {"source": "y", "target": "z"}}}
    scene = scene_of(replace(known, target=lying, report=report))
    np.testing.assert_allclose(scene.bodies["target"].points, scene_of(known).bodies["target"].points, atol=1e-12)


def test_a_click_marks_the_counterpart(known):
    scene = scene_of(known)
    for side, forth, back in (
        ("source", known.found.source_to_target, known.found.target_to_source),
        ("target", known.found.target_to_source, known.found.source_to_target),
    ):
        point = foremost(scene, side)
        for shown in (Shown(), Shown(surface=False)):
            mark = scene.pick(seen_from_front(scene, side, point), shown)
            assert (mark.side, mark.point, mark.counterpart) == (side, point, forth[point])
            assert mark.back == back[forth[point]] == point
            places = scene.places(mark)
            np.testing.assert_allclose(places[side], scene.bodies[side].points[point] + scene.bodies[side].offset)
            assert places.keys() == set(SIDES)
    assert scene.pick(Ray(np.array([0, 0, 9.0]), np.array([0, 0, -1.0])), Shown()) is None  # between the shapes


def test_the_nearer_shape_is_met(known):
    scene = scene_of(known)
    left = Ray(np.array([-9.0, 0, 0]), np.array([1.0, 0, 0]), 0.01)
    assert scene.pick(left, Shown()).side == "source"
    assert scene.pick(replace(left, origin=-left.origin, direction=-left.direction), Shown()).side == "target"


def test_a_point_without_a_counterpart(known):
    scene = scene_of(known)
    mark = scene.mark("source", 5)
    assert (mark.counterpart, mark.back, mark.confidence) == (None, None, 0)
    assert np.isnan(mark.values["Confidence"])
    assert scene.places(mark).keys() == {"source"}
    assert scene.told(mark) == [("source", "point 5"), ("target", "no counterpart")]


def test_what_is_told_of_a_mark(known):
    scene = scene_of(known)
    point = int(known.found.source_to_target[40])
    confidence = f"{known.found.source_confidence[40]:.2f}"
    expected = {
        "source": "point 40",
        "target": f"point {point}",
        "and back": "the same point",
        "confidence": confidence,
    }
    assert dict(scene.told(scene.mark("source", 40))) == expected


def test_clouds_are_clicked_as_well(known_clouds):
    scene = scene_of(known_clouds)
    for side in SIDES:
        point = foremost(scene, side)
        assert scene.pick(seen_from_front(scene, side, point), Shown()).point == point


def test_points_behind_a_surface_are_not_met(known):
    scene = scene_of(known)
    behind = int(scene.bodies["source"].points[:, 2].argmin())
    for surface in (True, False):
        mark = scene.pick(seen_from_front(scene, "source", behind), Shown(surface=surface))
        assert mark is None or scene.bodies["source"].points[mark.point, 2] > 0


def test_which_points_are_shown(known):
    body = scene_of(known).bodies["source"]
    n = len(body.points)
    assert body.mask(Shown(least_confidence=0.5)).tolist() == (known.found.source_confidence >= 0.5).tolist()
    assert body.mask(Shown(share=0.1)).all()  # a surface has all its points
    few, some, all_ = (body.mask(Shown(share=share, surface=False)) for share in (0.1, 0.5, 1.0))
    assert (few.sum(), some.sum(), all_.sum()) == (np.ceil(0.1 * n), np.ceil(0.5 * n), n)
    assert (few <= some).all()  # points appear, and none goes
    both = body.mask(Shown(0.5, 0.5, surface=False))
    assert both.tolist() == (some & (known.found.source_confidence >= 0.5)).tolist()


def test_hidden_points_are_not_met(known_clouds):
    scene = scene_of(known_clouds)
    body, point = scene.bodies["source"], foremost(scene, "source")
    ray = replace(seen_from_front(scene, "source", point), slope=0.0)
    hiding = Shown(least_confidence=float(np.nextafter(body.confidence[point], 2)))
    found = scene.pick(ray, hiding)
    assert found is None or found.point != point


def test_colours(known):
    scene = scene_of(known)
    layer = scene.layer("Match")
    assert scene.layers[0] is layer
    for side, expected in zip(SIDES, matched_colours(known.source, known.found), strict=True):
        np.testing.assert_array_equal(scene.colours(layer, side, Shown()), expected)
    pale = scene.colours(layer, "source", Shown(least_confidence=0.7))
    np.testing.assert_array_equal((pale == HIDDEN).all(axis=1), known.found.source_confidence < 0.7)


def test_spacing(make, known):
    grid = make.grid(20)
    scene = scene_of(replace(known, source=grid, target=grid, found=_identity(known, grid.n_points)))
    assert scene.bodies["source"].spacing == pytest.approx(np.sqrt(2) / 19)


def _identity(known, n):
    index, ones = np.arange(n), np.ones(n)
    return replace(
        known.found, source_to_target=index, target_to_source=index, source_confidence=ones, target_confidence=ones
    )
