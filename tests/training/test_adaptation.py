"""Adapting to a pair: the loss falls there, the loaded weights stay, and the same call gives the same weights."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from homolog.core.errors import ArgumentError, TrainingError
from homolog.features import DiffusionNet, NetworkSettings, WeightsInfo
from homolog.geometry import OperatorSettings
from homolog.matching import Matcher, MatcherSettings
from homolog.shapes import Shape
from homolog.training import AdaptationSettings, LossSettings, TrainingShape, adapt_to_pair, adaptation, pair_losses
from homolog.training.settings import OptimiserSettings, SampleSettings

SETTINGS = AdaptationSettings(
    steps=8, optimiser=OptimiserSettings(learning_rate=3e-3), samples=SampleSettings(points=120, subsets=2)
)


@pytest.fixture(scope="module")
def matcher():
    torch.manual_seed(0)
    network = DiffusionNet(NetworkSettings(width=16, out_channels=16, blocks=2))
    info = WeightsInfo(upright=False, map_eigenpairs=12)
    return Matcher(network, info, settings=MatcherSettings(operators=OperatorSettings(24), partial_eigenpairs=10))


@pytest.fixture(scope="module")
def shapes(make):
    blob = make.blob(2)
    return blob, make.relabelled(Shape(blob.points * [1, 1.2, 0.9], blob.faces), np.arange(blob.n_points)[::-1])


def loss_of(matcher, source, target, *, partial=False):
    """Of the whole shapes, each mesh or cloud for itself, without anything random."""
    x, y = (TrainingShape("", shape.operators.basis, shape.operators.basis) for shape in (source, target))
    settings = LossSettings(map_eigenpairs=matcher.map_size(partial=partial))
    with torch.no_grad():
        return float(pair_losses(matcher.network, x, y, settings=settings, partial=partial)["total"])


def test_weights_for_other_shapes_are_not_adapted_by_losses_for_near_isometric_ones(matcher, shapes):
    for_organs = Matcher(
        matcher.network, replace(matcher.info, name="organs", near_isometric=False), settings=matcher.settings
    )
    pair = matcher.prepare_pair(*shapes)
    with pytest.raises(ArgumentError, match="the weights 'organs' are for shapes that are not near-isometric"):
        adapt_to_pair(for_organs, *pair, SETTINGS)
    registration = replace(
        SETTINGS,
        steps=1,
        loss=LossSettings(weights={"bijectivity": 0, "orthogonality": 0, "alignment": 0, "registration": 1.0}),
    )
    adapted = adapt_to_pair(for_organs, *pair, registration)[0]
    assert any(
        not torch.equal(*both) for both in zip(adapted.network.parameters(), matcher.network.parameters(), strict=True)
    )


@pytest.mark.parametrize("as_cloud", [None, "source", "both"])
def test_the_loss_of_the_pair_falls(matcher, shapes, as_cloud):
    pair = matcher.prepare_pair(*shapes, as_cloud=as_cloud)
    adapted, *after = adapt_to_pair(matcher, *pair, SETTINGS)
    assert loss_of(adapted, *after) < 0.95 * loss_of(matcher, *pair)
    for old, new in zip(pair, after, strict=True):
        assert torch.equal(new.features, adapted.features(new.operators))
        assert not torch.allclose(new.features, old.features, rtol=0.01)


def test_the_loaded_weights_stay_and_the_result_is_repeatable(matcher, shapes):
    before = {name: value.clone() for name, value in matcher.network.state_dict().items()}
    pair = matcher.prepare_pair(*shapes)
    first, second = (adapt_to_pair(matcher, *pair, SETTINGS)[0] for _ in range(2))
    other = adapt_to_pair(matcher, *pair, replace(SETTINGS, seed=1))[0]
    after = matcher.network.state_dict()
    assert all(torch.equal(after[name], value) for name, value in before.items())
    assert not matcher.network.training
    assert not first.network.training
    weights, repeated, others = (list(m.network.state_dict().values()) for m in (first, second, other))
    assert all(map(torch.equal, weights, repeated))
    assert not any(map(torch.equal, weights, others))


@pytest.mark.parametrize("partial", ["source", "target"])
def test_parts_of_shapes(matcher, shapes, make, partial):
    whole, other = shapes
    kept = other.points[other.faces].mean(axis=1)[:, 1] > -0.3
    part = Shape(other.points, other.faces[kept])
    given = (part, whole) if partial == "source" else (whole, part)
    pair = matcher.prepare_pair(*given, partial=partial)
    adapted, *after = adapt_to_pair(matcher, *pair, SETTINGS, partial=partial)
    ordered = [1, 0] if partial == "source" else [0, 1]
    before = loss_of(matcher, *(pair[i] for i in ordered), partial=True)
    assert loss_of(adapted, *(after[i] for i in ordered), partial=True) < before
    found = adapted.match_checked(*after, partial=partial)
    assert len(found.source_to_target) == given[0].n_points


def test_every_step_is_reported(matcher, shapes):
    told = []
    adapt_to_pair(matcher, *matcher.prepare_pair(*shapes), SETTINGS, listener=told.append)
    assert told == [f"adapt, step {step} of 8" for step in range(1, 9)]


@pytest.mark.parametrize("steps", [0, -3])
def test_no_steps(steps):
    with pytest.raises(ArgumentError, match="steps"):
        AdaptationSettings(steps=steps)


def test_without_a_network(matcher, shapes):
    axiomatic = Matcher()
    with pytest.raises(ArgumentError, match="needs a network; give weights, and a method that uses them"):
        adapt_to_pair(axiomatic, *axiomatic.prepare_pair(*shapes), SETTINGS)


def test_a_loss_that_is_not_finite_is_named(matcher, shapes):
    wild = replace(SETTINGS, optimiser=OptimiserSettings(learning_rate=1e30))
    with pytest.raises(TrainingError, match="not finite"):
        adapt_to_pair(matcher, *matcher.prepare_pair(*shapes), wild)


@pytest.mark.parametrize("partial", ["source", "target"])
def test_a_part_is_placed_first_and_its_cloud_lies_where_it_does(matcher, shapes, make, monkeypatch, partial):
    blob = shapes[0]
    kept = blob.points[blob.faces][:, :, 1].min(axis=1) > -0.2
    used, faces = np.unique(blob.faces[kept], return_inverse=True)
    part = Shape(blob.points[used], faces.reshape(-1, 3))
    pair = (part, blob) if partial == "source" else (blob, part)
    source, target = matcher.prepare_pair(*pair, partial=partial, pre_aligned=True)
    seen, placings = [], []

    def losses(network, x, y, **options):
        seen.append((x, y))
        return pair_losses(network, x, y, **options)

    def placed(self, complete, given):
        placings.append((complete, given))
        return replace(given, operators=replace(given.operators, points=given.operators.points + 0.25))

    monkeypatch.setattr(adaptation, "pair_losses", losses)
    monkeypatch.setattr(type(matcher), "placed", placed)
    adapt_to_pair(matcher, source, target, AdaptationSettings(steps=1), partial=partial)
    given = source if partial == "source" else target
    assert placings == [(target, source) if partial == "source" else (source, target)]
    ((x, y),) = seen
    assert x.mesh.n_points > y.mesh.n_points
    torch.testing.assert_close(y.mesh.points, y.cloud.points)
    assert y.mesh.points.mean(dim=0) == pytest.approx(given.operators.points.mean(dim=0) + 0.25, abs=0.1)
