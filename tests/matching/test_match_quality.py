"""What a match says of itself: both sides, parts, clouds."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from homolog.matching import MEASURES, MapQuality, Quality
from homolog.matching.quality import quality


@pytest.mark.parametrize("modality", ["mm", "cc", "mc"])
def test_every_match_has_figures_of_both_sides(build, blobs, modality):
    found = build().match(*blobs.of(modality))
    assert found.quality is not None
    for side, confidence in (
        (found.quality.source, found.source_confidence),
        (found.quality.target, found.target_confidence),
    ):
        assert side.confidence == pytest.approx(confidence.mean(), rel=1e-5)
        assert side.coverage > 0.8
        assert 0 < side.cycle_error < 0.2
        assert 0.5 < side.dirichlet_energy < 10
        assert (side.flipped_triangles is not None) == (modality == "mm")


def test_of_a_part_only_the_part_is_asked(build, blobs):
    """And exchanging source and target exchanges the figures."""
    part, whole = blobs.of("cc")
    one = build("nearest-features").match(whole, part, partial="target").quality
    other = build("nearest-features").match(part, whole, partial="source").quality
    assert one.source is None and one.target is not None
    assert other == one.inverse()
    assert one.mean == one.target
    assert one.to_dict()["source"] is None
    assert set(one.to_dict()["target"]) == set(MEASURES)


def test_the_mean_is_that_of_both_sides():
    found = MapQuality(Quality(1.0, 0.0, 1.0, 0.2, 0.9, 0.8), Quality(0.5, 0.1, 2.0, 0.4, 0.7, 1.6))
    np.testing.assert_allclose(list(vars(found.mean).values()), [0.75, 0.05, 1.5, 0.3, 0.8, 1.2])
    clouds = MapQuality(Quality(1.0, 0.0, 1.0, None, 0.9), Quality(0.5, 0.1, 2.0, None, 0.7))
    assert clouds.mean.flipped_triangles is None and clouds.mean.dirichlet_energy_99 is None


def test_a_shape_is_covered_by_the_map_from_the_other(build, blobs):
    source, target = (build().preprocess(shape) for shape in blobs.of("cc"))
    there, nowhere = torch.from_numpy(blobs.source_to_target), torch.zeros(blobs.target.n_points, dtype=torch.long)
    assert quality(source, target, there, nowhere, torch.ones(len(there))).coverage < 0.2
    assert quality(target, source, nowhere, there, torch.ones(len(nowhere))).coverage > 0.9
