"""Shapes that do not stand alike are noticed."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from homolog.geometry import OperatorSettings, compute_operators, unit_frame
from homolog.matching.axiomatic import axis_agreement
from homolog.matching.orientation import axiomatic_warnings, orientation_warnings
from homolog.network import load_weights
from homolog.shapes import Shape, rotation_about


def turned(operators, axis, degrees):
    """Operators do not depend on the pose, positions do."""
    rotation = torch.from_numpy(rotation_about(axis, degrees)).to(operators.points)
    return replace(operators, points=operators.points @ rotation.T)


def test_upright_bodies_raise_no_warning(demo_operators):
    assert axiomatic_warnings(*demo_operators) == []
    assert axiomatic_warnings(*demo_operators[::-1]) == []


@pytest.mark.parametrize("side", ["source", "target"])
@pytest.mark.parametrize(("up", "axis", "degrees"), [("z", 0, 90), ("x", 2, -90)])
def test_a_body_with_another_axis_up_is_named_with_that_axis(demo_operators, side, up, axis, degrees):
    source, target = demo_operators
    if side == "source":
        (warning,) = axiomatic_warnings(turned(source, axis, degrees), target)
    else:
        (warning,) = axiomatic_warnings(source, turned(target, axis, degrees))
    assert f"the {side} seems turned" in warning
    assert f"give {up} as the {side}'s up axis" in warning
    assert "\n" not in warning


@pytest.mark.parametrize(("axis", "degrees", "said"), [(0, -90, "-z seems to be up"), (2, 90, "-x seems to be up")])
def test_what_no_up_axis_mends_is_to_be_turned(demo_operators, axis, degrees, said):
    source, target = demo_operators
    (warning,) = axiomatic_warnings(turned(source, axis, degrees), target)
    assert said in warning
    assert "turn the file" in warning


@pytest.mark.parametrize("degrees", [90, 180, -90])
def test_facing_another_way_is_no_reason_to_doubt_the_up_axis(demo_operators, degrees):
    source, target = demo_operators
    assert axiomatic_warnings(turned(source, 1, degrees), target) == []


def test_signatures_say_nothing_of_the_axes_of_a_symmetric_shape(make):
    """What is odd about a symmetry they leave to rounding; it must not be taken for agreement."""
    operators = compute_operators(make.sphere(2), settings=OperatorSettings(n_eigenpairs=60))
    assert axis_agreement(operators, operators).abs().max() < 0.01


def test_both_lying_alike_need_no_warning_here(demo_operators):
    """The axiomatic route only compares."""
    assert axiomatic_warnings(*(turned(each, 0, 90) for each in demo_operators)) == []


def cloud_of(shape, n, seed=0):
    """Some of its points, and the unit that its faces give."""
    chosen = np.random.default_rng(seed).permutation(shape.n_points)[:n]
    return Shape(shape.points[chosen], name=f"{n} points"), unit_frame(shape).length


def warned(features, *clouds):
    (source, length), (target, other) = clouds
    return orientation_warnings(features, source, target, lengths=(length, other))


@pytest.mark.parametrize(("n", "enough"), [(1500, True), (600, True), (300, False), (100, False)])
def test_a_small_gain_says_little_of_sparse_clouds(demo, n, enough):
    """Features that tell only whether a body is upright, and lose a twentieth of their likeness where one is not."""

    def features(points, operators):
        upright = points.std(dim=0).argmax() == 1
        return torch.tensor([[1.0, 0.0]] if upright else [[0.95, (1 - 0.95**2) ** 0.5]]).expand(len(points), 2)

    source, length = cloud_of(demo.amber, n)
    lying = Shape(source.points @ rotation_about(0, 90).T), length
    target = cloud_of(demo.boris, 1500)
    assert warned(features, (source, length), target) == []
    assert bool(warned(features, lying, target)) == enough


@pytest.mark.reference
@pytest.mark.parametrize("n", [100, 300, 500, 1000])
def test_sparse_upright_bodies_raise_no_warning_with_trained_weights(demo, reference, n):
    network, _ = load_weights(reference / "surreal.pth")
    with torch.inference_mode():
        assert warned(network, cloud_of(demo.amber, n), cloud_of(demo.boris, n, seed=1)) == []
        if n >= 500:
            source, length = cloud_of(demo.amber, n)
            lying = Shape(source.points @ rotation_about(0, 90).T), length
            (warning,) = warned(network, lying, cloud_of(demo.boris, n, seed=1))
            assert "give z as the source's up axis" in warning
