"""A partial shape lies where its map contradicts itself least, though features of other places are as similar."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from homolog.core.errors import ArgumentError
from homolog.features import DiffusionNet, FeatureInfo
from homolog.matching import Matcher, align_parts, placing
from homolog.pairs import MatcherSettings, PairOptions, PlacedMapSettings, PlacementSettings
from homolog.shapes import Shape


class Placed(DiffusionNet):
    """Features of where points lie."""

    def forward(self, inputs, operators):
        del operators
        waves = torch.randn(3, 32, generator=torch.Generator().manual_seed(0))
        return torch.sin(3 * inputs @ waves)


class Misled(Placed):
    """Features of where points lie, that take those of a part to lie up to a tenth elsewhere."""

    def __init__(self, n_full):
        super().__init__()
        self.n_full = n_full

    def forward(self, inputs, operators):
        if len(inputs) != self.n_full:
            inputs = inputs + 0.15 * torch.sin(12 * inputs[:, [1, 2, 0]])
        return super().forward(inputs, operators)


@pytest.fixture(scope="module")
def side(coarse_body):
    """A body, the half of it to one side with something of the middle, and the indices of that in it."""
    body = coarse_body(2400)
    across = body.points[:, 0] - np.median(body.points[:, 0])
    faces = body.faces[(across[body.faces] > -0.02 * np.ptp(across)).all(axis=1)]
    kept = np.unique(faces)
    place = np.full(body.n_points, -1)
    place[kept] = np.arange(len(kept))
    return body, Shape(body.points[kept], place[faces], name="side"), kept


def matcher_of(placement, method="auto"):
    settings = MatcherSettings(placement=placement, method=method)
    return Matcher(Misled(1202), FeatureInfo(partial=True, upright=False), settings=settings)


@pytest.fixture(scope="module")
def turned(side):
    """The half, turned by 150 degrees about the vertical through the middle of the body."""
    body, part, _ = side
    middle = (body.points.min(axis=0) + body.points.max(axis=0)) / 2
    half = Rotation.from_euler("y", 150, degrees=True).as_matrix()
    return Shape((part.points - middle) @ half.T + middle, part.faces, name="turned")


def error(body, kept, match):
    found = match.target_to_source
    return np.linalg.norm(body.points[found] - body.points[kept], axis=1).mean() / np.ptp(body.points[:, 1])


@pytest.fixture(scope="module")
def quick():
    """A search that looks at few places, of which one is right."""
    return PlacementSettings(followed=12, mapped=2)


@pytest.fixture(scope="module")
def found(side, turned, quick):
    return matcher_of(quick).match(side[0], turned, partial="target", pre_aligned=True)


@pytest.mark.long
def test_the_map_tells_which_of_two_places_is_the_right_one(side, turned, found):
    body, _, kept = side
    by_features = matcher_of(None).match(body, turned, partial="target", pre_aligned=True)
    assert error(body, kept, by_features) > 0.05 and error(body, kept, found) < 0.01


@pytest.mark.long
def test_either_shape_may_be_the_part(side, turned, quick, found):
    back = matcher_of(quick).match(turned, side[0], partial="source", pre_aligned=True)
    np.testing.assert_array_equal(found.target_to_source, back.source_to_target)


def test_a_sure_map_is_kept_and_not_made_again(side, turned, monkeypatch):
    body, _, _ = side
    sure = matcher_of(PlacementSettings(meshes=PlacedMapSettings(sure=99.0)))
    pair, _ = sure.pair(body, turned, partial="target", pre_aligned=True)
    monkeypatch.setattr(placing, "_others", None)
    found = align_parts(pair)
    assert found.maps is not None and align_parts(found) is found
    plain = matcher_of(None).match(body, turned, partial="target", pre_aligned=True)
    np.testing.assert_array_equal(sure.match(body, turned, partial="target", pre_aligned=True).target_to_source,
                                  plain.target_to_source)  # fmt: skip


@pytest.mark.long
def test_a_pre_aligned_part_stays_where_it_was_given_unless_another_place_is_clearly_better(side, turned):
    body, _, _ = side
    there = {}
    for given in (0.0, 99.0):
        settings = PlacementSettings(followed=1, mapped=1, given=given, meshes=PlacedMapSettings(sure=-99.0))
        matcher = matcher_of(settings)
        there[given] = matcher.match(body, turned, partial="target", pre_aligned=True).target_to_source
    settings = MatcherSettings(alignment=None, placement=None)
    unmoved = Matcher(Misled(1202), FeatureInfo(partial=True, upright=False), settings=settings)
    as_given = unmoved.match(body, turned, partial="target", pre_aligned=True).target_to_source
    np.testing.assert_array_equal(there[99.0], as_given)
    assert (there[0.0] != as_given).any()


@pytest.mark.parametrize("method", ["own", "landmarks"])
def test_where_maps_do_not_tell_features_place_the_part(side, turned, method, monkeypatch):
    """Another's maps may be of another kind, and landmarks say where a part lies."""
    body, _, kept = side
    monkeypatch.setattr(placing, "_others", None)
    own = method == "own"
    unsure = PlacedMapSettings(sure=-99.0)
    matcher = matcher_of(PlacementSettings(meshes=unsure, clouds=unsure), (lambda *given: None) if own else "auto")
    options = PairOptions(
        partial="target", pre_aligned=True, landmarks=([int(kept[0])], [0]) if method == "landmarks" else None
    )
    pair, _ = matcher.pair(body, turned, options)
    assert align_parts(pair).maps is None


def test_maps_of_clouds_are_judged_by_measures_of_their_own(side, turned, monkeypatch):
    """Noise tears them as well, and a cloud has no triangles to turn over."""
    body, _, _ = side
    monkeypatch.setattr(placing, "_others", lambda *given: pytest.fail("other places were looked for"))
    sure = PlacementSettings(meshes=PlacedMapSettings(sure=-99.0), clouds=PlacedMapSettings(sure=99.0))
    options = PairOptions(partial="target", pre_aligned=True, as_cloud="target")
    pair, _ = matcher_of(sure).pair(body, turned, options)
    assert align_parts(pair).maps is not None
    whole, _ = matcher_of(sure).pair(body, turned, PairOptions(partial="target", pre_aligned=True))
    with pytest.raises(pytest.fail.Exception, match="other places"):
        align_parts(whole)


def test_loose_bits_make_no_map_doubtful(side, monkeypatch):
    """Their maps follow the surface that they lie near, as they do in the result."""
    body, part, kept = side
    corners = part.points[:: len(part.points) // 40, None] + 0.02 * np.ptp(part.points) * np.eye(3)
    points = np.concatenate([part.points, corners.reshape(-1, 3)])
    loose = np.arange(part.n_points, len(points)).reshape(-1, 3)
    bitten = Shape(points, np.concatenate([part.faces, loose]), name="bitten")
    monkeypatch.setattr(placing, "_others", None)
    matcher = Matcher(Placed(), FeatureInfo(partial=True, upright=False))
    found = matcher.match(body, bitten, partial="target", pre_aligned=True, clutter="keep").target_to_source
    away = np.linalg.norm(body.points[found[: len(kept)]] - body.points[kept], axis=1)
    assert away.mean() < 0.02 * np.ptp(body.points[:, 1])


def test_settings_are_checked():
    with pytest.raises(ArgumentError, match="mapped"):
        PlacementSettings(mapped=0)
