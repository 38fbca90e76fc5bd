"""What every method promises, over meshes and clouds in any mix."""

import itertools

import numpy as np
import pytest

from homolog.geometry import compute_operators
from homolog.matching import Match
from homolog.shapes import Shape

METHODS = ("functional-map", "nearest-features", "registration", "axiomatic")
NEED_NO_WEIGHTS = ("registration", "axiomatic")
MODALITIES = ("mm", "cc", "mc", "cm")
CASES = list(itertools.product(METHODS, MODALITIES))
every_case = pytest.mark.parametrize(("method", "modality"), CASES)

ARRAYS = ("source_to_target", "target_to_source", "source_confidence", "target_confidence")


def match(matcher, source, target):
    """Looking for the way round takes most of the time; of two meshes it is."""
    both_meshes = source.faces is not None and target.faces is not None
    return matcher.match(source, target, orient="auto" if both_meshes else "given")


def share_equal(a, b):
    return np.mean(a == b)


def assert_equal_but_for_ties(found, plain, points):
    """Rounding decides between candidates that are nearly as good: few points, and then it is a neighbour."""
    assert share_equal(found, plain) > 0.96
    spacing = np.sqrt(4 * np.pi * points.std(axis=0).prod() ** (2 / 3) / len(points))
    assert np.linalg.norm(points[found] - points[plain], axis=1).mean() < 0.05 * spacing


def same_bits(a: Match, b: Match):
    return all(getattr(a, name).tobytes() == getattr(b, name).tobytes() for name in ARRAYS)


@pytest.fixture(scope="module")
def results(blobs, build):
    """Each case matched once."""
    return {case: match(build(case[0]), *blobs.of(case[1])) for case in CASES}


def test_blobs_have_known_counterparts(blobs):
    """The truth that other tests rely on: there and back lands on the point itself or right beside it."""
    cycle_error = blobs.source.points[blobs.target_to_source[blobs.source_to_target]]
    distances = np.linalg.norm(cycle_error - blobs.source.points, axis=1)
    assert np.median(distances) < 0.1
    assert distances.max() < 0.5


@every_case
def test_result_is_well_formed(results, blobs, method, modality):
    found = results[method, modality]
    sizes = blobs.source.n_points, blobs.target.n_points
    for indices, confidences, own, other in (
        (found.source_to_target, found.source_confidence, *sizes),
        (found.target_to_source, found.target_confidence, *sizes[::-1]),
    ):
        assert indices.shape == confidences.shape == (own,)
        assert indices.dtype == np.int64
        assert indices.min() >= 0
        assert indices.max() < other
        assert np.issubdtype(confidences.dtype, np.floating)
        assert np.isfinite(confidences).all()
        assert confidences.min() >= 0
        assert confidences.max() <= 1
        assert len(np.unique(indices)) > 50
    assert found.method == method
    # A network is given to every method; those that do not use it say so, and there is nothing else to warn of:
    left_aside = [warning for warning in found.warnings if "'blobs' are left aside" in warning]
    assert len(left_aside) == (method in ("registration", "axiomatic"))
    # Blobs are nearly balls, whose ways round closest points hardly tell apart.
    allowed = [warning for warning in found.warnings if method == "registration" and "is ambiguous" in warning]
    assert len(found.warnings) == len(left_aside) + len(allowed)


@every_case
def test_maps_are_near_the_truth(results, blobs, method, modality):
    """Sources and targets of very different counterparts cannot be told from chance; these can."""
    found = results[method, modality]
    forth = blobs.target.points[found.source_to_target] - blobs.target.points[blobs.source_to_target]
    back = blobs.source.points[found.target_to_source] - blobs.source.points[blobs.target_to_source]
    chance = np.linalg.norm(blobs.source.points - blobs.source.points[::-1], axis=1).mean()
    assert chance > 1.5
    assert np.linalg.norm(forth, axis=1).mean() < 0.35
    assert np.linalg.norm(back, axis=1).mean() < 0.35


@every_case
def test_permuted_copy(build, blobs, make, method, modality):
    order = np.random.default_rng(3).permutation(blobs.source.n_points)
    source = blobs.source if modality[0] == "m" else blobs.source.as_cloud()
    copy = make.relabelled(blobs.source, order)
    found = match(build(method), source, copy if modality[1] == "m" else copy.as_cloud())
    ends = order[found.source_to_target]
    starts = found.target_to_source
    distances = np.linalg.norm(source.points[ends] - source.points, axis=1)
    identity = share_equal(ends, np.arange(len(order))), share_equal(starts, order)
    if modality == "mm":
        assert min(identity) >= 0.99
        assert found.source_confidence.mean() > 0.95
    elif modality == "cc":
        assert min(identity) >= 0.95
    # Between a mesh and its own points the operators differ, which only training teaches the network to overlook.
    assert distances.mean() < (0.01 if modality in ("mm", "cc") else 0.25)


@every_case
def test_relabelling_the_points_relabels_the_maps(results, build, blobs, make, method, modality):
    rng = np.random.default_rng(4)
    source, target = blobs.of(modality)
    order_s, order_t = rng.permutation(source.n_points), rng.permutation(target.n_points)
    plain = results[method, modality]
    found = match(build(method), make.relabelled(source, order_s), make.relabelled(target, order_t))
    assert_equal_but_for_ties(order_t[found.source_to_target], plain.source_to_target[order_s], target.points)
    assert_equal_but_for_ties(order_s[found.target_to_source], plain.target_to_source[order_t], source.points)
    assert np.abs(found.source_confidence - plain.source_confidence[order_s]).mean() < 0.01
    assert np.abs(found.target_confidence - plain.target_confidence[order_t]).mean() < 0.01


@every_case
def test_place_and_unit_change_nothing(results, build, blobs, method, modality):
    source, target = blobs.of(modality)
    moved = Shape(source.points * 1000 + [50, -3000, 7], source.faces)
    shrunk = Shape(target.points / 256 - [1, 2, 3], target.faces)
    plain, found = results[method, modality], match(build(method), moved, shrunk)
    assert_equal_but_for_ties(found.source_to_target, plain.source_to_target, target.points)
    assert_equal_but_for_ties(found.target_to_source, plain.target_to_source, source.points)
    assert np.abs(found.source_confidence - plain.source_confidence).mean() < 0.01


@every_case
def test_twice_is_bit_equal_and_inputs_stay(results, build, blobs, method, modality, compute_anew, monkeypatch):
    """Once with operators from disk, once computed anew, from arrays nobody may write to."""
    compute_anew(monkeypatch)
    shapes = []
    for shape in blobs.of(modality):
        arrays = [None if array is None else array.copy() for array in (shape.points, shape.faces)]
        for array in arrays:
            if array is not None:
                array.flags.writeable = False
        shapes.append(Shape(*arrays))
    found = match(build(method, operators=compute_operators), *shapes)
    assert same_bits(found, results[method, modality])
    for shape, given in zip(shapes, blobs.of(modality), strict=True):
        assert shape.points.tobytes() == given.points.tobytes()
        assert shape.faces is given.faces or shape.faces.tobytes() == given.faces.tobytes()


@every_case
def test_swapping_the_shapes_swaps_the_maps(results, build, blobs, method, modality):
    """Exactly for functional maps; Sinkhorn's last step normalises one side, so nearly for features.

    Nearly for registration, too: it begins from samples, and each shape has its own.
    """
    source, target = blobs.of(modality)
    plain, found = results[method, modality], match(build(method), target, source).inverse()
    enough = 0.9 if method in ("nearest-features", "registration") else 0.995
    assert share_equal(found.source_to_target, plain.source_to_target) > enough
    assert share_equal(found.target_to_source, plain.target_to_source) > enough


@pytest.mark.parametrize("modality", MODALITIES)
@pytest.mark.parametrize("with_network", [True, False])
def test_auto_is_the_method_it_chooses(results, build, blobs, with_network, modality):
    expected = ("functional-map" if modality == "mm" else "nearest-features") if with_network else "axiomatic"
    found = match(build("auto", with_network=with_network), *blobs.of(modality))
    assert found.method == expected
    assert same_bits(found, results[expected, modality])


@pytest.mark.parametrize("method", NEED_NO_WEIGHTS)
def test_without_need_the_network_is_left_alone(results, build, blobs, method):
    assert same_bits(match(build(method, with_network=False), *blobs.of("mm")), results[method, "mm"])


def test_the_inverse_exchanges_everything(results):
    plain = results["nearest-features", "mc"]
    inverse = plain.inverse()
    assert inverse.source is plain.target
    assert inverse.target is plain.source
    assert inverse.source_to_target is plain.target_to_source
    assert inverse.target_to_source is plain.source_to_target
    assert inverse.source_confidence is plain.target_confidence
    assert inverse.target_confidence is plain.source_confidence
    assert inverse.method == plain.method
    assert same_bits(inverse.inverse(), plain)
