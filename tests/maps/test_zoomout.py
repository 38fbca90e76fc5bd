"""The guided refinement against a slow reference, and what features and both directions are good for."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from homolog.core.errors import ArgumentError
from homolog.geometry import Operators, OperatorSettings, compute_operators
from homolog.maps import (
    RefinementSettings,
    functional_map_from_point_map,
    normalised,
    point_map_from_functional_map,
    zoomout,
    zoomout_partial,
)
from homolog.shapes import Shape

# What features weigh in the first round and in the last; geometrically less from round to round.
FIRST_GUIDANCE, LAST_GUIDANCE = 1.0, 0.1


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


@pytest.fixture(scope="module")
def blob(make) -> Operators:
    return compute_operators(make.blob(), settings=OperatorSettings(n_eigenpairs=60))


def slow_guided_zoom_out(
    y_to_x: np.ndarray, x_to_y: np.ndarray, phi: tuple[np.ndarray, ...], f: tuple[np.ndarray, ...], sizes: list[int]
) -> tuple[np.ndarray, np.ndarray]:
    """All points in every round, distances point by point, functional maps by least squares over the listed pairs."""
    (phi_x, phi_y), (f_x, f_y) = phi, f
    for number, size in enumerate(sizes):
        weight = np.geomspace(FIRST_GUIDANCE, LAST_GUIDANCE, len(sizes))[number]
        pairs = [(int(i), j) for j, i in enumerate(y_to_x)] + [(i, int(j)) for i, j in enumerate(x_to_y)]
        in_x = np.stack([phi_x[i, :size] for i, _ in pairs])
        in_y = np.stack([phi_y[j, :size] for _, j in pairs])
        c_xy = np.linalg.lstsq(in_y, in_x, rcond=None)[0]
        c_yx = np.linalg.lstsq(in_x, in_y, rcond=None)[0]
        y_to_x = slow_nearest(phi_y[:, :size], phi_x[:, :size] @ c_xy.T, f_y, f_x, weight)
        x_to_y = slow_nearest(phi_x[:, :size], phi_y[:, :size] @ c_yx.T, f_x, f_y, weight)
    return y_to_x, x_to_y


def slow_nearest(phi: np.ndarray, carried: np.ndarray, f: np.ndarray, g: np.ndarray, weight: float) -> np.ndarray:
    """By the mean squared difference of eigenfunctions and the weighted one of features."""
    found = [
        np.argmin(((carried - row) ** 2).mean(axis=1) + weight * ((g - features) ** 2).sum(axis=1))
        for row, features in zip(phi, f, strict=True)
    ]
    return np.array(found)


def test_it_is_the_slow_reference_where_all_points_take_part(blob, make) -> None:
    """Between two shapes of different numbers of points, from maps of which much is wrong."""
    other = compute_operators(make.sphere(3), settings=OperatorSettings(n_eigenpairs=48))
    x, y = blob.eigenvectors, other.eigenvectors
    f_x, f_y = normalised(random(len(x), 6, seed=1)), normalised(random(len(y), 6, seed=2))
    y_to_x = torch.randint(len(x), (len(y),), generator=torch.Generator().manual_seed(3))
    x_to_y = torch.randint(len(y), (len(x),), generator=torch.Generator().manual_seed(4))
    found = zoomout(y_to_x, x_to_y, x, y, f_x, f_y, settings=RefinementSettings(k_init=10, k_step=15))
    phi, features = ([t.double().numpy() for t in pair] for pair in ((x, y), (f_x, f_y)))
    expected = slow_guided_zoom_out(y_to_x.numpy(), x_to_y.numpy(), tuple(phi), tuple(features), [10, 25, 40, 48])
    for one, other_one in zip(found, expected, strict=True):
        assert (one.numpy() == other_one).mean() > 0.97  # rounding moves near ties, and a round what follows it


def slow_guided_zoom_out_to_partial(
    y_to_x: np.ndarray,
    phi: tuple[np.ndarray, ...],
    eigenvalues: tuple[np.ndarray, ...],
    f: tuple[np.ndarray, ...],
    sizes: list[int],
) -> tuple[np.ndarray, np.ndarray]:
    """All points in every round; the partial shape's functions carried to the full one, distances point by point."""
    (phi_x, phi_y), (f_x, f_y) = phi, f
    for number, size in enumerate(sizes):
        weight = np.geomspace(FIRST_GUIDANCE, LAST_GUIDANCE, len(sizes))[number]
        as_slow = sum(value <= eigenvalues[0][size - 1] for value in eigenvalues[1])
        in_x = np.stack([phi_x[i, :size] for i in y_to_x])
        carried = phi_y[:, :as_slow] @ np.linalg.lstsq(phi_y[:, :as_slow], in_x, rcond=None)[0]
        y_to_x = slow_nearest(carried, phi_x[:, :size], f_y, f_x, weight)
    return y_to_x, slow_nearest(phi_x[:, :size], carried, f_x, f_y, weight)


@pytest.fixture(scope="module")
def half(make, blob) -> tuple[Operators, Tensor]:
    """The upper half of the blob at the blob's scale, and the blob's point for each of its own."""
    full = make.blob()
    faces = full.faces[(full.points[full.faces][:, :, 1] > -0.1).all(axis=1)]
    kept, renumbered = np.unique(faces, return_inverse=True)
    partial = Shape(full.points[kept], renumbered.reshape(-1, 3))
    settings = OperatorSettings(n_eigenpairs=60)
    return compute_operators(partial, settings=settings, scale=blob.scale), torch.from_numpy(kept)


def given_for_partial(blob: Operators, partial: Operators, f_x: Tensor, f_y: Tensor) -> tuple[Tensor, ...]:
    return blob.eigenvectors, partial.eigenvectors, blob.eigenvalues, partial.eigenvalues, f_x, f_y


def test_for_a_partial_shape_it_is_the_slow_reference(blob, half) -> None:
    partial, _ = half
    f_x, f_y = normalised(random(len(blob.points), 6, seed=1)), normalised(random(len(partial.points), 6, seed=2))
    y_to_x = torch.randint(len(blob.points), (len(partial.points),), generator=torch.Generator().manual_seed(3))
    given = given_for_partial(blob, partial, f_x, f_y)
    found = zoomout_partial(y_to_x, *given, settings=RefinementSettings(k_init=10, k_step=25))
    phi_x, phi_y, values_x, values_y, *_ = (tensor.double().numpy() for tensor in given)
    features = f_x.double().numpy(), f_y.double().numpy()
    sizes = [10, 35, 60]
    expected = slow_guided_zoom_out_to_partial(y_to_x.numpy(), (phi_x, phi_y), (values_x, values_y), features, sizes)
    for one, other in zip(found, expected, strict=True):
        assert (one.numpy() == other).mean() > 0.97


def test_a_partial_shape_is_found_from_a_map_of_which_a_third_is_wrong(blob, half) -> None:
    partial, truth = half
    n_x, n_y = len(blob.points), len(partial.points)
    wrong = torch.rand(n_y, generator=torch.Generator().manual_seed(1)) < 0.33
    start = torch.where(wrong, torch.randint(n_x, (n_y,), generator=torch.Generator().manual_seed(2)), truth)
    flat = torch.zeros(n_x, 1), torch.zeros(n_y, 1)
    found, back = zoomout_partial(start, *given_for_partial(blob, partial, *flat))

    def mean_error(point_map: Tensor) -> float:
        return float((blob.points[point_map] - blob.points[truth]).norm(dim=1).mean())

    edge = 0.04 * float((blob.points.amax(dim=0) - blob.points.amin(dim=0)).max())
    assert mean_error(found) < edge < 3 * edge < mean_error(start)
    there = float((blob.points[truth[back[truth]]] - blob.points[truth]).norm(dim=1).mean())
    assert there < edge


def test_what_cannot_be_is_named_for_a_partial_shape_too(blob, half) -> None:
    partial, truth = half
    flat = torch.zeros(len(blob.points), 1), torch.zeros(len(partial.points), 1)
    given = given_for_partial(blob, partial, *flat)
    with pytest.raises(ArgumentError, match="y_to_x"):
        zoomout_partial(truth - 1000, *given)
    with pytest.raises(ArgumentError, match="features_y"):
        zoomout_partial(truth, *given[:-1], flat[1] + float("nan"))


def test_a_copy_is_found_from_maps_of_which_half_is_wrong(blob) -> None:
    n = len(blob.points)
    order = torch.randperm(n, generator=torch.Generator().manual_seed(0))
    x, y = blob.eigenvectors, blob.eigenvectors[order]
    flat = torch.zeros(n, 1)
    wrong = torch.rand(n, generator=torch.Generator().manual_seed(1)) < 0.5
    scattered = torch.where(wrong, torch.randint(n, (n,), generator=torch.Generator().manual_seed(2)), order)
    y_to_x, x_to_y = zoomout(scattered, torch.argsort(scattered), x, y, flat, flat)
    assert (y_to_x == order).float().mean() > 0.99
    assert (x_to_y == torch.argsort(order)).float().mean() > 0.99


def test_features_keep_points_apart_that_eigenfunctions_take_for_one_another(make) -> None:
    """Two equal pieces have the same eigenfunctions up to their mixture; a feature says which piece is which."""
    piece = make.blob(2)
    both = make.joined([piece, type(piece)(piece.points + np.array([5.0, 0, 0]), piece.faces)])
    ops = compute_operators(both, settings=OperatorSettings(n_eigenpairs=40))
    n = len(ops.points)
    truth = torch.arange(n)
    inverse = (truth + n // 2) % n
    # Two thirds of the points go to the other piece, which is as good to eigenfunctions.
    start = torch.where(torch.arange(n) % 3 == 0, truth, inverse)
    side = torch.where(truth < n // 2, 1.0, -1.0)
    blind, seeing = torch.zeros(n, 2), normalised(torch.stack([side, torch.ones(n)], dim=1))
    shares = []
    for features in (blind, seeing):
        y_to_x, _ = zoomout(start, start, ops.eigenvectors, ops.eigenvectors, features, features)
        shares.append(float(((y_to_x < n // 2) == (truth < n // 2)).float().mean()))
    assert shares[0] == 0.0 and shares[1] == 1.0, shares


def test_the_identity_is_found_where_only_some_points_take_part(demo_operators) -> None:
    """On 5,000 points, of which the refinement samples fewer, and others on each shape."""
    x = demo_operators[0].eigenvectors
    order = torch.randperm(len(x), generator=torch.Generator().manual_seed(7))
    flat = torch.zeros(len(x), 1)
    start = functional_map_from_point_map(order, x[:, :6], x[order][:, :6], demo_operators[0].mass[order])
    coarse = point_map_from_functional_map(start, x, x[order])
    y_to_x, x_to_y = zoomout(coarse, torch.argsort(order), x, x[order], flat, flat)
    assert (coarse == order).float().mean() < 0.9
    assert (y_to_x == order).float().mean() > 0.97
    assert (x_to_y[order] == torch.arange(len(x))).float().mean() > 0.97


def test_nothing_goes_to_points_that_no_eigenfunction_reaches(blob) -> None:
    n = len(blob.points)
    phi = torch.cat([torch.zeros(5, blob.eigenvectors.shape[1]), blob.eigenvectors])
    features = torch.cat([torch.zeros(5, 3), normalised(blob.points)])
    scattered = torch.randint(n + 5, (n + 5,), generator=torch.Generator().manual_seed(0))
    for found in zoomout(scattered, scattered, phi, phi, features, features):
        assert len(found) == n + 5
        assert found.min() >= 5


def test_where_the_first_eigenfunctions_reach_no_point_features_decide_the_first_round(blob) -> None:
    # As with lone triangles: each of the first eigenfunctions may lie on one of them, and maps on others.
    phi, features = blob.eigenvectors.clone(), normalised(blob.points)
    phi[:, :20] = 0
    same = torch.arange(len(phi))
    y_to_x, x_to_y = zoomout(same.flip(0), same.flip(0), phi, phi, features, features)
    assert torch.equal(y_to_x, same)
    assert torch.equal(x_to_y, same)


def test_fewer_eigenvectors_than_the_first_round_wants_are_used_as_they_are(blob) -> None:
    n = len(blob.points)
    phi, features, same = blob.eigenvectors[:, :12], normalised(blob.points), torch.arange(n)
    y_to_x, x_to_y = zoomout(same, same, phi, blob.eigenvectors, features, features)
    assert torch.equal(y_to_x, same)
    assert torch.equal(x_to_y, same)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("y_to_x", {"y_to_x": torch.tensor([-1] * 642)}),
        ("x_to_y", {"x_to_y": torch.full((642,), 642)}),
        ("features_x", {"features_x": torch.full((642, 2), float("nan"))}),
    ],
)
def test_what_cannot_be_is_named(name: str, change: dict, blob) -> None:
    given = {
        "y_to_x": torch.arange(642),
        "x_to_y": torch.arange(642),
        "eigenvectors_x": blob.eigenvectors,
        "eigenvectors_y": blob.eigenvectors,
        "features_x": torch.zeros(642, 2),
        "features_y": torch.zeros(642, 2),
    }
    with pytest.raises(ArgumentError, match=name):
        zoomout(**{**given, **change})
