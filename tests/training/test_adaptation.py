"""Adapting to a pair: the loss falls there, the loaded weights stay, and the same call gives the same weights."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from homolog.core.errors import ArgumentError, TrainingError
from homolog.features import DiffusionNet, FeatureInfo, NetworkSettings, Orientation
from homolog.geometry import OperatorSettings
from homolog.matching import Matcher, map_misfit, search
from homolog.matching.search import Hypothesis
from homolog.pairs import FunctionalMapSettings, MatcherSettings
from homolog.shapes import Shape, rotation_about
from homolog.training import (
    AdaptationSettings,
    LossSettings,
    TrainingShape,
    adapt_if_better,
    adapt_to_pair,
    adaptation,
    pair_losses,
    read_recipe,
)
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


def test_weights_for_shapes_that_keep_no_areas_are_adapted_by_losses_without_any_for_those_that_do(
    matcher, shapes, monkeypatch
):
    info = replace(matcher.extractor.info, name="organs", near_isometric=False, temperature=0.05)
    for_organs = matcher.with_extractor(replace(matcher.extractor, info=info))
    used = []

    def losses(network, x, y, **options):
        used.append((options["settings"], options["augmentation"]))
        return pair_losses(network, x, y, **options)

    monkeypatch.setattr(adaptation, "pair_losses", losses)
    adapted = adapt_to_pair(for_organs, for_organs.pair(*shapes)[0], replace(SETTINGS, steps=1))[0]
    ((settings, augmentation),) = used
    organs = read_recipe("organs")
    assert settings.weights == organs.loss.weights and settings.soft_temperature == 0.05
    assert augmentation == organs.augmentation
    assert not same_weights(adapted, matcher)
    given = LossSettings(weights={"infonce": 1.0, "orthogonality": 0.5})
    adapt_to_pair(for_organs, for_organs.pair(*shapes)[0], replace(SETTINGS, steps=1, loss=given))
    assert used[1][0].weights == given.weights


def same_weights(one, other):
    return all(
        torch.equal(*both)
        for both in zip(one.extractor.network.parameters(), other.extractor.network.parameters(), strict=True)
    )


def misfits(*matches):
    return [map_misfit(found) for found in matches]


@pytest.mark.parametrize("partial", [None, "source", "target"])
def test_the_map_that_contradicts_itself_less_is_kept(matcher, shapes, partial):
    """Whichever learning rate is given, the result is the better one of the two maps, and both scores are told."""
    pair, _ = matcher.pair(*shapes, partial=partial)
    plain, kept = matcher.match_pair(pair), []
    for rate in (1e-3, 3e-3, 1e-2, 3e-1) if partial is None else (1e-3, 3e-1):
        settings = replace(SETTINGS, optimiser=OptimiserSettings(learning_rate=rate))
        other = adapt_to_pair(matcher, pair, settings)
        adapted = other[0].match_pair(other[1])
        chosen, after = adapt_if_better(matcher, pair, settings)
        found = chosen.match_pair(after)
        told = found.report["adaptation"]
        assert [told["map_misfit"], told["adapted_map_misfit"]] == misfits(plain, adapted)
        assert told["steps"] == 8 and told["kept"] == (misfits(adapted) < misfits(plain))
        best = adapted if told["kept"] else plain
        assert np.array_equal(found.source_to_target, best.source_to_target)
        assert np.array_equal(found.target_to_source, best.target_to_source)
        kept.append(told["kept"])
    assert plain.report["adaptation"] is None
    if partial is None:
        assert True in kept and False in kept


def test_one_pair_leaves_nothing_behind_for_the_next(matcher, shapes, make):
    """Each begins with a network and an optimiser of its own."""
    pair, other = (matcher.pair(*both)[0] for both in (shapes, (shapes[0], make.blob(2))))
    alone = adapt_to_pair(matcher, pair, SETTINGS)[0]
    adapt_if_better(matcher, other, SETTINGS)
    assert same_weights(adapt_to_pair(matcher, pair, SETTINGS)[0], alone)


def test_the_features_that_were_chosen_for_the_pair_are_adapted(matcher, shapes):
    """Those that know the pair, and not the usual ones; a method without a network is left as it is."""
    knows, does_not = ({"orienter": Guess(np.eye(3), misfit), "info": matcher.extractor.info} for misfit in (0.01, 0.5))
    first = replace(matcher.extractor, **does_not, network=DiffusionNet(matcher.extractor.network.settings).eval())
    second = replace(matcher.extractor, **knows)
    several = Matcher([first, second], settings=matcher.settings)
    pair, _ = several.pair(*shapes)
    adapted = adapt_to_pair(several, pair, SETTINGS)[0]
    alone = matcher.with_extractor(second)
    assert same_weights(adapted, adapt_to_pair(alone, alone.pair(*shapes)[0], SETTINGS)[0])
    nobody = Matcher([first, replace(second, orienter=Guess(np.eye(3), 0.5))], settings=matcher.settings)
    pair, _ = nobody.pair(*shapes)
    assert pair.choice[0].name in ("axiomatic", "registration")
    same, after = adapt_if_better(nobody, pair, SETTINGS)
    assert same is nobody
    told = same.match_pair(after).report["adaptation"]
    assert told == {"steps": 0, "map_misfit": None, "adapted_map_misfit": None, "kept": False}


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

    def __init__(self, rotation, misfit=0.1):
        self.rotation, self.misfit = torch.tensor(rotation).float(), misfit

    def __call__(self, operators):
        return (Orientation(self.rotation, self.misfit),)

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
    with pytest.raises(ArgumentError, match="there is no network; give weights, and a method that uses them"):
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

    def align_parts(given):
        asked.append(given)
        operators = replace(given.y.operators, points=given.y.operators.points + 0.25)
        return given.with_y(replace(given.y, operators=operators))

    monkeypatch.setattr(adaptation, "pair_losses", losses)
    monkeypatch.setattr(adaptation, "align_parts", align_parts)
    adapt_to_pair(matcher, pair, AdaptationSettings(steps=1))
    given = pair.source if partial == "source" else pair.target
    assert asked == [pair] and pair.y is given
    ((x, y),) = seen
    assert x.mesh.n_points > y.mesh.n_points
    torch.testing.assert_close(y.mesh.points, y.cloud.points)
    assert y.mesh.points.mean(dim=0) == pytest.approx(given.operators.points.mean(dim=0) + 0.25, abs=0.1)
