"""Arguments of the wrong kind: each is refused in one line that names it, what was found, and what is allowed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import homolog
from homolog.core.errors import ArgumentError
from homolog.core.memory import get_working_memory, set_working_memory
from homolog.features import FeatureInfo, NetworkSettings, load_weights
from homolog.geometry import OperatorCache, OperatorSettings, compute_operators, unit_frame
from homolog.maps import (
    confidence,
    functional_map,
    functional_map_from_point_map,
    point_map_from_functional_map,
    sinkhorn_matches,
)
from homolog.matching import Match, Matcher
from homolog.pairs import Pair, Preprocessor, choose_device
from homolog.shapes import Shape, check, read_shape, repair, write_shape

Call = Callable[[], Any]
X: Any = "x"
NAN = float("nan")
POINTS = np.random.default_rng(0).standard_normal((30, 3))
SHAPE = Shape(POINTS)
PHI = torch.linalg.qr(torch.randn(30, 8, generator=torch.Generator().manual_seed(1))).Q
FEATURES = torch.nn.functional.normalize(PHI, dim=1)


def refusal(call: Call) -> str:
    with pytest.raises(ArgumentError) as refused:
        call()
    message = str(refused.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize("found", ["a.off", POINTS, None])
@pytest.mark.parametrize(
    "use",
    [
        repair,
        check,
        compute_operators,
        lambda shape: OperatorCache(Path("unused")).operators(shape),
        lambda shape: write_shape("unused/x.ply", shape),
    ],
)
def test_what_is_no_shape_is_refused_with_the_way_to_one(use: Callable[[Any], Any], found: Any) -> None:
    message = refusal(lambda: use(found))
    kind = "None" if found is None else type(found).__name__
    assert message.startswith("shape is ")
    assert kind in message
    assert "homolog.read_shape" in message


@pytest.mark.parametrize(
    ("name", "found", "call"),
    [
        ("features", "str", lambda: Matcher(X)),
        ("info", "dict", lambda: Matcher(info={})),  # type: ignore[arg-type]
        ("settings", "dict", lambda: Matcher(settings={})),  # type: ignore[arg-type]
        ("settings", "str", lambda: Matcher(settings="axiomatic")),  # type: ignore[arg-type]
        ("settings", "dict", lambda: compute_operators(SHAPE, settings={})),  # type: ignore[arg-type]
        ("weights", "None", lambda: Matcher.from_weights(None)),  # type: ignore[arg-type]
        ("weights", "None", lambda: load_weights(None)),  # type: ignore[arg-type]
        ("path", "None", lambda: read_shape(None)),  # type: ignore[arg-type]
        ("path", "int", lambda: write_shape(3, SHAPE)),  # type: ignore[arg-type]
        ("pair", "Shape", lambda: Matcher().find(SHAPE)),  # type: ignore[arg-type]
        ("options", "str", lambda: Matcher().match(SHAPE, SHAPE, "partial")),  # type: ignore[arg-type]
        ("source", "str", lambda: Pair.of(X, SHAPE, Preprocessor(), Matcher().method_of)),
    ],
)
def test_an_argument_of_another_kind_is_named_with_what_it_is(name: str, found: str, call: Call) -> None:
    message = refusal(call)
    assert message.startswith(f"{name} is ")
    assert found in message.split(", but must be ")[0]


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("n_eigenpairs", lambda: OperatorSettings(n_eigenpairs=20.5)),  # type: ignore[arg-type]
        ("n_eigenpairs", lambda: OperatorSettings(n_eigenpairs=X)),
        ("n_eigenpairs", lambda: OperatorSettings(n_eigenpairs=True)),
        ("n_neighbours", lambda: OperatorSettings(n_neighbours=X)),
        ("working memory", lambda: set_working_memory(X)),
        ("working memory", lambda: set_working_memory(NAN)),
        ("temperature", lambda: sinkhorn_matches(FEATURES, FEATURES, temperature=X)),
        ("temperature", lambda: sinkhorn_matches(FEATURES, FEATURES, temperature=NAN)),
        ("iterations", lambda: sinkhorn_matches(FEATURES, FEATURES, iterations=1.5)),  # type: ignore[arg-type]
        ("iterations", lambda: sinkhorn_matches(FEATURES, FEATURES, iterations=0)),
        ("regularisation", lambda: functional_map(PHI.T, PHI.T, torch.ones(8, 8), regularisation=X)),
        ("regularisation", lambda: functional_map(PHI.T, PHI.T, torch.ones(8, 8), regularisation=-1)),
    ],
)
def test_a_number_that_cannot_be_is_named_with_what_is_allowed(name: str, call: Call) -> None:
    message = refusal(call)
    assert message.startswith(f"{name} is ")
    assert "but must be a " in message


def test_the_bound_stays_when_another_is_refused() -> None:
    before = get_working_memory()
    refusal(lambda: set_working_memory(X))
    assert get_working_memory() == before


@pytest.mark.parametrize("device", [None, "tpu", 0, torch.device("meta")])
def test_what_is_no_device_is_refused_with_the_devices(device: Any) -> None:
    message = refusal(lambda: choose_device(device))
    found = device.type if isinstance(device, torch.device) else device
    assert f"device is {found!r}" in message
    assert "auto, cpu, cuda" in message


def test_a_torch_device_is_taken_as_it_is() -> None:
    assert choose_device(torch.device("cpu")) == torch.device("cpu")
    assert Matcher(device=torch.device("cpu")).device == torch.device("cpu")


def test_a_shape_takes_the_numbers_of_a_tensor_that_is_part_of_a_computation() -> None:
    points = torch.from_numpy(POINTS).requires_grad_()
    np.testing.assert_array_equal(Shape(points).points, POINTS)  # type: ignore[arg-type]


@pytest.mark.parametrize("index", [-1, 30])
def test_a_point_map_that_leads_nowhere_is_refused(index: int) -> None:
    good = torch.arange(30)
    bad = torch.where(good == 7, index, good)
    points, mass = torch.from_numpy(POINTS), torch.ones(30)
    calls: list[tuple[str, Call]] = [
        ("y_to_x", lambda: functional_map_from_point_map(bad, PHI, PHI, mass)),
        ("y_to_x", lambda: confidence(points, points, bad, good)),
        ("x_to_y", lambda: confidence(points, points, good, bad)),
    ]
    for name, call in calls:
        message = refusal(call)
        assert message.startswith(f"{name} holds {index}, but must hold indices from 0 to 29")
        assert "without a counterpart" in message


@pytest.mark.parametrize("value", [NAN, float("inf")])
@pytest.mark.parametrize("which", [0, 1])
def test_features_that_are_not_finite_are_called_so(value: float, which: int) -> None:
    both = [FEATURES.clone(), FEATURES.clone()]
    both[which][3, 2] = value
    assert "features are not finite" in refusal(lambda: functional_map(both[0].T, both[1].T, torch.ones(8, 8)))
    assert ("features_y", "features_x")[which] in refusal(lambda: sinkhorn_matches(both[0], both[1]))


def test_a_mask_that_is_not_finite_is_called_so() -> None:
    assert refusal(lambda: functional_map(PHI.T, PHI.T, torch.full((8, 8), NAN))).startswith("mask is not finite")


def test_a_functional_map_that_does_not_fit_or_is_not_finite_is_refused() -> None:
    assert "at least 9 columns" in refusal(lambda: point_map_from_functional_map(torch.eye(9), PHI, PHI))
    not_finite = torch.full((4, 4), NAN)
    assert refusal(lambda: point_map_from_functional_map(not_finite, PHI, PHI)).startswith("c_xy holds NaN")


def test_where_operators_come_from_must_be_a_function(tmp_path: Path) -> None:
    cache = OperatorCache(str(tmp_path))  # type: ignore[arg-type]
    assert "operators is OperatorCache, but must be a function" in refusal(lambda: Matcher(operators=cache))  # type: ignore[arg-type]
    assert cache.size() == (0, 0)


def test_a_length_that_is_no_number_is_refused() -> None:
    assert "scale is 'x'" in refusal(lambda: unit_frame(Shape(POINTS), scale=X))


def test_maps_of_other_shapes_are_no_match() -> None:
    few, many = Shape(POINTS[:10]), Shape(POINTS)
    ten, thirty = np.zeros(10, dtype=np.int64), np.zeros(30, dtype=np.int64)
    message = refusal(lambda: Match(many, many, ten, thirty))
    assert message.startswith("source_to_target has shape (10,), but must have one entry per point")
    assert "target_to_source has shape (30,)" in refusal(lambda: Match(few, few, ten, thirty))


def test_the_package_itself_offers_what_the_messages_name() -> None:
    for name in ("Matcher", "MatcherSettings", "Shape", "compute_operators", "read_shape"):
        assert hasattr(homolog, name)


@pytest.mark.parametrize("one", [1, 1.0, np.float32(1), np.float64(1), np.int64(1)])
def test_numbers_of_numpy_are_numbers(one: Any) -> None:
    assert homolog.PairOptions(partial="source", partial_scale=one).partial_scale == 1
    assert homolog.PairOptions(partial=np.str_("source"), strict=np.bool_(True)).strict is True
    before = get_working_memory()
    set_working_memory(1000 * one)
    assert get_working_memory() == 1000
    set_working_memory(before)
    assert sinkhorn_matches(FEATURES, FEATURES, temperature=one).x_to_y.shape == (30,)
    assert compute_operators(SHAPE, scale=one).scale == 1


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: homolog.PairOptions(partial=X, partial_scale=2), "partial is 'x', but must be one of source, target"),
        (
            lambda: homolog.PairOptions(partial=np.array(["source"])),
            "partial is ['source'], but must be one of 'source'",
        ),
        (lambda: homolog.PairOptions(orient=np.zeros(2)), "orient is [0.0, 0.0], but must be one of 'auto', 'given'"),
        (
            lambda: homolog.PairOptions(partial="source", partial_scale=True),
            "partial_scale is True, but must be a number",
        ),
        (
            lambda: homolog.PairOptions(partial="source", partial_scale=NAN),
            "partial_scale is nan, but must be a number",
        ),
        (lambda: homolog.PairOptions(partial_scale=2), "partial_scale is 2.0, but neither shape is partial"),
        (lambda: homolog.PairOptions(pre_aligned=1), "pre_aligned is 1, but must be true or false"),
        (lambda: FeatureInfo(n_eigenpairs=2.5), "n_eigenpairs is 2.5, but must be a whole number of at least 1"),
        (lambda: FeatureInfo(temperature=0), "temperature is 0, but must be a number above 0"),
        (lambda: FeatureInfo(input=X), "input is 'x', but must be one of xyz, xyz+wks, wks, hks, operators"),
        (lambda: NetworkSettings(dropout=1), "dropout is 1, but must be a number of at least 0 and below 1"),
        (lambda: NetworkSettings(width=0), "width is 0, but must be a whole number of at least 1"),
        (lambda: homolog.MatcherSettings(method="zzz"), "method is 'zzz', but must be one of auto, axiomatic, "),
        (lambda: homolog.stand_upright(SHAPE, np.zeros(2)), "up is array([0., 0.]), but must be one of x, y, z"),
        (lambda: homolog.stand_upright(X, "y"), "shape is a str, but must be a Shape"),
        (lambda: choose_device(np.zeros(2)), "device is array([0., 0.]), but must be one of auto, cpu, cuda"),
        (lambda: Shape(POINTS, name=3), "name is 3, but must be a text"),
        (lambda: OperatorCache(3), "path is 3, but must be a path"),
        (lambda: OperatorCache("x", max_bytes=X), "max_bytes is 'x', but must be a number of bytes"),
        (lambda: OperatorCache("x", eigenvectors=X), "eigenvectors is 'x', but must be one of float32, float16"),
        (lambda: Preprocessor()(SHAPE, orient=X), "orient is 'x', but must be one of auto, given"),
        (lambda: Preprocessor()(SHAPE, centre=[1, 2]), "centre is [1, 2], but must be three finite numbers"),
        (
            lambda: homolog.match(SHAPE, SHAPE, weights=""),
            "there are no weights ''; give the path of a file, or one of ",
        ),
        (
            lambda: load_weights(""),
            "there are no weights ''; give the path of a file, or one of the pretrained ones: ani",
        ),
    ],
)
def test_words_and_numbers_that_cannot_be_are_one_line(call: Call, said: str) -> None:
    with pytest.raises(homolog.HomologError) as refused:
        call()
    assert str(refused.value).startswith(said) and "\n" not in str(refused.value)


def test_long_values_are_cut() -> None:
    with pytest.raises(ArgumentError) as refused:
        homolog.PairOptions(partial=np.arange(10000))
    assert len(str(refused.value)) < 300


@pytest.mark.parametrize("side", ["source", "target"])
@pytest.mark.parametrize(
    ("given", "said"),
    [
        ((np.zeros((5, 3)), [[0, 1, 2]]), " cannot be used: 0 usable faces"),
        (np.zeros((5, 3)), " cannot be used: 1 usable points"),
        (Shape(np.zeros((5, 3))), " cannot be used: 1 usable points"),
        ((POINTS, [[0, 1, 99]]), ": faces hold the index 99"),
        (POINTS[:, :2], ": points have shape (30, 2)"),
        (3, ": a shape is needed, but int was given"),
    ],
)
def test_a_shape_without_a_name_is_called_by_its_side(side: str, given: Any, said: str) -> None:
    shapes = {"source": SHAPE, "target": SHAPE, side: given}
    with pytest.raises(homolog.HomologError) as refused:
        homolog.match(shapes["source"], shapes["target"], method="registration", device="cpu")
    assert str(refused.value).startswith(f"{side}{said}")
