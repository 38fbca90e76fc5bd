"""Feature extractors of what users have: a network, a module, a function."""

from __future__ import annotations

import threading

import numpy as np
import pytest
import torch
from torch import nn

from homolog.core.errors import ArgumentError
from homolog.features import DiffusionNet, FeatureInfo, NetworkSettings, as_extractor, on_device

CPU, META = torch.device("cpu"), torch.device("meta")
OWN = FeatureInfo(name="own", upright=False, temperature=0.3)


class Positions(nn.Module):
    """A module that is called with operators."""

    def __init__(self):
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(3, 4), nn.Dropout(0.5))

    def forward(self, operators):
        return self.layers(operators.points)


class Described(Positions):
    """A module that says itself what it expects."""

    info = FeatureInfo(name="described")


def network():
    return DiffusionNet(NetworkSettings(width=8, blocks=1, out_channels=4))


def modules_of(extractor):
    """The module that an extractor computes with."""
    return getattr(extractor, "network", getattr(extractor, "function", extractor))


@pytest.mark.parametrize("make", [network, Positions, Described])
def test_a_module_that_is_given_stays_as_it_is(make):
    given = make().train()
    kept = next(child for name, child in given.named_modules() if name)
    kept.eval()
    flags = [module.training for module in given.modules()]
    used = modules_of(on_device(as_extractor(given), META))
    assert [module.training for module in given.modules()] == flags
    assert {parameter.device for parameter in given.parameters()} == {CPU}
    assert not any(module.training for module in used.modules())
    assert {parameter.device for parameter in used.parameters()} == {META}


def test_a_module_that_cannot_be_copied_is_one_line():
    given = Positions()
    given.lock = threading.Lock()
    with pytest.raises(
        ArgumentError, match=r"a Positions cannot be copied \(.*\); give a function that calls it"
    ) as caught:
        on_device(as_extractor(given), CPU)
    assert "\n" not in str(caught.value)


class Own:
    """An extractor of one's own, without a module."""

    info = FeatureInfo(name="theirs")

    def __call__(self, operators):
        return operators.points


@pytest.mark.parametrize(
    "given", [as_extractor(network()), as_extractor(lambda shape: shape.points), Described(), Own(), Own().__call__]
)
def test_what_features_expect_can_be_given_for_every_kind(given):
    assert as_extractor(given, OWN).info is OWN
    assert as_extractor(given).info is not OWN


def test_an_extractor_keeps_its_own_account_without_another(demo_operators):
    given = Own()
    assert as_extractor(given) is given
    found = as_extractor(given, OWN)(demo_operators[0])
    np.testing.assert_array_equal(found, demo_operators[0].points)


def test_features_that_are_given_with_each_pair_have_one_account():
    assert as_extractor(OWN).info is OWN
    with pytest.raises(ArgumentError, match="features is a FeatureInfo, and info is another"):
        as_extractor(OWN, FeatureInfo())
