"""Shapes are matched whichever way round they are."""

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

import homolog
from homolog.core.errors import ArgumentError
from homolog.datasets import demo_folder
from homolog.maps import rotation_angle
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


def odd(seed):
    return Rotation.random(random_state=seed).as_matrix()


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


def test_pre_aligned_shapes_stay_as_they_lie():
    source, target = (turned(shape, odd(4)) for shape in homolog.demo_shapes())
    matcher = homolog.Matcher.from_weights("people")
    for options, expected in (({}, True), ({"pre_aligned": True}, False)):
        pair, _ = matcher.pair(source, target, partial="target", **options)
        assert (float(rotation_angle(pair.source.rotation)) > 1) is expected
        assert torch.equal(pair.target.rotation, torch.eye(3))


def test_the_pretrained_weights_stand_bodies_up_in_any_pose_of_the_whole():
    matcher = homolog.Matcher.from_weights("people")
    for seed, shape in enumerate((*homolog.demo_shapes(), *(shape.as_cloud() for shape in homolog.demo_shapes()))):
        found = matcher.preprocess(turned(shape, odd(seed)))
        upright = found.rotation.double() @ torch.from_numpy(odd(seed))
        assert float(rotation_angle(upright)) < 30
        assert torch.equal(matcher.preprocess(shape).rotation, torch.eye(3))  # it stands upright already


def test_only_known_words_are_taken():
    with pytest.raises(ArgumentError, match="orient is 'maybe'"):
        PairOptions(orient="maybe")


@pytest.mark.parametrize("method", ["registration", "axiomatic"])
def test_a_mirror_image_is_named_and_can_be_reflected(blobs, method):
    shape = blobs.source
    image = turned(mirrored(shape), odd(7))
    found = homolog.match(shape, image, method=method)
    assert any("mirror image" in warning for warning in found.warnings)
    told = homolog.match(shape, image, method=method, mirror="target")
    assert not any("mirror image" in warning for warning in told.warnings)
    assert (told.source_to_target == np.arange(shape.n_points)).mean() > 0.9


@pytest.mark.parametrize("seed", range(3))
def test_a_body_is_no_mirror_image_of_itself_or_another(seed):
    source, target = homolog.demo_shapes()
    for other in (source, target):
        found = homolog.match(source, turned(other, odd(seed)), method="registration")
        assert not any("mirror image" in warning for warning in found.warnings)


def test_alternatives_lead_to_other_maps(blobs):
    matcher = homolog.Matcher(settings=homolog.MatcherSettings(method="registration"))
    pair, _ = matcher.pair(turned(blobs.source, odd(3)), blobs.source)
    best, second, third = matcher.alternatives(pair, 3)
    np.testing.assert_array_equal(best.source_to_target, matcher.find(pair).source_to_target)
    assert (best.source_to_target != second.source_to_target).mean() > 0.5
    misfits = [match.report["orientation"]["misfit"] for match in (best, second, third)]
    assert misfits == sorted(misfits)
