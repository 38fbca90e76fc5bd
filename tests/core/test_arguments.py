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
from homolog.features import load_weights
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
    assert f"device is '{device}'" in message
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
