"""Meshes in loose shells are matched by a surface around them, and no others."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

from homolog.core.errors import ShapeError
from homolog.evaluation import geodesic_errors
from homolog.geometry import Operators, Surface, compute_operators, surface_area
from homolog.geometry.proxy import Proxy
from homolog.geometry.surface import subdivided
from homolog.matching import Matcher
from homolog.pairs import MatcherSettings, Preprocessor, ProxySettings
from homolog.shapes import Shape, read_shape
from homolog.synthesis import add_shells

QUICK = ProxySettings(resolution=96, points=3000)


def no_operators(shape, *, settings, scale) -> Operators:
    """Those of the demo body, whatever the shape is: what is looked at here comes before."""
    raise ReachedError(shape)


class ReachedError(Exception):
    """Carries the shape that operators were to be computed of."""


def matched_shape(shape, **words):
    """The shape that operators are computed of."""
    with pytest.raises(ReachedError) as caught:
        Preprocessor(source=no_operators, proxies=QUICK)(shape, **words)
    return caught.value.args[0]


@pytest.fixture(scope="module")
def dressed(demo):
    return add_shells(demo.boris, seed=0)


@pytest.mark.slow
def test_a_body_in_pieces_with_coat_and_hair_is_matched_nearly_as_well_as_the_bare_one(demo, dressed):
    """Without a proxy the errors are above 12."""
    clean = np.full(demo.boris.n_points, -1)
    clean[demo.boris_points] = demo.amber_points
    matcher = Matcher.from_weights("people", device="cpu")
    found = matcher.match(demo.amber, dressed.shape)
    back = found.inverse()
    known = np.flatnonzero(np.where(dressed.full_index >= 0, clean[dressed.full_index], -1) >= 0)
    to_amber = geodesic_errors(demo.amber, clean[dressed.full_index[known]], found.target_to_source[known])
    assert 100 * to_amber.mean() < 2.11 + 0.7
    reached = found.source_to_target[demo.amber_points]
    place = KDTree(demo.boris.points).query(dressed.shape.points[reached])[1]
    assert 100 * geodesic_errors(demo.boris, demo.boris_points, place).mean() < 2.12 + 0.7
    assert (found.target_to_source >= 0).mean() > 0.99 and found.target_confidence.max() <= 1
    told = [each for each in found.report["inputs"]["target"]["findings"] if each["rule"] == "points of a proxy"]
    assert len(told) == 1 and "largest component" in told[0]["action"] and not found.warnings
    assert back.report["options"]["proxy"] == "auto"


@pytest.mark.long
def test_a_mesh_in_shells_has_a_proxy_and_can_do_without(dressed):
    around = matched_shape(dressed.shape)
    assert 2000 < around.n_points < 4000
    for words in ({"proxy": "never"}, {"partial": True}, {"as_cloud": True}):
        assert matched_shape(dressed.shape, **words).n_points > 8000


def test_a_well_behaved_shape_is_matched_itself_unless_a_proxy_is_asked_for(demo):
    assert matched_shape(demo.amber) is demo.amber
    assert matched_shape(demo.amber.as_cloud(), proxy="always").n_points == demo.amber.n_points
    assert 2000 < matched_shape(demo.amber, proxy="always").n_points < 4000


@pytest.mark.long
def test_two_bodies_apart_are_kept_as_they_are_and_it_is_said(demo):
    far = np.array([5.0, 0, 0])
    both = Shape(
        np.concatenate([demo.amber.points, demo.amber.points + far]),
        np.concatenate([demo.amber.faces, demo.amber.faces + demo.amber.n_points]),
        name="twins",
    )
    assert matched_shape(both).n_points == both.n_points
    found = Preprocessor(source=lambda *_, **__: compute_operators(demo.amber), proxies=QUICK)(both)
    told = [each for each in found.repaired.report.findings if each.rule == "points without a proxy"]
    assert len(told) == 1 and "shells lie apart" in told[0].action
    with pytest.raises(ShapeError, match=r"twins: one closed surface covers \d+ % of it"):
        Preprocessor(source=no_operators, proxies=QUICK)(both, proxy="always")


def test_faces_that_do_not_hang_together_have_a_proxy(demo):
    """Each triangle has points of its own, a hair's breadth from the others'."""
    corners = demo.amber.points[demo.amber.faces].reshape(-1, 3)
    soup = corners + np.random.default_rng(0).normal(scale=1e-5, size=corners.shape)
    found = matched_shape(Shape(soup, np.arange(len(soup)).reshape(-1, 3)))
    assert found.n_points < 4000
    assert KDTree(found.points).query(demo.amber.points)[0].max() < 0.05 * np.ptp(demo.amber.points)


@pytest.mark.long
def test_features_and_landmarks_are_those_of_the_file(demo, dressed):
    matcher = Matcher(settings=MatcherSettings(method="axiomatic", proxy=QUICK), device="cpu")
    pair, _ = matcher.pair(demo.amber, dressed.shape, landmarks=([0, 1], [5, 7000]))
    assert isinstance(pair.target.repaired, Proxy)
    at = pair.target.repaired.shape.points[pair.guidance.y.numpy()]
    unit = pair.target.operators.scale
    assert np.linalg.norm(at - dressed.shape.points[[5, 7000]], axis=1).max() < 0.06 * unit


def subdivided_twice(shape):
    surface = Surface(shape.points, shape.faces)
    for _ in range(2):
        surface = subdivided(surface)[0]
    return Shape(surface.vertices, surface.faces, name=shape.name)


@pytest.mark.slow
def test_large_shapes_are_matched_with_fewer_points(make):
    """Of a bent ball four times as fine: the identity comes back, smoothly, at all points."""
    fine = subdivided_twice(make.blob(3))
    settings = MatcherSettings(method="axiomatic", proxy=ProxySettings(largest=2000, points=1000))
    for one, other in ((fine, fine), (fine, fine.as_cloud()), (make.blob(3), fine)):
        found = Matcher(settings=settings, device="cpu").match(one, other, orient="given")
        away = np.linalg.norm(one.points[found.target_to_source] - other.points, axis=1)
        assert away.mean() < 0.05 * np.sqrt(surface_area(fine)) and (found.target_to_source >= 0).all()
        findings = found.report["inputs"]["target"]["findings"]
        assert [each["count"] < 1100 for each in findings if each["rule"] == "points of a proxy"] == [True]
    assert matched_shape(fine).n_points == fine.n_points


@pytest.mark.reference
@pytest.mark.slow
@pytest.mark.parametrize("name", ["FAUST_r", "SCAPE_r", "SMAL_r", "SHREC19_sample", "BONES"])
def test_no_shape_of_the_benchmarks_has_one(benchmark_set, name):
    folder = benchmark_set(name)
    for file in sorted(folder.rglob("*.off")) + sorted(folder.rglob("*.ply")):
        shape = read_shape(file)
        assert matched_shape(shape, clutter="keep").n_points >= 0.99 * shape.n_points, file
