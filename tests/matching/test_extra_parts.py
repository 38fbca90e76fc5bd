"""Parts that only one of two full shapes has get no counterpart."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

import homolog
from homolog.geometry import EXTRA_PART
from homolog.matching.extra_parts import extra_part_warnings
from homolog.shapes import Shape


def _with_ball(body: Shape, radius: float) -> tuple[Shape, np.ndarray]:
    """A body as a cloud that holds a ball in its left hand, and which points are the ball's."""
    unit = np.sqrt(homolog.geometry.surface_area(body))
    hand = body.points[body.points[:, 0].argmax()]
    middle = hand + 0.05 * unit * np.array([1.0, 0.0, 0.0])
    steps = np.arange(500) + 0.5
    heights, turns = 1 - 2 * steps / 500, np.pi * (1 + np.sqrt(5)) * steps
    around = np.sqrt(1 - heights**2)
    ball = middle + radius * unit * np.stack([around * np.cos(turns), heights, around * np.sin(turns)], axis=1)
    outside = np.linalg.norm(body.points - middle, axis=1) > radius * unit
    own = body.points[outside]
    near = KDTree(own).query(ball)[0] < 0.4 * radius * unit / np.sqrt(500 / (4 * np.pi))
    points = np.concatenate([own, ball[~near]])
    return Shape(points, name="with-ball"), np.arange(len(points)) >= len(own)


@pytest.fixture(scope="module")
def matched() -> dict[str, homolog.Match]:
    source, target = homolog.demo_shapes()
    held, _ = _with_ball(source, 0.09)
    matcher = homolog.Matcher.from_weights("people", device="cpu")
    clean = matcher.match(source.as_cloud(), target.as_cloud())
    return {
        "found": matcher.match(held, target.as_cloud()),
        "inverse": matcher.match(target.as_cloud(), held),
        "kept": matcher.match(held, target.as_cloud(), clutter="keep"),
        "clean": clean,
    }


@pytest.mark.long
def test_ball_in_a_hand_gets_no_counterpart_and_nothing_is_mapped_to_it(matched):
    _, ball = _with_ball(homolog.demo_shapes()[0], 0.09)
    for found, others in (
        (matched["found"].source_to_target, matched["found"].target_to_source),
        (matched["inverse"].target_to_source, matched["inverse"].source_to_target),
    ):
        lost = found < 0
        both = (lost & ball).sum()
        assert both / ball.sum() > 0.7 and both / lost.sum() > 0.9
        assert (others >= 0).all() and not lost[others].any()


@pytest.mark.long
def test_report_and_warning_say_what_was_left_out_and_how_to_keep_it(matched):
    match = matched["found"]
    count = int((match.source_to_target < 0).sum())
    (finding,) = (each for each in match.report["inputs"]["source"]["findings"] if each["rule"] == EXTRA_PART)
    assert finding["count"] == count and "clutter='keep'" in finding["action"]
    assert match.matched("source")["points_left_out"] == count
    assert any(f"the source seems to have a part that the other shape lacks: {count}" in w for w in match.warnings)
    assert any("the target seems to have a part" in warning for warning in match.inverse().warnings)


@pytest.mark.long
def test_everything_has_a_counterpart_where_clutter_is_kept_and_in_clean_pairs(matched):
    for name in ("kept", "clean"):
        assert (matched[name].source_to_target >= 0).all() and (matched[name].target_to_source >= 0).all()
        assert not extra_part_warnings(matched[name])


def test_warning_tells_which_shape_has_the_part():
    shape = Shape(np.eye(4)[:, :3])
    finding = {"rule": EXTRA_PART, "count": 7}
    report = {"inputs": {"source": {"findings": []}, "target": {"findings": [finding]}}}
    (warning,) = extra_part_warnings(homolog.Match(shape, shape, np.arange(4), np.arange(4), report=report))
    assert warning.startswith("the target seems to have a part that the other shape lacks: 7 points")
