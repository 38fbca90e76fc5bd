"""Shapes that do not stand alike are noticed."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from homolog.features import load_weights
from homolog.geometry import OperatorSettings, compute_operators, unit_frame
from homolog.matching.orientation import Turn, axiomatic_warnings, orientation_warnings
from homolog.methods.axiomatic import axis_agreement
from homolog.shapes import Shape, rotation_about, upright_rotation


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
    assert f"give {up} as the {side}'s up axis ({side}_up)" in warning
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
    """The axiomatic method only compares."""
    assert axiomatic_warnings(*(turned(each, 0, 90) for each in demo_operators)) == []


def cloud_of(shape, n, seed=0):
    """Some of its points, and the unit that its faces give."""
    chosen = np.random.default_rng(seed).permutation(shape.n_points)[:n]
    return Shape(shape.points[chosen], name=f"{n} points"), unit_frame(shape).scale


def warned(features, *clouds, ups=("y", "y")):
    (source, scale), (target, other) = clouds
    return orientation_warnings(features, source, target, scales=(scale, other), ups=ups)


def read_as(file_up, given_up, side):
    """The turn of an upright body whose file has ``file_up`` up, and is read as if it had ``given_up``; both axes."""
    turn = upright_rotation(given_up) @ upright_rotation(file_up).T
    return turn, (given_up, "y") if side == "source" else ("y", given_up)


WRONG = [(true, given) for true in "xyz" for given in "xyz" if true != given]


@pytest.mark.parametrize("side", ["source", "target"])
@pytest.mark.parametrize(("true", "given"), WRONG)
def test_the_advice_names_what_to_give_for_the_file_as_it_is(demo_operators, side, true, given):
    """And once that is given, there is nothing more to say."""

    def warned(up):
        turn, ups = read_as(true, up, side)
        source, target = demo_operators
        moved = source if side == "source" else target
        moved = replace(moved, points=moved.points @ torch.from_numpy(turn).to(moved.points).T)
        return axiomatic_warnings(*((moved, target) if side == "source" else (source, moved)), ups=ups)

    (warning,) = warned(given)
    assert warning.endswith(f": its {true} seems to be up; give {true} as the {side}'s up axis ({side}_up)")
    assert warned(true) == []


def moments(points):
    """They tell a body's pose from what quarter turns make of it."""
    return torch.cat([points.square().mean(dim=0), points.pow(3).mean(dim=0)])


def features_of_upright(*clouds):
    """Features that are the same all over these bodies as they stand, and have another part at random otherwise."""
    known = [moments(torch.from_numpy((shape.points - shape.points.mean(axis=0)) / scale)) for shape, scale in clouds]

    def features(points, operators):
        own = moments(points.double())
        if any(torch.allclose(own, each, rtol=1e-3, atol=1e-5) for each in known):
            return torch.eye(64)[:1].expand(len(points), 64)
        seeded = torch.Generator().manual_seed(int(1e6 * own.abs().sum()))
        return torch.eye(64)[:1] + 0.06 * torch.randn(len(points), 64, generator=seeded)

    return features


@pytest.mark.parametrize("side", ["source", "target"])
@pytest.mark.parametrize(("true", "given"), WRONG)
def test_so_it_does_with_a_network(demo, side, true, given):
    upright = [cloud_of(demo.amber, 1000), cloud_of(demo.boris, 1000)]
    features, which = features_of_upright(*upright), ("source", "target").index(side)

    def told(up):
        turn, ups = read_as(true, up, side)
        clouds = list(upright)
        clouds[which] = Shape(upright[which][0].points @ turn.T), upright[which][1]
        return warned(features, *clouds, ups=ups)

    (warning,) = told(given)
    assert warning.endswith(f": its {true} seems to be up; give {true} as the {side}'s up axis ({side}_up)")
    assert told(true) == []


@pytest.mark.reference
@pytest.mark.parametrize(("true", "given"), WRONG)
@pytest.mark.parametrize("side", ["source", "target", "both"])
def test_so_it_does_with_trained_weights(demo, reference, side, true, given):
    network = load_weights(reference / "surreal.pth").network

    def told(up):
        turn, ups = read_as(true, up, side)
        clouds = [cloud_of(demo.amber, 1000), cloud_of(demo.boris, 1000)]
        moved = [(Shape(shape.points @ turn.T), scale) for shape, scale in clouds]
        ups = (up, up) if side == "both" else ups
        if side != "both":
            moved = [moved[0], clouds[1]] if side == "source" else [clouds[0], moved[1]]
        return warned(network, *moved, ups=ups)

    with torch.inference_mode():
        assert told(true) == []
        if side != "both":
            (warning,) = told(given)
            assert warning.endswith(f"give {true} as the {side}'s up axis ({side}_up)")
        elif (true, given) == ("z", "y") or given != "y":
            (warning,) = told(given)
            assert warning.endswith(
                f"their {true} seems to be up; give {true} as their up axis (source_up and target_up)"
            )


@pytest.mark.parametrize(("up", "axis", "forward"), [("y", "y", "+z"), ("x", "x", "+z"), ("z", "z", "-y")])
def test_a_turn_is_described_for_the_file_as_it_is(up, axis, forward):
    """A quarter about the vertical axis of an upright shape is one about the file's own up axis."""
    stood = upright_rotation(up)
    for degrees in (90, -90, 180):
        advice = Turn.of(rotation_about(1, degrees), up).advice
        assert advice.startswith("it seems to face another way; no option mends that: turn the {file} by ")
        assert advice.endswith(f"degrees about {axis}, so that it faces {forward}")
        said = int(advice.split(" by ")[1].split()[0])
        turned_file = rotation_about("xyz".index(axis), said)
        np.testing.assert_array_equal(stood @ turned_file, rotation_about(1, degrees) @ stood)


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_what_points_down_is_named_as_in_the_file(up):
    """The file's direction that the turn would bring up, and the very turn of the file, by the words of the advice."""
    stood = upright_rotation(up)
    for axis, degrees in ((0, 90), (0, -90), (2, 90), (2, -90), (0, 180)):
        turn = rotation_about(axis, degrees)
        advice = Turn.of(turn, up).advice
        named = advice.split()[1]
        direction = np.eye(3)["xyz".index(named[-1])] * (-1 if named.startswith("-") else 1)
        np.testing.assert_array_equal(turn @ stood @ direction, [0, 1, 0])
        if named.startswith("-"):
            said, _, _, about = advice.split(" by ")[1].split()
            file_turn = rotation_about("xyz".index(about), int(said))
            np.testing.assert_array_equal(stood @ file_turn, turn @ stood)
        else:
            assert advice.endswith(f"give {named} as {{whose}} up axis ({{option}})")


@pytest.mark.parametrize(("n", "enough"), [(1500, True), (600, True), (300, False), (100, False)])
def test_a_small_gain_says_little_of_sparse_clouds(demo, n, enough):
    """Features that tell only whether a body is upright, and lose a twentieth of their likeness where one is not."""

    def features(points, operators):
        upright = points.std(dim=0).argmax() == 1
        return torch.tensor([[1.0, 0.0]] if upright else [[0.95, (1 - 0.95**2) ** 0.5]]).expand(len(points), 2)

    source, scale = cloud_of(demo.amber, n)
    lying = Shape(source.points @ rotation_about(0, 90).T), scale
    target = cloud_of(demo.boris, 1500)
    assert warned(features, (source, scale), target) == []
    assert bool(warned(features, lying, target)) == enough


@pytest.mark.reference
@pytest.mark.parametrize("n", [100, 300, 500, 1000])
def test_sparse_upright_bodies_raise_no_warning_with_trained_weights(demo, reference, n):
    network = load_weights(reference / "surreal.pth").network
    with torch.inference_mode():
        assert warned(network, cloud_of(demo.amber, n), cloud_of(demo.boris, n, seed=1)) == []
        if n >= 500:
            source, scale = cloud_of(demo.amber, n)
            lying = Shape(source.points @ rotation_about(0, 90).T), scale
            (warning,) = warned(network, lying, cloud_of(demo.boris, n, seed=1))
            assert "give z as the source's up axis (source_up)" in warning
