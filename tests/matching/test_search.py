"""Shapes are matched whichever way round they are."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

import homolog
from homolog.core.errors import ArgumentError
from homolog.core.progress import Timings
from homolog.datasets import demo_folder
from homolog.features import Orientation
from homolog.maps import rotation_angle
from homolog.matching import low_confidence_warnings, orientation_warnings, search
from homolog.matching.mirror import mirror_warnings
from homolog.matching.search import orient
from homolog.pairs import PairOptions
from homolog.shapes import Shape, mirrored, rotation_about


def turned(shape, rotation):
    return Shape(shape.points @ np.asarray(rotation).T, shape.faces, name=shape.name)


def error(match):
    """Mean distance x100 on the demo source between true points and where they are mapped, in units of sqrt(area)."""
    folder = demo_folder()
    (source, target) = folder.names[:2]
    on_source, on_target = (folder.template_correspondence(name) for name in (source, target))
    points = homolog.demo_shapes()[0].points
    away = points[match.target_to_source[on_target]] - points[on_source]
    return 100 * np.linalg.norm(away, axis=1).mean() / homolog.geometry.surface_area(homolog.demo_shapes()[0]) ** 0.5


@pytest.fixture(scope="module")
def people():
    """The matcher with the weights for people, and both bodies as it matches them."""
    matcher = homolog.Matcher.from_weights("people")
    return matcher, matcher.pair(*homolog.demo_shapes())[0]


def odd(seed):
    return Rotation.random(random_state=seed).as_matrix()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_the_axiomatic_method_finds_the_way_round(seed):
    source, target = homolog.demo_shapes()
    upright = error(homolog.match(source, target, method="axiomatic"))
    found = homolog.match(turned(source, odd(seed)), turned(target, odd(seed + 10)), method="axiomatic")
    assert error(found) < upright + 1
    trusted = homolog.match(turned(source, rotation_about(0, 180)), target, method="axiomatic", orient="given")
    assert error(trusted) > 10


def test_registration_begins_from_the_best_rotation(blobs):
    shape = blobs.source
    found = homolog.match(turned(shape, odd(3)), shape, method="registration")
    identity = np.arange(shape.n_points)
    assert (found.source_to_target == identity).mean() > 0.95
    reported = found.report["orientation"]
    recovered = torch.tensor(reported["source"]["rotation"]).double() @ torch.from_numpy(odd(3))
    assert float(rotation_angle(recovered)) < 5
    assert reported["target"] == {"rotation": np.eye(3).tolist(), "degrees": 0.0}
    assert not reported["ambiguous"] and reported["margin"] > 0


@pytest.mark.parametrize(("axis", "degrees"), [(0, 0), *product(range(3), (15, 25, 42))])
def test_a_copy_that_is_turned_a_little_is_turned_back_exactly(blobs, axis, degrees):
    """A smooth, nearly round one, along which closest points slide and stop."""
    shape = blobs.source
    found = homolog.match(turned(shape, rotation_about(axis, degrees)), shape, method="registration")
    assert (found.source_to_target == np.arange(shape.n_points)).all()


def test_small_turns_between_shapes_that_differ_are_left_to_registration(blobs):
    """Not to methods that do not look for them."""
    shape, other = blobs.source, Shape(blobs.source.points * np.array([1.6, 1, 0.7]), blobs.source.faces)
    turn = rotation_about(2, 20)
    degrees = {}
    for method in ("registration", "axiomatic"):
        found = homolog.match(turned(shape, turn), other, method=method)
        degrees[method] = found.report["orientation"]["source"]["degrees"]
    assert degrees["registration"] == 0 and 5 < degrees["axiomatic"] < 45


def test_indices_and_coordinates_stay_those_of_the_files(blobs):
    source = turned(blobs.source, odd(5))
    found = homolog.match(source, blobs.target, method="registration")
    np.testing.assert_array_equal(found.source.points, source.points)
    np.testing.assert_array_equal(found.target.points, blobs.target.points)


def test_a_shape_that_looks_alike_from_several_sides_is_said_to_be_ambiguous():
    box = trimesh.creation.box((1.0, 2.0, 0.5))
    source, target = (Shape(np.array(trimesh.sample.sample_surface(box, 1500, seed=seed)[0])) for seed in (0, 1))
    found = homolog.match(source, turned(target, rotation_about(1, 90)), method="registration")
    assert found.report["orientation"]["ambiguous"]
    assert any("ambiguous" in warning for warning in found.warnings)


def test_the_inverse_exchanges_the_rotations(blobs):
    found = homolog.match(turned(blobs.source, odd(3)), blobs.source, method="registration")
    inverse = found.inverse()
    assert inverse.report["orientation"]["target"] == found.report["orientation"]["source"]


def test_features_that_are_given_belong_to_the_pose_that_is_given(blobs):
    features = np.asarray(blobs.source.points), np.asarray(blobs.target.points)
    found = homolog.match(blobs.source, blobs.target, features=features)
    assert found.report["orientation"] is None


def test_pre_aligned_shapes_stay_as_they_lie(people):
    source, target = (turned(shape, odd(4)) for shape in homolog.demo_shapes())
    matcher, _ = people
    for options, expected in (({}, True), ({"pre_aligned": True}, False)):
        pair, _ = matcher.pair(source, target, partial="target", **options)
        assert (float(rotation_angle(pair.source.rotation)) > 1) is expected
        assert torch.equal(pair.target.rotation, torch.eye(3))


@pytest.mark.slow
def test_the_pretrained_weights_stand_bodies_up_in_any_pose_of_the_whole():
    matcher = homolog.Matcher.from_weights("people")
    for seed, shape in enumerate((*homolog.demo_shapes(), *(shape.as_cloud() for shape in homolog.demo_shapes()))):
        found = matcher.preprocess(turned(shape, odd(seed)))
        upright = found.rotation.double() @ torch.from_numpy(odd(seed))
        assert float(rotation_angle(upright)) < 30
        assert torch.equal(matcher.preprocess(shape).rotation, torch.eye(3))  # it stands upright already


@pytest.mark.parametrize("side", ["source", "target"])
def test_a_shape_that_features_do_not_know_in_the_pose_of_the_orienter_is_tried_in_others(people, side):
    """An orienter that is wrong by a quarter turn, and says that it knows one shape less well."""
    _, pair = people
    tilt = torch.from_numpy(rotation_about(0, -90)).float()
    wrong = getattr(pair, side).turned(tilt, pair.extractor)
    wrong = replace(wrong, orientations=(Orientation(tilt, misfit=0.09),))
    found = orient(replace(pair, **{side: wrong}))
    assert all(float(rotation_angle(shape.rotation)) < 1 for shape in (found.source, found.target))
    assert found.orientation.margin > 0.3 and not found.orientation.ambiguous
    for trusting in ({"doubtful_handedness": -1.0}, {"pose_margin": 10.0}):
        settings = replace(pair.settings, orientation=replace(pair.settings.orientation, **trusting))
        kept = orient(replace(pair, **{side: wrong}, settings=settings))
        assert float(rotation_angle(getattr(kept, side).rotation)) > 85


@pytest.mark.parametrize(("misfit", "facing", "overruled"), [(0.15, 0, True), (0.09, 0, False), (0.15, 180, False)])
def test_shapes_that_the_orienter_is_unsure_of_may_stand_alike(people, misfit, facing, overruled):
    """An orienter that takes a front for a back: it is overruled where it is unsure, and the files stand alike."""
    _, pair = people
    back, given = (torch.from_numpy(rotation_about(1, angle)).float() for angle in (180, facing))
    target = pair.target.turned(given, None)
    target = replace(target, rotation=torch.eye(3)).turned(back, pair.extractor)
    target = replace(target, orientations=(Orientation(back, misfit),))
    source = replace(pair.source, orientations=(Orientation(torch.eye(3), misfit=0.05),))
    found = orient(replace(pair, source=source, target=target))
    assert (float(rotation_angle(found.target.rotation)) < 1) is overruled
    assert torch.equal(found.source.rotation, torch.eye(3))


def test_the_best_of_the_preferred_comes_first_unless_another_is_clearly_better():
    likely, given, near = (search.Hypothesis(torch.eye(3), torch.eye(3), misfit) for misfit in (0.1, 0.3, 0.13))
    ranked = [likely, near, given]
    assert search._first(ranked, [given, near], 0.05) == [near, likely, given]
    assert search._first(ranked, [given, near], 0.02) == ranked
    assert search._first(ranked, [], 0.05) == ranked


def test_no_other_pose_is_tried_where_the_files_and_the_orienter_agree(people):
    """However doubtful the coarse map, and though any other pose would be taken."""
    _, pair = people
    assert all(torch.equal(shape.rotation, torch.eye(3)) for shape in (pair.source, pair.target))
    anything = replace(pair.settings.orientation, doubtful_handedness=1.0, sure_handedness=-1.0)
    found = orient(replace(pair, settings=replace(pair.settings, orientation=anything)))
    assert all(torch.equal(shape.rotation, torch.eye(3)) for shape in (found.source, found.target))


def test_only_known_words_are_taken():
    with pytest.raises(ArgumentError, match="orient is 'maybe'"):
        PairOptions(orient="maybe")


@pytest.mark.long
@pytest.mark.parametrize("method", ["registration", "axiomatic"])
def test_a_mirror_image_is_named_and_can_be_reflected(blobs, method):
    shape = blobs.source
    image = turned(mirrored(shape), odd(7))
    found = homolog.match(shape, image, method=method)
    assert any("mirror image" in warning for warning in found.warnings)
    told = homolog.match(shape, image, method=method, mirror="target")
    assert not any("mirror image" in warning for warning in told.warnings)
    assert (told.source_to_target == np.arange(shape.n_points)).mean() > 0.9


@pytest.mark.slow
def test_mirror_auto_reflects_a_mirror_image_and_nothing_else():
    shape, other = homolog.demo_shapes()
    found = homolog.match(turned(mirrored(shape), odd(7)), shape, mirror="auto")
    assert found.report["options"]["mirror"] == "source"
    assert not any("mirror image" in warning for warning in found.warnings)
    assert (found.source_to_target == np.arange(shape.n_points)).mean() > 0.9
    assert homolog.match(shape, other, mirror="auto").report["options"]["mirror"] is None


@pytest.mark.parametrize("count", [1, 3])
def test_mirror_auto_searches_once_and_finds_what_is_found_without(blobs, monkeypatch, count):
    shape, other = blobs.source, turned(blobs.target, odd(4))
    matcher = homolog.Matcher(settings=homolog.MatcherSettings(method="registration"))
    plain = matcher.alternatives(matcher.pair(shape, other)[0], count)
    searches, ranked = [], search._ranked
    monkeypatch.setattr(search, "_ranked", lambda pair, **words: [searches.append(pair), *ranked(pair, **words)][1:])
    found = matcher.alternatives(matcher.pair(shape, other, mirror="auto")[0], count)
    assert len(searches) == (1 if count == 1 else 2)  # further ways round are looked for on demand
    assert len(found) == len(plain)
    for one, same in zip(found, plain, strict=True):
        np.testing.assert_array_equal(one.source_to_target, same.source_to_target)
        np.testing.assert_array_equal(one.target_to_source, same.target_to_source)
        assert one.report["orientation"] == same.report["orientation"]


def test_whether_to_mirror_is_decided_before_shapes_are_preprocessed(people):
    matcher, pair = people
    with pytest.raises(ArgumentError, match="mirror is 'auto', but the shapes are preprocessed"):
        matcher.paired(pair.source, pair.target, PairOptions(mirror="auto"))


def test_a_mirror_image_is_named_in_a_pose_that_no_orienter_found(people):
    matcher, _ = people
    shape = homolog.demo_shapes()[0]
    pair, _ = matcher.pair(shape, mirrored(shape))
    assert mirror_warnings(pair)
    tilted = pair.target.turned(torch.from_numpy(rotation_about(0, 90)).float(), pair.extractor)
    assert mirror_warnings(replace(pair, target=tilted))


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_a_body_is_no_mirror_image_of_itself_or_another(seed):
    source, target = homolog.demo_shapes()
    matcher = homolog.Matcher(settings=homolog.MatcherSettings(method="registration"))
    for other in (source, target):
        pair, _ = matcher.pair(source, turned(other, odd(seed)))
        assert not mirror_warnings(orient(pair))


def test_alternatives_lead_to_other_maps(blobs):
    matcher = homolog.Matcher(settings=homolog.MatcherSettings(method="registration"))
    pair, _ = matcher.pair(turned(blobs.source, odd(3)), blobs.source)
    best, second, third = matcher.alternatives(pair, 3)
    np.testing.assert_array_equal(best.source_to_target, matcher.find(pair).source_to_target)
    assert (best.source_to_target != second.source_to_target).mean() > 0.5
    misfits = [match.report["orientation"]["misfit"] for match in (best, second, third)]
    assert misfits == sorted(misfits)


@pytest.mark.slow
def test_the_given_pose_holds_for_shapes_that_were_preprocessed_in_another_one():
    """Of shapes that their features' orienter has turned, and of those that it has left as they are."""
    matcher = homolog.Matcher.from_weights("people")
    source, target = homolog.demo_shapes()
    given = turned(source, rotation_about(0, 180)), target
    prepared = [matcher.preprocess(shape) for shape in given]
    assert float(rotation_angle(prepared[0].rotation)) > 60
    pair = matcher.paired(*prepared, PairOptions(orient="given"))
    expected, _ = matcher.pair(*given, orient="given")
    for shape, wanted in ((pair.source, expected.source), (pair.target, expected.target)):
        assert torch.equal(shape.rotation, torch.eye(3)) and not shape.orientations
        torch.testing.assert_close(shape.operators.points, wanted.operators.points, atol=1e-5, rtol=0)
        torch.testing.assert_close(shape.features, wanted.features, atol=1e-2, rtol=1e-2)
    found = matcher.find(pair)
    assert found.report["orientation"] is None
    assert (found.target_to_source == matcher.find(expected).target_to_source).mean() > 0.95
    assert error(found) > 5 > error(matcher.find(matcher.paired(*prepared)))


def test_pairs_of_preprocessed_shapes_have_no_options_that_these_lack(blobs):
    matcher = homolog.Matcher(settings=homolog.MatcherSettings(method="registration"))
    prepared = matcher.preprocess(blobs.source), matcher.preprocess(blobs.target, as_cloud=True, up="z")
    for options, said in (
        ({"as_cloud": "both"}, "as_cloud is 'both', but the source was preprocessed as a mesh; give as_cloud=True to"),
        ({"source_up": "z"}, "source_up is 'z', but the source was preprocessed with 'y' up; give up='z' to"),
        ({"target_up": "x"}, "target_up is 'x', but the target was preprocessed with 'z' up"),
    ):
        with pytest.raises(ArgumentError, match=said):
            matcher.paired(*prepared, PairOptions(**options))
    assert matcher.paired(*prepared, PairOptions(as_cloud="target", target_up="z")).target is prepared[1]
    with pytest.raises(ArgumentError, match="source is a Shape, but must be a preprocessed shape; make one with"):
        matcher.paired(blobs.source, blobs.target)


@pytest.mark.parametrize("weights", [None, "people"])
def test_each_alternative_is_made_once_with_warnings_and_a_margin_of_its_own(blobs, calls, weights):
    method = "auto" if weights else "registration"
    matcher = homolog.Matcher(
        weights and homolog.load_weights(weights), settings=homolog.MatcherSettings(method=method), device="cpu"
    )
    pair, _ = matcher.pair(turned(blobs.source, odd(3)), blobs.source)
    plain = matcher.match_pair(pair)
    made = calls(homolog.Matcher, "find")
    timings = [Timings() for _ in range(3)]
    with pytest.raises(ArgumentError, match="timings are 2, but must be 3, one for each of so many matches"):
        matcher.alternatives(pair, 3, timings=timings[:2])
    found = matcher.alternatives(pair, 3, timings=timings)
    assert len(made) == len(found) > 1
    np.testing.assert_array_equal(found[0].source_to_target, plain.source_to_target)
    assert [[step.name for step in each.finished] for each in timings[: len(found)]] == [["map"]] * len(found)
    told = [match.report["orientation"] for match in found]
    for number, orientation in enumerate(told):
        others = [other["misfit"] for other in told[:number] + told[number + 1 :]]
        assert orientation["runner_up"] <= min(others)
        assert orientation["margin"] == pytest.approx(orientation["runner_up"] - orientation["misfit"])
    for match in found:
        expected = (*orientation_warnings(match), *low_confidence_warnings(match))
        assert [warning for warning in match.warnings if "mirror" not in warning] == list(expected)
