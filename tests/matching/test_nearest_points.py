"""The method nearest-points."""

import numpy as np

import homolog


def test_a_shape_is_mapped_to_itself(make):
    blob = make.blob()
    match = homolog.match(blob, blob, method="nearest-points")
    np.testing.assert_array_equal(match.source_to_target, np.arange(blob.n_points))
