"""Landmarks guide a match: truth is the permutation, or the symmetry, that the shapes are made with."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

import homolog
from homolog.core.errors import ArgumentError
from homolog.features import FeatureInfo
from homolog.geometry import compute_operators, distances_from
from homolog.matching import Match, Matcher
from homolog.matching.guidance import guided, landmark_misfit, meet_landmarks
from homolog.matching.search import orientations
from homolog.pairs import LandmarkPairs, MatcherSettings, PairOptions, PointMaps
from homolog.shapes import Shape

# The methods that need no weights.
METHODS = ["axiomatic", "registration"]


@pytest.fixture(scope="module")
def ellipsoid():
    """A body with three planes of symmetry, so that four ways round are as good as each other."""
    mesh = trimesh.creation.icosphere(subdivisions=3)
    return Shape(mesh.vertices * [1.0, 1.3, 1.7], mesh.faces, name="ellipsoid")


def turned_over(shape):
    """For each point of an ellipsoid the one half a turn about z away."""
    found = np.linalg.norm(shape.points[:, None] * [-1, -1, 1] - shape.points[None], axis=2)
    assert found.min(axis=1).max() < 1e-9
    return found.argmin(axis=1)


def off(match, wanted):
    """The mean distance between where target points are mapped and where they belong."""
    points = match.source.points
    return np.linalg.norm(points[match.target_to_source] - points[wanted], axis=1).mean()


def stretch(match, wanted_faces):
    """By how much the edges of the target are stretched at most, once they are mapped to the source."""
    ends = np.concatenate([wanted_faces[:, [0, 1]], wanted_faces[:, [1, 2]], wanted_faces[:, [2, 0]]])
    lengths = [
        np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
        for points in (match.source.points[match.target_to_source], match.target.points)
    ]
    return (lengths[0] / lengths[1]).max()


@pytest.mark.parametrize("method", METHODS)
def test_a_way_round_that_contradicts_them_loses(ellipsoid, method):
    over = turned_over(ellipsoid)
    at = np.argsort(ellipsoid.points @ [0.3, 0.5, 0.8])[[-1, 100, 300, 500]]
    found = homolog.match(ellipsoid, ellipsoid, method=method, landmarks=(at, over[at]))
    assert off(found, over) < 0.1
    assert off(homolog.match(ellipsoid, ellipsoid, method=method), over) > 1


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("modality", ["mm", "cm"])
def test_they_are_met_exactly_in_both_ways_without_a_tear(blobs, method, modality):
    source, target = blobs.of(modality if method == "registration" else "mm")
    at = np.array([3, 111, 222, 333, 444])
    # Some three spacings away from where they belong, along the surface.
    shifted = np.array(
        [
            np.argsort(np.linalg.norm(target.points - target.points[end], axis=1))[25]
            for end in blobs.source_to_target[at]
        ]
    )
    found = homolog.match(source, target, method=method, landmarks=(at, shifted))
    np.testing.assert_array_equal(found.source_to_target[at], shifted)
    np.testing.assert_array_equal(found.target_to_source[shifted], at)
    assert stretch(found, blobs.target.faces) < 8


def test_with_them_a_map_that_no_features_know_is_right(blobs):
    at = np.array([3, 111, 222, 333, 444])
    without = homolog.match(blobs.source, blobs.target, method="registration")
    found = homolog.match(blobs.source, blobs.target, method="registration", landmarks=(at, blobs.source_to_target[at]))
    assert off(found, blobs.target_to_source) < min(0.15, off(without, blobs.target_to_source))


def test_uncertain_ones_are_met_to_their_uncertainty(ellipsoid):
    """A shape against itself, with one landmark where it does not belong."""
    points, at = ellipsoid.points, np.array([111])
    far = np.argsort(np.linalg.norm(points - points[at], axis=1))[[60]]
    away = np.linalg.norm(points[far] - points[at], axis=1)[0]
    missed = []
    for uncertainty in (0.0, away / 2, 10 * away):
        pairs = LandmarkPairs(at, far, uncertainties=[uncertainty])
        found = homolog.match(ellipsoid, ellipsoid, method="axiomatic", orient="given", landmarks=pairs)
        missed.append(np.linalg.norm(points[found.source_to_target[at]] - points[far], axis=1)[0])
    spacing = 0.2
    assert missed[0] == 0
    assert missed[1] <= away / 2 + spacing
    assert missed[2] == pytest.approx(away, abs=spacing)


def test_without_them_the_stages_change_nothing(blobs):
    matcher = Matcher(settings=MatcherSettings(method="axiomatic"))
    pair, _ = matcher.pair(blobs.source, blobs.target)
    maps = PointMaps(torch.zeros(480, dtype=torch.int64), torch.zeros(560, dtype=torch.int64))
    assert guided(pair) is pair
    assert meet_landmarks(pair, maps) is maps
    assert matcher.find(pair).report["options"]["landmarks"] is None


def test_they_become_features_of_one_length(blobs):
    matcher = Matcher(settings=MatcherSettings(method="axiomatic"))
    at = np.array([3, 111])
    pair, _ = matcher.pair(blobs.source, blobs.target, landmarks=(at, blobs.source_to_target[at]))
    with_them = guided(pair)
    norms = [shape.channels.norm(dim=1) for shape in (with_them.x, with_them.y)]
    for norm in norms:
        torch.testing.assert_close(norm, norms[0][0].expand_as(norm))
    width = pair.x.features.shape[1]
    assert with_them.x.needed_features().shape[1] == width + 4
    torch.testing.assert_close(with_them.x.needed_features()[:, :width], pair.x.features)
    # At a landmark a channel is largest on both shapes.
    assert int(with_them.x.channels[:, 1].argmax()) == 111
    assert int(with_them.y.channels[:, 1].argmax()) == blobs.source_to_target[111]


def test_distances_along_a_sphere():
    mesh = trimesh.creation.icosphere(subdivisions=4)
    operators = compute_operators(Shape(mesh.vertices, mesh.faces))
    found = distances_from(operators, torch.tensor([0]))[:, 0].numpy() * operators.scale
    angles = np.arccos(np.clip(mesh.vertices @ mesh.vertices[0], -1, 1))
    assert (found >= angles - 1e-2).all()  # chords of short edges are a little shorter than arcs
    assert (found <= 1.25 * angles + 1e-6).all()


def test_coordinates_lead_to_the_nearest_points_that_are_matched(blobs):
    points = np.concatenate([blobs.source.points, [[0.0, 0.3, 0.0]]])  # no face uses the last one
    source = Shape(points, blobs.source.faces)
    at = np.array([3, 111, 222])
    by_place = (points[at] + 0.01, blobs.target.points[blobs.source_to_target[at]] - 0.01)
    found = homolog.match(source, blobs.target, method="axiomatic", landmarks=by_place)
    np.testing.assert_array_equal(found.source_to_target[at], blobs.source_to_target[at])


def test_what_a_shape_lacks_is_left_out_and_said(blobs):
    source = Shape(np.concatenate([blobs.source.points, [[0.0, 0.3, 0.0]]]), blobs.source.faces)
    at, ends = [3, 480, -1, 222], [*blobs.source_to_target[[3, 5, 5, 222]]]
    pairs = LandmarkPairs(at, ends, names=["chin", "unused", "absent", "crown"])
    found = homolog.match(source, blobs.target, method="axiomatic", landmarks=pairs)
    (said,) = [warning for warning in found.warnings if "landmarks" in warning]
    assert "'absent', 'unused' are left out" in said
    assert "2 pairs" in said
    assert found.source_to_target[3] == ends[0]


def test_anatomical_axes_of_files_are_those_of_the_shapes():
    pairs = LandmarkPairs([[1.0, 2, 3]], [[1.0, 2, 3]], axes=("RAS", "LPS"))
    assert pairs.on("source", "LPS") == ((-1, -2, 3),)
    assert pairs.on("source", "RAS") == ((1, 2, 3),)
    assert pairs.on("target", "LPS") == ((1, 2, 3),)


def test_a_part_is_guided_onto_its_whole(blobs):
    inside = blobs.target.points[:, 1] < np.quantile(blobs.target.points[:, 1], 0.6)
    faces = blobs.target.faces[inside[blobs.target.faces].all(axis=1)]
    part = Shape(blobs.target.points, faces)
    used = np.unique(faces)
    at = used[[10, 100, 200, 250]]
    found = homolog.match(
        blobs.source, part, method="axiomatic", partial="target", landmarks=(blobs.target_to_source[at], at)
    )
    np.testing.assert_array_equal(found.target_to_source[at], blobs.target_to_source[at])
    reached = found.source.points[found.target_to_source[used]]
    wanted = found.source.points[blobs.target_to_source[used]]
    assert np.linalg.norm(reached - wanted, axis=1).mean() < 0.25


@pytest.mark.parametrize("partial", ["source", "target"])
def test_source_and_target_keep_their_landmarks_whichever_is_the_part(blobs, partial):
    at = np.array([3, 111, 222])
    options = PairOptions(partial=partial, landmarks=(at, blobs.source_to_target[at]))
    pair, _ = Matcher(settings=MatcherSettings(method="axiomatic")).pair(blobs.source, blobs.target, options)
    of_source, of_target = (pair.guidance.x, pair.guidance.y)[:: -1 if partial == "source" else 1]
    np.testing.assert_array_equal(of_source, at)
    np.testing.assert_array_equal(of_target, blobs.source_to_target[at])


def test_the_misfit_is_how_far_a_map_misses_them(blobs):
    at = np.array([3, 111, 222])
    matcher = Matcher(settings=MatcherSettings(method="registration"))
    pair, _ = matcher.pair(blobs.source, blobs.target, landmarks=(at, blobs.source_to_target[at]))
    right = Match(blobs.source, blobs.target, blobs.source_to_target.copy(), blobs.target_to_source.copy())
    right.target_to_source[blobs.source_to_target[at]] = at
    assert landmark_misfit(pair, right) == 0
    wrong = replace(right, source_to_target=np.zeros(480, dtype=int))
    away = np.linalg.norm(blobs.target.points[0] - blobs.target.points[blobs.source_to_target[at]], axis=1)
    assert landmark_misfit(pair, wrong) == pytest.approx(away.sum() / 6 / pair.target.operators.scale)


def test_features_that_contradict_them_are_not_chosen(blobs):
    """Of positions as they are and of positions upside down, the landmarks tell which are right."""

    class Positions:
        def __init__(self, name, sign):
            self.info = FeatureInfo(name=name, near_isometric=False, n_eigenpairs=64)
            self.sign = sign

        def orienter(self, operators):
            return (homolog.features.Orientation(torch.eye(3), 0.2),)

        def __call__(self, operators):
            # Of the smaller shape, the source, some are taken from the other end.
            side = self.sign if operators.n_points == 480 else 1.0
            waves = torch.randn(3, 64, generator=torch.Generator().manual_seed(0))
            points = operators.points * torch.tensor([1.0, side, 1.0])
            return torch.cat([(points @ waves).sin(), (points @ waves).cos()], dim=1)

    at = np.array([3, 60, 200, 333, 444])
    extractors = [Positions("over", -1.0), Positions("upright", 1.0)]
    settings = MatcherSettings(method="nearest-features")
    pair, _ = Matcher(extractors, settings=settings).pair(
        blobs.source, blobs.target, PairOptions(orient="given", landmarks=(at, blobs.source_to_target[at]))
    )
    assert pair.extractor.info.name == "upright"


def test_three_that_do_not_lie_on_a_line_are_a_way_round(ellipsoid):
    over = turned_over(ellipsoid)
    at = np.argsort(ellipsoid.points @ [0.3, 0.5, 0.8])[[-1, 100, 300]]
    pair, _ = Matcher(settings=MatcherSettings(method="registration")).pair(
        ellipsoid, ellipsoid, landmarks=(at, over[at])
    )
    (turned,) = orientations(pair, 1)
    relative = turned.target.rotation.T @ turned.source.rotation
    torch.testing.assert_close(relative, torch.diag(torch.tensor([-1.0, -1, 1])), atol=1e-3, rtol=0)


@pytest.mark.parametrize(
    ("landmarks", "said"),
    [
        (([0], [999]), "the landmark '1' of the target, target, is point 999, but must be one of 0 to 559"),
        (([[99.0, 0, 0]], [0]), "the landmark '1' of the source is at (99, 0, 0)"),
        (([0, 1], [0]), "2 on the source and 1 on the target"),
        (([], []), "landmarks of the source have shape (0,)"),
        ((range(51), range(51)), "hold 51 pairs"),
        (([-1], [0]), "hold 0 pairs"),
        (([0.5], [0]), "indices of points, whole numbers (p,), or positions (p, 3)"),
        (([-2], [0]), "hold -2"),
        ("nose", "landmarks is 'nose', but must be LandmarkPairs"),
    ],
)
def test_what_cannot_be_used_is_refused(blobs, landmarks, said):
    with pytest.raises(ArgumentError) as refused:
        homolog.match(blobs.source, blobs.target, method="axiomatic", landmarks=landmarks)
    assert said in str(refused.value)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"weights": [0.0]}, "weights of landmarks is 0.0, but must be finite numbers above 0"),
        ({"uncertainties": [-1.0]}, "must be finite numbers from 0"),
        ({"names": ["a", "b"]}, "names of landmarks are 2, but must be one for each of the 1 pairs"),
    ],
)
def test_what_is_said_of_pairs_must_fit_them(more, said):
    with pytest.raises(ArgumentError, match="of landmarks") as refused:
        LandmarkPairs([0], [0], **more)
    assert said in str(refused.value)


def test_a_point_that_belongs_to_two_is_refused():
    """Two points that belong to one are not: a coarse mesh may have no more."""
    with pytest.raises(ArgumentError, match="'1' and '3' are one point of the source, but two of the target"):
        LandmarkPairs([4, 5, 4], [7, 8, 9])
    assert len(LandmarkPairs([4, 5, 4], [7, 8, 7])) == 3
    assert len(LandmarkPairs([4, 5], [7, 7])) == 2


def test_names_pair_them_and_those_on_one_shape_are_left_out():
    pairs = LandmarkPairs.by_name({"nose": 3, "ear": 8, "chin": 1}, {"chin": 4, "nose": 5, "tail": 6})
    assert (pairs.names, pairs.source, pairs.target) == (("nose", "chin"), (3, 1), (5, 4))
    assert pairs.left_out == ("ear", "tail")
    with pytest.raises(ArgumentError, match="no landmark has one name on both shapes"):
        LandmarkPairs.by_name({"nose": 3}, {"tail": 6})
