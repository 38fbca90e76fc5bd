"""Settings of refinement, confidence and registration: what they refuse, and that each of them steers something."""

from __future__ import annotations

from dataclasses import asdict, fields, replace

import numpy as np
import pytest
import torch

from homolog.core.errors import ArgumentError
from homolog.geometry import Operators, OperatorSettings, compute_operators
from homolog.maps import (
    ConfidenceSettings,
    RefinementSettings,
    RegistrationSettings,
    confidence,
    coverage_density,
    normalised,
    overlap,
    registered_positions,
    zoomout,
    zoomout_partial,
)

KINDS = [RefinementSettings, ConfidenceSettings, RegistrationSettings]
FIELDS = [(kind, field.name) for kind in KINDS for field in fields(kind)]


@pytest.mark.parametrize(("kind", "name"), FIELDS)
@pytest.mark.parametrize("value", [-1, float("nan"), float("inf"), "20", None, True])
def test_what_no_field_can_be_is_refused_by_name(kind: type, name: str, value: object) -> None:
    with pytest.raises(ArgumentError, match=f"^{name} is .*, but must be ") as caught:
        kind(**{name: value})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "name", "value", "allowed"),
    [
        (RefinementSettings, "k_init", 0, "a whole number of at least 1"),
        (RefinementSettings, "k_step", 1.5, "a whole number of at least 1"),
        (RefinementSettings, "guidance_end", 0, "a number above 0"),
        (ConfidenceSettings, "scale", 0.0, "a number above 0"),
        (ConfidenceSettings, "overlap_threshold", 1.01, "a number above 0 and of at most 1"),
        (RegistrationSettings, "start_width", 2, "a number of at least 0 and of at most 1"),
        (RegistrationSettings, "narrowing", 1, "a number of at least 0 and below 1"),
    ],
)
def test_bounds_are_said(kind: type, name: str, value: float, allowed: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        kind(**{name: value})
    assert str(caught.value) == f"{name} is {value!r}, but must be {allowed}"


@pytest.mark.parametrize("kind", KINDS)
def test_they_are_plain_values_that_come_back_from_a_dictionary(kind: type) -> None:
    settings = kind()
    assert kind(**asdict(settings)) == settings
    assert all(isinstance(value, int | float) for value in asdict(settings).values())
    with pytest.raises(TypeError):
        kind(5)


def test_numbers_of_numpy_count_as_numbers() -> None:
    settings = RefinementSettings(k_init=np.int64(7), guidance_end=np.float32(0.5))
    assert settings == RefinementSettings(k_init=7, guidance_end=0.5)
    assert type(settings.k_init) is int and type(settings.guidance_end) is float


@pytest.mark.parametrize("function", [confidence, zoomout, registered_positions])
def test_settings_of_another_function_are_refused(function) -> None:
    points, indices = torch.rand(30, 3), torch.arange(30)
    given = {
        confidence: (points, points, indices, indices),
        zoomout: (indices, indices, points, points, points, points),
        registered_positions: (points, points),
    }
    with pytest.raises(ArgumentError, match=r"settings is an OperatorSettings, but must be \w+Settings; make them"):
        function(*given[function], settings=OperatorSettings())


def test_rounds_grow_to_the_largest_basis_while_features_fall_geometrically() -> None:
    rounds = list(RefinementSettings(k_init=10, k_step=15, guidance_start=8.0, guidance_end=1.0).rounds(48))
    assert [(n_left, size) for n_left, size, _ in rounds] == [(3, 10), (2, 25), (1, 40), (0, 48)]
    assert [weight for _, _, weight in rounds] == pytest.approx([8, 4, 2, 1])
    assert list(RefinementSettings().rounds(12)) == [(0, 12, 0.1)]


def test_widths_fall_to_one() -> None:
    assert list(RegistrationSettings().widths(5000)) == [50, 25, 12, 6, 3, 1]
    assert list(RegistrationSettings(narrowing=0).widths(5000)) == [50]
    assert list(RegistrationSettings(start_width=0).widths(5000)) == [1]


@pytest.fixture(scope="module")
def blob(make) -> Operators:
    return compute_operators(make.blob(3), settings=OperatorSettings(n_eigenpairs=60))


@pytest.mark.parametrize(
    "change",
    [
        {"k_init": 5},
        {"k_step": 3},
        {"n_samples": 40},
        {"n_samples": 150, "rounds_among_all": 1},
        {"guidance_start": 30.0},
        {"guidance_end": 30.0},
    ],
)
def test_each_setting_of_the_refinement_changes_a_map(change: dict, blob: Operators, make) -> None:
    other = compute_operators(make.sphere(3), settings=OperatorSettings(n_eigenpairs=60))
    (phi_x, values_x), (phi_y, values_y) = ((ops.eigenvectors, ops.eigenvalues) for ops in (blob, other))
    features = [normalised(torch.randn(len(phi_x), 4, generator=torch.Generator().manual_seed(i))) for i in (2, 3)]
    start = torch.randint(len(phi_x), (len(phi_y),), generator=torch.Generator().manual_seed(0))
    usual = RefinementSettings(**({"n_samples": 150} if "rounds_among_all" in change else {}))
    changed = replace(usual, **change)
    partial = (start, phi_x, phi_y, values_x, values_y, *features)
    for function, given in ((zoomout, (start, start, phi_x, phi_y, *features)), (zoomout_partial, partial)):
        before, after = (function(*given, settings=settings)[0] for settings in (usual, changed))
        assert not torch.equal(before, after), function.__name__


def test_scale_and_neighbours_of_confidence(blob: Operators) -> None:
    n = blob.n_points
    some = torch.randperm(n, generator=torch.Generator().manual_seed(0))
    there = torch.where(torch.arange(n) % 50 == 0, some, torch.arange(n))
    given = blob.points, blob.points, there, torch.arange(n)
    usual, twice = confidence(*given), confidence(*given, settings=ConfidenceSettings(scale=0.2))
    torch.testing.assert_close(usual, twice**2)
    alone = confidence(*given, settings=ConfidenceSettings(n_neighbours=1))
    assert (alone == 1).sum() > (usual == 1).sum()


def test_smoothing_and_threshold_of_the_overlap(blob: Operators) -> None:
    upper = torch.nonzero(blob.points[:, 1] > 0).flatten()
    mass = blob.mass[upper]
    sharp, smooth = (coverage_density(blob, mass, upper, settings=ConfidenceSettings(smoothing=s)) for s in (0.1, 4))
    assert sharp.std() > smooth.std()
    half = replace(blob, mass=mass)
    counts = [
        int(overlap(blob, half, upper, settings=ConfidenceSettings(overlap_threshold=t)).sum()) for t in (0.1, 0.5, 0.9)
    ]
    assert counts[0] > counts[1] > counts[2] > 0
    # By default the boundary of a straight cut is met: half the mass is on either side of it.
    assert abs(int(overlap(blob, half, upper).sum()) - len(upper)) < 0.03 * len(upper)
    assert counts[0] > 1.1 * len(upper)


@pytest.mark.parametrize("change", [{"n_neighbours": 20}, {"start_width": 0.05}, {"narrowing": 0.8}])
def test_each_setting_of_the_registration_moves_points(change: dict, make) -> None:
    x, y = make.blob(3).points, make.sphere(3).points * np.array([1, 1.4, 0.8])
    usual, changed = registered_positions(x, y), registered_positions(x, y, settings=RegistrationSettings(**change))
    for before, after in zip(usual, changed, strict=True):
        assert np.abs(before - after).max() > 1e-3
