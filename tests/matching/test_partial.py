"""Matching a partial shape with a full one: one scale, and no counterpart where there is none."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree

from homolog.core.errors import ArgumentError
from homolog.geometry import compute_operators, unit_frame
from homolog.maps import overlap
from homolog.matching import unit_warnings
from homolog.methods import FunctionMethod, Supports
from homolog.pairs import PairOptions, PointMaps
from homolog.shapes import Shape, repair

KINDS = [("mesh", None), ("cloud", "both")]


@dataclass(frozen=True)
class Cut:
    """A whole body, the part above a plane with its points in another order, and the truth between them."""

    whole: Shape
    part: Shape
    part_to_whole: np.ndarray
    kept: np.ndarray

    @property
    def whole_to_part(self):
        """For points cut away, the nearest one left: a matcher always answers something."""
        return KDTree(self.part.points).query(self.whole.points)[1]


@pytest.fixture(scope="module", params=[0.35, 0.6])
def cut(coarse_body, request):
    """Cut level: knees and chest, as shares of the height."""
    return cut_at(coarse_body(2400), request.param)


@pytest.fixture(scope="module", params=[0.35, 0.6])
def coarse_cut(coarse_body, request):
    """The same of fewer points, for what is about sizes and units alone."""
    return cut_at(coarse_body(800), request.param)


def cut_at(body, share):
    height = body.points[:, 1]
    level = height.min() + share * np.ptp(height)
    faces = body.faces[(height[body.faces] > level).all(axis=1)]
    inside = np.random.default_rng(0).permutation(np.unique(faces))
    place = np.full(body.n_points, -1)
    place[inside] = np.arange(len(inside))
    return Cut(body, Shape(body.points[inside], place[faces], name="part"), inside, place >= 0)


def told(truth):
    """A method that is told the true maps from the full shape (x) to the partial one (y)."""

    def maps(pair):
        assert pair.is_partial
        assert pair.x.operators.n_points == truth.whole.n_points
        return PointMaps(torch.from_numpy(truth.whole_to_part), torch.from_numpy(truth.part_to_whole))

    return FunctionMethod("told", maps, Supports(refinement=False))


def f1(found, truth):
    return 2 * np.sum(found & truth) / (np.sum(found) + np.sum(truth))


@pytest.mark.parametrize(("kind", "as_cloud"), KINDS)
@pytest.mark.parametrize("side", ["source", "target"])
def test_points_without_counterpart(build, cut, side, kind, as_cloud):
    matcher = build(told(cut))
    shapes = (cut.whole, cut.part) if side == "target" else (cut.part, cut.whole)
    found = matcher.match(*shapes, partial=side, as_cloud=as_cloud)
    found = found if side == "target" else found.inverse()
    matched = found.source_to_target >= 0
    assert f1(matched, cut.kept) >= 0.9
    np.testing.assert_array_equal(found.source_to_target[matched], cut.whole_to_part[matched])
    assert np.all(found.source_confidence[~matched] == 0)
    assert found.source_confidence[matched & cut.kept].mean() > 0.8
    np.testing.assert_array_equal(found.target_to_source, cut.part_to_whole)
    assert found.target_confidence.mean() > 0.8


def test_overlap_itself(cut):
    """The same without a matcher, on operators."""
    scale = unit_frame(cut.whole).scale
    whole, part = compute_operators(cut.whole), compute_operators(cut.part, scale=scale)
    found = overlap(whole, part, torch.from_numpy(cut.part_to_whole)).numpy()
    assert f1(found, cut.kept) >= 0.9
    assert f1(~found, ~cut.kept) >= 0.8


def lengths_of(build, method, **options):
    """The inner units of the source's and the target's operators in one match."""
    lengths = {}

    def spy(shape, **settings):
        operators = compute_operators(shape, **settings)
        lengths[shape.name] = operators.scale
        return operators

    build(method, operators=spy).match(*options.pop("shapes"), **options)
    return lengths


@pytest.mark.parametrize(("kind", "as_cloud"), KINDS)
@pytest.mark.parametrize("side", ["source", "target"])
def test_one_scale_the_whole_one(build, cut, side, kind, as_cloud):
    shapes = (cut.whole, cut.part) if side == "target" else (cut.part, cut.whole)
    lengths = lengths_of(build, "nearest-features", shapes=shapes, partial=side, as_cloud=as_cloud)
    assert lengths["part"] == lengths["body"] == unit_frame(cut.whole).scale


def test_each_its_own_scale_where_neither_is_partial(build, cut):
    lengths = lengths_of(build, "nearest-features", shapes=(cut.whole, cut.part))
    assert lengths == {"body": unit_frame(cut.whole).scale, "part": unit_frame(cut.part).scale}
    assert lengths["part"] < 0.95 * lengths["body"]


@pytest.mark.parametrize("method", ["functional-map", "nearest-features", "axiomatic"])
@pytest.mark.parametrize("as_cloud", [None, "both", "source", "target"])
def test_every_method_on_parts(build, blobs, method, as_cloud):
    """The part always has counterparts; the whole has -1 with confidence 0; the other way round is the mirror image."""
    height = blobs.target.points[:, 1]
    faces = blobs.target.faces[(height[blobs.target.faces] > -0.5).all(axis=1)]
    part = repair(Shape(blobs.target.points, faces)).shape
    found = build(method).match(blobs.source, part, partial="target", as_cloud=as_cloud)
    missing = found.source_to_target < 0
    assert 0 < missing.sum() < blobs.source.n_points
    assert np.all((found.source_confidence == 0) == missing)
    assert found.source_to_target.min() == -1
    assert found.source_to_target.max() < part.n_points
    assert found.target_to_source.min() >= 0
    assert found.target_to_source.max() < blobs.source.n_points
    for confidence in (found.source_confidence, found.target_confidence):
        assert np.isfinite(confidence).all()
        assert confidence.min() >= 0
        assert confidence.max() <= 1
    mirrored = {"source": "target", "target": "source"}.get(as_cloud, as_cloud)
    back = build(method).match(part, blobs.source, partial="source", as_cloud=mirrored)
    np.testing.assert_array_equal(back.source_to_target, found.target_to_source)
    np.testing.assert_array_equal(back.target_to_source, found.source_to_target)
    np.testing.assert_array_equal(back.source_confidence, found.target_confidence)
    np.testing.assert_array_equal(back.target_confidence, found.source_confidence)


def test_registration_knows_no_partial_shapes(build, blobs):
    matcher = build("registration", with_network=False)
    shapes = [matcher.preprocess(shape) for shape in (blobs.source, blobs.target)]
    for call in (
        lambda: matcher.match(blobs.source, blobs.target, partial="target"),
        lambda: matcher.find(matcher.paired(*shapes, PairOptions(partial="target"))),
    ):
        with pytest.raises(
            ArgumentError, match="partial is 'target', but the method 'registration' matches full shapes"
        ):
            call()


@pytest.mark.parametrize("method", ["functional-map", "nearest-features", "registration", "axiomatic"])
def test_whole_pairs_have_no_missing_points(build, blobs, method):
    found = build(method).match(blobs.source, blobs.target)
    assert found.source_to_target.min() >= 0
    assert found.target_to_source.min() >= 0


def multiplied(part, factor):
    return Shape(part.points * factor, part.faces)


def warned_of(build, cut, factor, **options):
    """What is said of the units of a part, its points multiplied, before anything is matched."""
    part = multiplied(cut.part, factor)
    return unit_warnings(build(told(cut)).pair(cut.whole, part, partial="target", **options)[0])


def told_units(build, cut, factor, as_cloud=None, **options):
    """What a match of the part, its points multiplied, warns of regarding units, and its maps."""
    part = multiplied(cut.part, factor)
    found = build(told(cut)).match(cut.whole, part, partial="target", as_cloud=as_cloud, **options)
    return [warning for warning in found.warnings if "units" in warning], found


@pytest.mark.parametrize(("kind", "as_cloud"), KINDS)
def test_a_part_in_other_units_is_named_and_scaled(build, coarse_cut, kind, as_cloud):
    """Its area and the whole one's, both in the units of the whole."""
    _, plain = told_units(build, coarse_cut, 1.0, as_cloud)
    for factor in (1000.0, 0.01):
        (warning,), _ = told_units(build, coarse_cut, factor, as_cloud)
        area = factor**2 * unit_frame(coarse_cut.part).scale ** 2
        whole = unit_frame(coarse_cut.whole).scale ** 2
        assert f"the partial shape's area is {area:.3g}, the full one's {whole:.3g}:" in warning
        assert "give partial_scale, by how much" in warning
        assert "\n" not in warning
        none, found = told_units(build, coarse_cut, factor, as_cloud, partial_scale=1 / factor)
        assert none == []
        np.testing.assert_array_equal(found.source_to_target >= 0, plain.source_to_target >= 0)
        np.testing.assert_array_equal(found.target_to_source, plain.target_to_source)


@pytest.mark.parametrize(
    ("share", "warned"), [(0.005, True), (0.02, False), (0.9, False), (1.1, False), (1.3, True), (2.0, True)]
)
def test_only_what_can_be_no_parts_area_is_told(build, coarse_cut, share, warned):
    """Parts may be nearly whole, and estimates of areas a tenth too large; a third more than the whole is none."""
    area, whole = (unit_frame(shape).scale ** 2 for shape in (coarse_cut.part, coarse_cut.whole))
    warnings = warned_of(build, coarse_cut, np.sqrt(share * whole / area))
    assert len(warnings) == warned
    assert all(("name the other shape" in warning) == (share > 1) for warning in warnings)


def test_a_raw_cloud_as_part_is_judged_too(build, coarse_cut):
    clouds = Cut(coarse_cut.whole.as_cloud(), coarse_cut.part.as_cloud(), coarse_cut.part_to_whole, coarse_cut.kept)
    assert warned_of(build, clouds, 1.0) == ()
    assert len(warned_of(build, clouds, 1000.0)) == 1
    assert warned_of(build, clouds, 1000.0, partial_scale=0.001) == ()


@pytest.mark.parametrize("partial_scale", [0, -2, float("nan"), float("inf"), "mm", None, True])
def test_part_scales_that_are_none(build, coarse_cut, partial_scale):
    with pytest.raises(ArgumentError, match=r"partial_scale is .*, but must be a number above 0, and finite"):
        build("nearest-features").match(
            coarse_cut.whole, coarse_cut.part, partial="target", partial_scale=partial_scale
        )


def positions(build, whole, part, **options):
    pair, _ = build("nearest-features").pair(whole, part, partial="target", **options)
    return pair.x.operators, pair.y.operators


@pytest.mark.parametrize(("kind", "as_cloud"), KINDS)
def test_a_pre_aligned_partial_shape_lies_on_the_full_one(build, cut, kind, as_cloud):
    """Also in units of its own, and turned upright; its features are those of the positions there."""
    points = cut.part.points[:, [0, 2, 1]] * [1, -1, 1]  # +z is up
    part = Shape(100 * points, cut.part.faces)
    options = {"as_cloud": as_cloud, "partial_scale": 0.01, "target_up": "z"}
    whole, placed = positions(build, cut.whole, part, pre_aligned=True, **options)
    torch.testing.assert_close(placed.points, whole.points[cut.part_to_whole], atol=1e-5, rtol=0)
    torch.testing.assert_close(placed.centre, 100 * whole.centre)
    whole, apart = positions(build, cut.whole, part, **options)
    assert apart.points.mean(dim=0).norm() < 1e-5
    matcher = build("nearest-features")
    prepared = [
        matcher.pair(cut.whole, part, partial="target", pre_aligned=way, **options)[0].y for way in (True, False)
    ]
    torch.testing.assert_close(prepared[0].features, matcher.preprocess.features(placed))
    assert (prepared[0].features - prepared[1].features).abs().max() > 1e-3


def test_pre_aligned_is_for_partial_shapes(build, cut):
    with pytest.raises(ArgumentError, match=r"pre_aligned is True, but neither shape is partial"):
        build("nearest-features").match(cut.whole, cut.part, pre_aligned=True)
    with pytest.raises(ArgumentError, match=r"pre_aligned is 'yes', but must be true or false"):
        build("nearest-features").match(cut.whole, cut.part, partial="target", pre_aligned="yes")


def test_a_part_scale_needs_a_part(build, cut):
    with pytest.raises(ArgumentError, match=r"partial_scale is 10.0, but neither shape is partial"):
        build("nearest-features").match(cut.whole, cut.part, partial_scale=10)
