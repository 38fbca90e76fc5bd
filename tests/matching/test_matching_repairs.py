"""Matching shapes in need of repair: answers refer to the points as given."""

import numpy as np
import pytest
from dirty_shapes import Dirty, dirtied

MIXES = [("functional-map", "mm"), ("nearest-features", "cc"), ("axiomatic", "mc")]


def lifted(values, own: Dirty | None, other: Dirty | None):
    """A clean map as it must come out for the damaged shapes."""
    if other is not None:
        first = np.array([np.flatnonzero(other.clean_index == clean)[0] for clean in range(max(other.clean_index) + 1)])
        values = first[values]
    return values if own is None else np.where(own.clean_index >= 0, values[own.clean_index], -1)


@pytest.mark.parametrize("sides", ["source", "target", "both"])
@pytest.mark.parametrize(("method", "modality"), MIXES)
def test_indices_refer_to_the_shapes_as_given(build, blobs, method, modality, sides):
    source, target = blobs.of(modality)
    clean = build(method).match(source, target)
    dirty_s = dirtied(source) if sides in ("source", "both") else None
    dirty_t = dirtied(target) if sides in ("target", "both") else None
    found = build(method).match(dirty_s.shape if dirty_s else source, dirty_t.shape if dirty_t else target)
    np.testing.assert_array_equal(found.source_to_target, lifted(clean.source_to_target, dirty_s, dirty_t))
    np.testing.assert_array_equal(found.target_to_source, lifted(clean.target_to_source, dirty_t, dirty_s))
    assert found.source_to_target.dtype == found.target_to_source.dtype == np.int64
    for own, confidence, plain in (
        (dirty_s, found.source_confidence, clean.source_confidence),
        (dirty_t, found.target_confidence, clean.target_confidence),
    ):
        if own is None:
            np.testing.assert_array_equal(confidence, plain)
            continue
        left_out = own.clean_index < 0
        assert np.sum(left_out) == 4 - (own.shape.faces is None)
        assert np.all(confidence[left_out] == 0)
        np.testing.assert_array_equal(confidence[~left_out], plain[own.clean_index[~left_out]])


def test_copies_get_the_answer_of_the_point_they_copy(build, blobs):
    dirty = dirtied(blobs.source).shape
    found = build("functional-map").match(dirty, blobs.target)
    first = [5, 253, 5]  # where clean points 3, 250 and 3 lie in the damaged shape
    np.testing.assert_array_equal(dirty.points[-3:], dirty.points[first])
    np.testing.assert_array_equal(found.source_to_target[-3:], found.source_to_target[first])
    np.testing.assert_array_equal(found.source_confidence[-3:], found.source_confidence[first])
    # Nothing is ever mapped to a copy, nor to a point that was left out.
    usable = np.ones(dirty.n_points, bool)
    usable[[0, 1, 202, -4, -3, -2, -1]] = False
    assert usable[found.target_to_source].all()


@pytest.mark.parametrize("side", ["source", "target"])
def test_repair_of_partial_shapes(build, blobs, side):
    """What the cut lets go and what the repair leaves out are both -1, each with confidence 0."""
    dirty = dirtied(blobs.source)
    shapes = {"source": dirty.shape, "target": blobs.target}
    if side == "source":
        shapes = {"source": blobs.target, "target": dirty.shape}
    found = build("nearest-features").match(shapes["source"], shapes["target"], partial=side)
    found = found.inverse() if side == "source" else found
    left_out = dirty.clean_index < 0
    assert np.all(found.source_to_target[left_out] == -1)
    assert np.all((found.source_confidence == 0) == (found.source_to_target < 0))
    assert np.all(found.target_to_source >= 0)


def test_dirty_shapes_are_not_changed(build, blobs):
    dirty = dirtied(blobs.source).shape
    points, faces = dirty.points.copy(), dirty.faces.copy()
    build("axiomatic").match(dirty, dirty)
    np.testing.assert_array_equal(dirty.points, points)
    np.testing.assert_array_equal(dirty.faces, faces)
