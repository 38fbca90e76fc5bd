"""Shapes that do not stand alike are noticed, without any network."""

from dataclasses import replace

import pytest
import torch

from homolog.matching.orientation import axiomatic_warnings
from homolog.shapes import rotation_about


def turned(operators, axis, degrees):
    """Operators do not depend on the pose, positions do."""
    rotation = torch.from_numpy(rotation_about(axis, degrees)).to(operators.points)
    return replace(operators, points=operators.points @ rotation.T)


def test_upright_bodies_raise_no_warning(demo_operators):
    assert axiomatic_warnings(*demo_operators) == []
    assert axiomatic_warnings(*demo_operators[::-1]) == []


@pytest.mark.parametrize("side", ["source", "target"])
def test_a_body_with_z_up_is_named_with_the_option_that_helps(demo_operators, side):
    source, target = demo_operators
    if side == "source":
        (warning,) = axiomatic_warnings(turned(source, 0, 90), target)
    else:
        (warning,) = axiomatic_warnings(source, turned(target, 0, 90))
    assert f"the {side} seems turned" in warning
    assert f"use --{side}-up z" in warning
    assert "\n" not in warning


def test_both_lying_alike_need_no_warning_here(demo_operators):
    """The axiomatic route only compares."""
    assert axiomatic_warnings(*(turned(each, 0, 90) for each in demo_operators)) == []
