"""Functional maps against slow references, and what their directions mean."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from homolog.core.errors import ArgumentError
from homolog.geometry import Operators, OperatorSettings, compute_operators
from homolog.maps import (
    functional_map,
    functional_map_from_point_map,
    point_map_from_functional_map,
    reference,
    resolvent_mask,
)
from homolog.shapes import Shape


def random(*shape: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=dtype)


@pytest.fixture(scope="module")
def eigenvalues() -> tuple[Tensor, Tensor]:
    x = torch.cat([torch.zeros(1), random(11).abs().float().cumsum(0) * 20])
    y = torch.cat([torch.zeros(1), random(8, seed=1).abs().float().cumsum(0) * 30])
    return x, y


@pytest.mark.parametrize("gamma", [0.5, 1.0])
def test_the_mask_is_the_distance_of_resolvents(gamma: float, eigenvalues) -> None:
    x, y = eigenvalues
    mask = resolvent_mask(x, y, gamma=gamma)
    assert mask.shape == (9, 12)
    expected = reference.resolvent_mask(x.double(), y.double(), gamma=gamma)
    torch.testing.assert_close(mask.double(), expected, atol=1e-6, rtol=0)


def test_the_mask_has_symmetric_roles_no_scale_and_a_zero_for_equal_values(eigenvalues) -> None:
    x, y = eigenvalues
    mask = resolvent_mask(x, y)
    torch.testing.assert_close(resolvent_mask(y, x), mask.T, atol=0, rtol=0)
    torch.testing.assert_close(resolvent_mask(1000 * x, 1000 * y), mask, atol=1e-6, rtol=1e-5)
    assert resolvent_mask(torch.zeros(1), torch.zeros(1)) == 0  # the constants of two shapes
    assert (resolvent_mask(x, x).diagonal() == 0).all()
    assert (mask >= 0).all() and mask[0, 0] == 0
    # Rounding below zero counts as zero.
    below, zero = (resolvent_mask(torch.tensor([value, 5.0]), y) for value in (-1e-9, 0.0))
    assert torch.equal(below, zero)


@pytest.mark.parametrize("regularisation", [0.0, 1e-3, 1.0, 100.0])
def test_the_map_and_its_reference_are_least_squares_row_by_row(regularisation: float, eigenvalues) -> None:
    a, b, mask = random(12, 30), random(9, 30, seed=1), resolvent_mask(*eigenvalues).double()
    expected = []
    for row, penalty in zip(b.numpy(), mask.numpy(), strict=True):  # without normal equations
        system = np.vstack([a.numpy().T, np.diag(np.sqrt(regularisation * penalty))])
        expected.append(np.linalg.lstsq(system, np.concatenate([row, np.zeros(12)]), rcond=None)[0])
    for function in (functional_map, reference.functional_map):
        found = function(a, b, mask, regularisation=regularisation)
        np.testing.assert_allclose(found, np.stack(expected), rtol=1e-7, atol=1e-9)


def test_single_precision_features_give_the_same_map(eigenvalues) -> None:
    a, b, mask = random(12, 30).float(), random(9, 30, seed=1).float(), resolvent_mask(*eigenvalues)
    found = functional_map(a, b, mask)
    assert found.dtype == torch.float32
    torch.testing.assert_close(found, reference.functional_map(a, b, mask), rtol=1e-4, atol=1e-5)
    arrays = functional_map(a.numpy(), b.numpy(), mask.numpy())
    assert isinstance(arrays, np.ndarray)
    np.testing.assert_array_equal(arrays, found)


def test_a_batch_equals_a_loop() -> None:
    a, b = random(2, 3, 7, 20), random(2, 3, 5, 20, seed=1)
    x, y = random(2, 3, 7, seed=2).abs(), random(2, 3, 5, seed=3).abs()
    masks = resolvent_mask(x, y)
    found = functional_map(a, b, masks, regularisation=3.0)
    assert masks.shape == found.shape == (2, 3, 5, 7)
    for i in range(2):
        for j in range(3):
            torch.testing.assert_close(masks[i, j], resolvent_mask(x[i, j], y[i, j]))
            torch.testing.assert_close(found[i, j], functional_map(a[i, j], b[i, j], masks[i, j], regularisation=3.0))
    torch.testing.assert_close(found, reference.functional_map(a, b, masks, regularisation=3.0))
    torch.testing.assert_close(masks, reference.resolvent_mask(x, y))


def test_gradients_are_right() -> None:
    a, b, mask = random(4, 6), random(3, 6, seed=1), random(3, 4, seed=2).abs()
    inputs = [tensor.requires_grad_() for tensor in (a, b, mask)]
    assert torch.autograd.gradcheck(lambda a, b, m: functional_map(a, b, m, regularisation=0.7), inputs)
    assert torch.autograd.gradgradcheck(lambda a, b, m: functional_map(a, b, m, regularisation=0.7), inputs)


def test_equal_features_give_the_identity() -> None:
    a = random(10, 40)
    values = torch.linspace(0, 50, 10, dtype=torch.float64)
    identity = torch.eye(10, dtype=torch.float64)
    torch.testing.assert_close(functional_map(a, a, resolvent_mask(values, values), regularisation=1e-9), identity)
    # The mask does not weigh on the diagonal, so that no strength of it can change an identity.
    torch.testing.assert_close(functional_map(a, a, resolvent_mask(values, values), regularisation=100.0), identity)


@pytest.mark.parametrize("seed", range(40))
def test_an_undetermined_map_is_refused(seed: int) -> None:
    k = 5 + 2 * seed
    a, b = random(k, k - 1, seed=seed).float(), random(k, k - 1, seed=seed + 1).float()
    with pytest.raises(ArgumentError, match="larger regularisation"):
        functional_map(a, b, torch.ones(k, k), regularisation=0.0)


def test_features_without_content_or_not_finite_are_refused() -> None:
    broken = random(4, 9)
    broken[1, 2] = torch.nan
    for a in (torch.zeros(4, 9, dtype=torch.float64), broken):
        with pytest.raises(ArgumentError):
            functional_map(a, random(4, 9), torch.ones(4, 4, dtype=torch.float64), regularisation=0.0)


# --- directions, on a shape and a relabelled copy: point i of y is point order[i] of x


@pytest.fixture(scope="module")
def copies(make) -> tuple[Operators, Operators, Tensor]:
    x = make.blob(3)
    order = np.random.default_rng(3).permutation(x.n_points)
    settings = OperatorSettings(n_eigenpairs=40)
    pair = [compute_operators(shape, settings=settings) for shape in (x, make.relabelled(x, order))]
    return pair[0], pair[1], torch.from_numpy(order)


def features(operators: Operators) -> Tensor:
    """Functions that depend on the place alone."""
    centres = random(60, 3, dtype=torch.float32) * 0.4
    return torch.exp(-20 * (operators.points[:, None] - centres).square().sum(dim=2))


def test_c_xy_takes_functions_on_x_to_y_and_y_to_x_gives_points_of_x(copies) -> None:
    x, y, order = copies
    x, y = x.truncated(30), y.truncated(40)
    assert torch.equal(y.points, x.points[order])
    # Features without any part outside the basis of x; else C would also explain that part, by chance.
    on_x = x.eigenvectors @ x.coefficients(features(x))
    a, b = x.coefficients(on_x), y.coefficients(on_x[order])
    c_xy = functional_map(a, b, resolvent_mask(x.eigenvalues, y.eigenvalues), regularisation=1e-6)
    assert c_xy.shape == (40, 30)
    # A smooth function on x, carried over, is the same function on y.
    wanted = random(30, dtype=torch.float32) * torch.exp(-0.02 * x.eigenvalues)
    on_x = x.eigenvectors @ wanted
    on_y = y.eigenvectors @ (c_xy @ wanted)
    torch.testing.assert_close(on_y, on_x[order], atol=0.01 * float(on_x.abs().max()), rtol=0)
    y_to_x = point_map_from_functional_map(c_xy, x.eigenvectors, y.eigenvectors)
    assert y_to_x.shape == order.shape and y_to_x.dtype == torch.int64
    assert (y_to_x == order).float().mean() > 0.99


def test_a_point_map_and_its_functional_map_are_one(copies) -> None:
    x, y, order = copies
    c_xy = functional_map_from_point_map(order, x.eigenvectors[:, :25], y.eigenvectors[:, :35], y.mass)
    assert c_xy.shape == (35, 25)
    # Pulling back functions of x along y_to_x: (Pi f)(i) = f(order[i]).
    torch.testing.assert_close(y.eigenvectors[:, :35] @ c_xy, x.eigenvectors[:, :25][order], atol=5e-3, rtol=0)
    assert torch.equal(point_map_from_functional_map(c_xy, x.eigenvectors, y.eigenvectors), order)


@pytest.mark.parametrize(("k_y", "k_x"), [(7, 5), (4, 8), (6, 6)])
def test_the_point_map_is_the_nearest_row_by_brute_force(k_y: int, k_x: int) -> None:
    x, y, c_xy = random(70, 9), random(50, 12, seed=1), random(k_y, k_x, seed=2)
    carried = x[:, :k_x].numpy() @ c_xy.numpy().T
    expected = [np.argmin(((carried - row) ** 2).sum(axis=1)) for row in y[:, :k_y].numpy()]
    np.testing.assert_array_equal(point_map_from_functional_map(c_xy, x, y), expected)


# --- the numbers of the published code


@pytest.mark.reference
def test_maps_between_meshes_are_those_of_the_published_code(faust, stored_operators) -> None:
    x, y = (stored_operators(f"{side}_mesh").truncated(80) for side in "xy")
    a, b = (ops.coefficients(torch.from_numpy(faust[f"{s}_mesh_features"])) for s, ops in (("x", x), ("y", y)))
    mask = resolvent_mask(x.eigenvalues, y.eigenvalues)
    c_xy, c_yx = functional_map(a, b, mask), functional_map(b, a, mask.T)
    for found, name in ((c_xy, "Cxy"), (c_yx, "Cyx")):
        assert np.linalg.norm(found.numpy() - faust[name]) < 1e-3 * np.linalg.norm(faust[name])
    y_to_x = point_map_from_functional_map(c_xy, x.eigenvectors, y.eigenvectors).numpy()
    assert (y_to_x == faust["mesh_p2p_y_to_x"]).mean() >= 0.999


@pytest.mark.reference
@pytest.mark.parametrize("which", ["x_mesh", "y_cloud"])
def test_operators_of_the_same_shape_are_those_of_the_published_code(which: str, faust, stored_operators) -> None:
    stored, side = stored_operators(which), which[0]
    shape = Shape(faust[f"{side}_vertices"], faust[f"{side}_faces"] if which == "x_mesh" else None)
    own = compute_operators(shape, scale=1.0, settings=OperatorSettings(laplacian="cotangent", n_neighbours=30))
    torch.testing.assert_close(own.mass, stored.mass, rtol=1e-4, atol=0)
    # Theirs is shifted by some 1e-8 of the Laplacian's size, which shows in the lowest.
    torch.testing.assert_close(own.eigenvalues, stored.eigenvalues, rtol=1e-4, atol=1e-4)
    overlap = (own.eigenvectors * stored.eigenvectors * own.mass[:, None]).sum(dim=0).abs()
    assert (overlap[:80] > 0.999).all()
    values = torch.cos(20 * stored.points)
    sizes = [torch.hypot(ops.gradient_x @ values, ops.gradient_y @ values) for ops in (own, stored)]
    # Tangent planes agree but for the clouds' neighbours at equal distances.
    assert ((sizes[0] - sizes[1]).abs() < 1e-2 * (1 + sizes[1])).float().mean() > 0.999


@pytest.fixture(scope="module")
def david(reference) -> dict[str, Tensor]:
    with np.load(reference / "cuts_david.npz") as stored:
        return {name: torch.from_numpy(stored[name]) for name in stored.files}


@pytest.mark.reference
def test_maps_with_a_partial_shape_are_those_of_the_published_code(david) -> None:
    complete, partial = (
        david[f"{side}_evecs"].T @ (david[f"{side}_mass"][:, None] * david[f"{side}_features"])
        for side in ("complete", "partial")
    )
    mask = resolvent_mask(david["complete_evals"], david["partial_evals"])
    pairs = (
        (functional_map(complete, partial, mask), david["C_complete_partial"]),
        (functional_map(partial, complete, mask.T), david["C_partial_complete"]),
    )
    for found, expected in pairs:
        assert (found - expected).norm() < 1e-3 * expected.norm()
