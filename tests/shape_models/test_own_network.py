"""A network of a collection's own: one for all shapes, kept where its maps are better, the same however it is made."""

import json

import pytest
import torch

from homolog.core.errors import ArgumentError
from homolog.features import DiffusionNet, FeatureInfo, NetworkSettings, load_weights
from homolog.geometry import OperatorSettings
from homolog.matching import Matcher, map_misfit
from homolog.pairs import MatcherSettings
from homolog.shape_models import ShapeModelSettings, adaptation, build
from homolog.shapes import read_shape
from homolog.training import adapt_to_pairs
from homolog.training import adaptation as training_module

pytest.importorskip("h5py")
pytest.importorskip("matplotlib")
pytest.importorskip("PIL.Image")
SETTINGS = ShapeModelSettings(adapt=4)


@pytest.fixture(scope="module")
def matcher():
    torch.manual_seed(0)
    network = DiffusionNet(NetworkSettings(width=16, out_channels=16, blocks=2))
    info = FeatureInfo(name="small", upright=False, map_eigenpairs=12)
    return Matcher(network, info, settings=MatcherSettings(operators=OperatorSettings(24)))


def files_of(root):
    return {path.name: path.read_bytes() for path in (root / "shapes").iterdir()}


@pytest.mark.slow
def test_the_better_of_both_maps_is_kept_for_each_shape(matcher, family, tmp_path):
    template, files, _ = family
    root = tmp_path / "out"
    built = build(template, files, root, matcher, settings=SETTINGS)
    adapted = matcher.with_extractor(load_weights(root / "weights.safetensors"))
    assert adapted.extractor.info.name == "small, adapted"
    kept = {}
    for outcome in built.outcomes:
        shapes = read_shape(template), read_shape(outcome.subject.file)
        plain, other = (map_misfit(each.match(*shapes)) for each in (matcher, adapted))
        assert outcome.figures.map_misfit == pytest.approx(min(plain, other), abs=1e-5)
        assert outcome.figures.adapted == (other < plain)
        assert outcome.matched_by == ("functional-map, small, adapted" if other < plain else "functional-map, small")
        kept[outcome.subject.name] = other < plain
    told = json.loads((root / "report.json").read_text())["adaptation"]
    assert told["weights"] == "weights.safetensors"
    assert told["kept"] == [name for name, is_kept in kept.items() if is_kept]
    assert sorted(told["kept"] + told["not_kept"]) == sorted(kept)
    assert ",adapted," in (root / "quality.csv").read_text().splitlines()[0]


@pytest.mark.slow
def test_it_is_the_same_after_an_interrupt_and_stays_for_later_shapes(matcher, family, tmp_path, monkeypatch):
    template, files, _ = family
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    build(template, files[:2], whole, matcher, settings=SETTINGS)

    def interrupted(*_, listener, **__):
        listener("adapt, step 1 of 4")
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(adaptation, "adapt_to_pairs", interrupted)
        with pytest.raises(KeyboardInterrupt):
            build(template, files[:2], parts, matcher, settings=SETTINGS)
    assert not (parts / "weights.safetensors").exists()
    build(template, files[:2], parts, matcher, settings=SETTINGS)
    weights = (parts / "weights.safetensors").read_bytes()
    assert weights == (whole / "weights.safetensors").read_bytes()
    assert files_of(parts) == files_of(whole)
    monkeypatch.setattr(adaptation, "adapt_to_pairs", interrupted)  # it is not made again
    build(template, files, parts, matcher, settings=SETTINGS)
    assert (parts / "weights.safetensors").read_bytes() == weights and len(files_of(parts)) == 3
    with pytest.raises(ArgumentError, match=r"made in another way \(matching\)"):
        build(template, files, parts, matcher)


def test_without_a_network(family, tmp_path):
    template, files, _ = family
    axiomatic = Matcher(settings=MatcherSettings(method="axiomatic"))
    with pytest.raises(ArgumentError, match="adapt is given, but there is no network"):
        build(template, files[:1], tmp_path / "out", axiomatic, settings=SETTINGS)
    assert not (tmp_path / "out").exists()


def test_all_pairs_take_turns(matcher, family, monkeypatch):
    template, *others = (matcher.preprocess(read_shape(file)) for file in (family[0], *family[1]))
    seen, real = [], training_module.pair_losses

    def losses(network, x, y, **options):
        seen.append(y.mesh.points[0].clone())
        return real(network, x, y, **options)

    monkeypatch.setattr(training_module, "pair_losses", losses)
    pairs = [matcher.paired(template, other) for other in others]
    before = [value.clone() for value in matcher.extractor.network.parameters()]
    found = adapt_to_pairs(matcher, pairs, training_module.AdaptationSettings(steps=6))
    assert all(map(torch.equal, matcher.extractor.network.parameters(), before))
    assert not any(map(torch.equal, found.network.parameters(), before))
    for first, second in ((0, 3), (1, 4), (2, 5)):
        assert torch.equal(seen[first], seen[second])
    assert not torch.equal(seen[0], seen[1])
