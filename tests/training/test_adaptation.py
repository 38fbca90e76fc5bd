"""Adapting to a pair: the loss falls there, the loaded weights stay, and the same call gives the same weights."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from homolog.core.errors import ArgumentError, TrainingError
from homolog.features import DiffusionNet, FeatureInfo, NetworkSettings, Orientation
from homolog.geometry import OperatorSettings
from homolog.matching import Matcher, search
from homolog.matching.search import Hypothesis
from homolog.pairs import FunctionalMapSettings, MatcherSettings
from homolog.shapes import Shape, rotation_about
from homolog.training import AdaptationSettings, LossSettings, TrainingShape, adapt_to_pair, adaptation, pair_losses
from homolog.training.settings import OptimiserSettings, SampleSettings

SIZES = FunctionalMapSettings(n_eigenpairs_partial=10)
SETTINGS = AdaptationSettings(
    steps=8, optimiser=OptimiserSettings(learning_rate=3e-3), samples=SampleSettings(points=120, subsets=2)
)


@pytest.fixture(scope="module")
def matcher():
    torch.manual_seed(0)
    network = DiffusionNet(NetworkSettings(width=16, out_channels=16, blocks=2))
    info = FeatureInfo(upright=False, map_eigenpairs=12)
    return Matcher(network, info, settings=MatcherSettings(operators=OperatorSettings(24), functional_map=SIZES))


@pytest.fixture(scope="module")
def shapes(make):
    blob = make.blob(2)
    return blob, make.relabelled(Shape(blob.points * [1, 1.2, 0.9], blob.faces), np.arange(blob.n_points)[::-1])


def loss_of(matcher, pair):
    """Of all points, each mesh or cloud for itself, without anything random."""
    x, y = (TrainingShape("", shape.operators.basis, shape.operators.basis) for shape in (pair.x, pair.y))
    settings, partial = LossSettings(map_eigenpairs=pair.map_size), pair.is_partial
    with torch.no_grad():
        return float(pair_losses(matcher.extractor.network, x, y, settings=settings, partial=partial)["total"])


def test_weights_for_shapes_that_keep_no_areas_are_not_adapted_by_losses_for_those_that_do(matcher, shapes):
    for_organs = Matcher(
        matcher.extractor.network,
        replace(matcher.extractor.info, name="organs", near_isometric=False),
        settings=matcher.settings,
    )
    pair = for_organs.pair(*shapes)[0]
    with pytest.raises(ArgumentError, match="the weights 'organs' are for shapes that are not near-isometric"):
        adapt_to_pair(for_organs, pair, SETTINGS)
    registration = replace(
        SETTINGS,
        steps=1,
        loss=LossSettings(weights={"bijectivity": 0, "orthogonality": 0, "alignment": 0, "registration": 1.0}),
    )
    adapted = adapt_to_pair(for_organs, pair, registration)[0]
    assert any(
        not torch.equal(*both)
        for both in zip(adapted.extractor.network.parameters(), matcher.extractor.network.parameters(), strict=True)
    )


@pytest.mark.parametrize("as_cloud", [None, "source", "both"])
def test_the_loss_of_the_pair_falls(matcher, shapes, as_cloud):
    pair, _ = matcher.pair(*shapes, as_cloud=as_cloud)
    adapted, after = adapt_to_pair(matcher, pair, SETTINGS)
    networks = after.extractor.network, adapted.extractor.network
    assert all(torch.equal(*both) for both in zip(*(one.parameters() for one in networks), strict=True))
    assert loss_of(adapted, after) < 0.95 * loss_of(matcher, pair)
    for old, new in ((pair.source, after.source), (pair.target, after.target)):
        assert torch.equal(new.features, adapted.preprocess.features(new.operators))
        assert not torch.allclose(new.features, old.features, rtol=0.01)


def test_the_loaded_weights_stay_and_the_result_is_repeatable(matcher, shapes):
    before = {name: value.clone() for name, value in matcher.extractor.network.state_dict().items()}
    pair = matcher.pair(*shapes)[0]
    first, second = (adapt_to_pair(matcher, pair, SETTINGS)[0] for _ in range(2))
    other = adapt_to_pair(matcher, pair, replace(SETTINGS, seed=1))[0]
    after = matcher.extractor.network.state_dict()
    assert all(torch.equal(after[name], value) for name, value in before.items())
    assert not matcher.extractor.network.training
    assert not first.extractor.network.training
    weights, repeated, others = (list(m.extractor.network.state_dict().values()) for m in (first, second, other))
    assert all(map(torch.equal, weights, repeated))
    assert not any(map(torch.equal, weights, others))


@pytest.mark.parametrize("partial", ["source", "target"])
def test_parts_of_shapes(matcher, shapes, make, partial):
    whole, other = shapes
    kept = other.points[other.faces].mean(axis=1)[:, 1] > -0.3
    part = Shape(other.points, other.faces[kept])
    given = (part, whole) if partial == "source" else (whole, part)
    pair, _ = matcher.pair(*given, partial=partial)
    adapted, after = adapt_to_pair(matcher, pair, SETTINGS)
    assert pair.map_size == after.map_size == 10
    assert loss_of(adapted, after) < loss_of(matcher, pair)
    found = adapted.match_pair(after)
    assert len(found.source_to_target) == given[0].n_points


def test_every_step_is_reported(matcher, shapes):
    told = []
    adapt_to_pair(matcher, matcher.pair(*shapes)[0], SETTINGS, listener=told.append)
    assert told == [f"adapt, step {step} of 8" for step in range(1, 9)]


class Guess:
    """An orienter that has one answer for all shapes."""

    def __init__(self, rotation):
        self.rotation = torch.tensor(rotation).float()

    def __call__(self, operators):
        return (Orientation(self.rotation, 0.1),)

    def to(self, device):
        return self


def test_turned_shapes_are_trained_on_as_they_are_matched(matcher, shapes, monkeypatch):
    """The way round is decided once: before the first step, and for the match as well."""
    guess = Guess(rotation_about(1, 90))
    decided = [torch.tensor(Rotation.random(random_state=seed).as_matrix()).float() for seed in (0, 1)]
    info = replace(matcher.extractor.info, upright=True)
    asked, seen = [], []

    def ranked(pair, *, unlikely_too):
        asked.append(pair)
        return [Hypothesis(*decided)]

    def losses(network, x, y, **options):
        seen.append((x, y))
        return pair_losses(network, x, y, **options)

    monkeypatch.setattr(search, "_ranked", ranked)
    monkeypatch.setattr(adaptation, "pair_losses", losses)
    oriented = matcher.with_extractor(replace(matcher.extractor, orienter=guess, info=info))
    pair, _ = oriented.pair(*shapes)
    torch.testing.assert_close(pair.source.rotation, guess.rotation)
    adapted, after = adapt_to_pair(oriented, pair, replace(SETTINGS, steps=1))
    found = adapted.match_pair(after).report["orientation"]
    plain, _ = matcher.pair(*shapes, orient="given")
    ((x, y),) = seen
    for trained, side, given, turn in (
        (x, "source", plain.source, decided[0]),
        (y, "target", plain.target, decided[1]),
    ):
        there = given.operators.points @ turn.T
        for basis in (trained.mesh, trained.cloud):
            assert torch.cdist(basis.points, there).amin(dim=1).max() < 1e-3
        torch.testing.assert_close(torch.tensor(found[side]["rotation"]), turn)
        torch.testing.assert_close(getattr(after, side).operators.points, there, atol=1e-5, rtol=0)
    assert asked == [pair]


@pytest.mark.parametrize("steps", [0, -3])
def test_no_steps(steps):
    with pytest.raises(ArgumentError, match="steps"):
        AdaptationSettings(steps=steps)


def test_without_a_network(matcher, shapes):
    axiomatic = Matcher()
    with pytest.raises(ArgumentError, match="needs a network; give weights, and a method that uses them"):
        adapt_to_pair(axiomatic, axiomatic.pair(*shapes)[0], SETTINGS)


def test_a_loss_that_is_not_finite_is_named(matcher, shapes):
    wild = replace(SETTINGS, optimiser=OptimiserSettings(learning_rate=1e30))
    with pytest.raises(TrainingError, match="not finite"):
        adapt_to_pair(matcher, matcher.pair(*shapes)[0], wild)


@pytest.mark.parametrize("partial", ["source", "target"])
def test_a_partial_shape_is_aligned_first_and_its_cloud_lies_where_it_does(matcher, shapes, make, monkeypatch, partial):
    blob = shapes[0]
    kept = blob.points[blob.faces][:, :, 1].min(axis=1) > -0.2
    used, faces = np.unique(blob.faces[kept], return_inverse=True)
    part = Shape(blob.points[used], faces.reshape(-1, 3))
    pair = (part, blob) if partial == "source" else (blob, part)
    pair, _ = matcher.pair(*pair, partial=partial, pre_aligned=True)
    seen, asked = [], []

    def losses(network, x, y, **options):
        seen.append((x, y))
        return pair_losses(network, x, y, **options)

    def align_partial(given):
        asked.append(given)
        operators = replace(given.y.operators, points=given.y.operators.points + 0.25)
        return given.with_y(replace(given.y, operators=operators))

    monkeypatch.setattr(adaptation, "pair_losses", losses)
    monkeypatch.setattr(adaptation, "align_partial", align_partial)
    adapt_to_pair(matcher, pair, AdaptationSettings(steps=1))
    given = pair.source if partial == "source" else pair.target
    assert asked == [pair] and pair.y is given
    ((x, y),) = seen
    assert x.mesh.n_points > y.mesh.n_points
    torch.testing.assert_close(y.mesh.points, y.cloud.points)
    assert y.mesh.points.mean(dim=0) == pytest.approx(given.operators.points.mean(dim=0) + 0.25, abs=0.1)
