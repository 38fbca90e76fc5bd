"""Losses of soft maps against formulas written out slowly in float64, their gradients, and maps that cost nothing."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from homolog.core.errors import ArgumentError
from homolog.geometry import Basis, compute_operators
from homolog.maps.losses import softly_mapped
from homolog.maps.soft_losses import (
    coupling_loss,
    damped_spectrum_loss,
    diffused,
    diffusion_loss,
    map_from_common_points,
    teacher_loss,
    true_map_loss,
)


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def unit(*shape: int, seed: int = 0) -> Tensor:
    return torch.nn.functional.normalize(random(*shape, seed=seed), dim=1)


def small_basis(n: int, k: int, seed: int = 0) -> Basis:
    """With eigenvectors that are orthonormal with respect to the mass."""
    mass = 0.5 + torch.rand(n, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    mass = mass / mass.sum()
    columns = torch.cat([torch.ones(n, 1, dtype=torch.float64), random(n, k - 1, seed=seed)], dim=1)
    orthonormal = torch.linalg.qr(mass.sqrt()[:, None] * columns).Q
    phi = orthonormal / mass.sqrt()[:, None]
    values = torch.arange(k, dtype=torch.float64) * 4.0
    return Basis(random(n, 3), mass, values, phi, random(n, 2, k), (mass[:, None] * phi).T.contiguous())


def slow_soft_map(y: Tensor, x: Tensor, temperature: float) -> np.ndarray:
    rows = []
    for feature in y.numpy():
        weights = np.array([np.exp(feature @ other / temperature) for other in x.numpy()])
        rows.append(weights / weights.sum())
    return np.array(rows)


FEATURES_X, FEATURES_Y = unit(9, 4), unit(7, 4, seed=1)
SOFT = slow_soft_map(FEATURES_Y, FEATURES_X, 0.3)
X, Y = small_basis(9, 5), small_basis(7, 5, seed=3)


def test_functions_are_mapped_softly() -> None:
    functions = random(9, 3, seed=4)
    found = softly_mapped(FEATURES_Y, FEATURES_X, functions, temperature=0.3)
    np.testing.assert_allclose(found, SOFT @ functions.numpy())
    with pytest.raises(ArgumentError, match="temperature is 0, but must be positive"):
        softly_mapped(FEATURES_Y, FEATURES_X, functions, temperature=0)


def test_the_functional_map_of_a_soft_map() -> None:
    c_xy = random(5, 5, seed=5)
    mapped = torch.from_numpy(SOFT) @ X.eigenvectors
    expected = 0.0
    for i in range(5):
        for j in range(5):
            own = sum(Y.mass[p] * Y.eigenvectors[p, i] * mapped[p, j] for p in range(7))
            expected += float((c_xy[i, j] - own) ** 2)
    assert coupling_loss(c_xy, mapped, Y.pseudo_inverse).item() == pytest.approx(expected)
    assert coupling_loss(Y.pseudo_inverse @ mapped, mapped, Y.pseudo_inverse) < 1e-24


def test_the_map_of_points_that_correspond() -> None:
    """A rotation of functions is found again, from more points than functions."""
    turn = torch.linalg.qr(random(4, 4, seed=6)).Q
    phi_y = random(30, 4, seed=7)
    found = map_from_common_points(phi_y @ turn, phi_y)
    torch.testing.assert_close(found, turn)
    assert true_map_loss(found, turn) < 1e-20
    shifted = turn.clone()
    shifted[1, 2] += 0.5
    assert true_map_loss(shifted, found).item() == pytest.approx(0.25)
    with pytest.raises(ArgumentError, match="3 points correspond, but a functional map of 4 eigenvectors"):
        map_from_common_points(phi_y[:3], phi_y[:3])


def test_the_loss_of_a_teacher() -> None:
    y_to_x = torch.tensor([3, 0, 8, 8, 1, 2, 5])
    expected = -np.mean([np.log(SOFT[row, column]) for row, column in enumerate(y_to_x)])
    assert teacher_loss(FEATURES_Y, FEATURES_X, y_to_x, temperature=0.3).item() == pytest.approx(expected)
    order = torch.randperm(9, generator=torch.Generator().manual_seed(0))
    assert teacher_loss(FEATURES_X[order], FEATURES_X, order, temperature=0.01) < 0.01


def slowly_diffused(basis: Basis, function: np.ndarray, time: float) -> np.ndarray:
    total = np.zeros(len(function))
    for number in range(len(basis.eigenvalues)):
        phi = basis.eigenvectors[:, number].numpy()
        total += np.exp(-time * float(basis.eigenvalues[number])) * (basis.mass.numpy() * phi) @ function * phi
    return total


def test_diffusion_of_random_functions() -> None:
    coefficients, times = random(5, 4, seed=8), torch.tensor([0.0, 0.01, 0.1, 0.3], dtype=torch.float64)
    expected = 0.0
    for c in range(4):
        function = X.eigenvectors.numpy() @ coefficients[:, c].numpy()
        there = SOFT @ slowly_diffused(X, function, float(times[c]))
        back = slowly_diffused(Y, SOFT @ function, float(times[c]))
        expected += float((Y.mass.numpy() * (there - back) ** 2).sum()) / 4
    found = diffusion_loss(FEATURES_Y, FEATURES_X, Y, X, coefficients, times, temperature=0.3)
    assert found.item() == pytest.approx(expected)
    assert expected > 0.01


def slow_damped(sizes: tuple[int, ...], damping: float) -> float:
    total = 0.0
    for size in sizes:
        psi = {}
        for name, basis in (("x", X), ("y", Y)):
            exponents = damping * basis.eigenvalues[:size].numpy() / float(basis.eigenvalues[size - 1])
            psi[name] = basis.eigenvectors[:, :size].numpy() * np.exp(-exponents)
        root = np.sqrt(Y.mass.numpy())[:, None]
        carried = SOFT @ psi["x"]
        c_xy = np.linalg.lstsq(root * psi["y"], root * carried, rcond=None)[0]
        total += ((root * (psi["y"] - carried @ c_xy.T)) ** 2).sum() / ((root * psi["y"]) ** 2).sum()
    return total


def test_damped_eigenfunctions() -> None:
    for sizes, cut, damping in (((3,), (3,), 2.0), ((3, 4, 9), (3, 4, 5), 1.0), ((8, 9), (5,), 0.0)):
        found = damped_spectrum_loss(FEATURES_Y, FEATURES_X, Y, X, damping=damping, sizes=sizes, temperature=0.3)
        assert found.item() == pytest.approx(slow_damped(cut, damping)), sizes
    with pytest.raises(ArgumentError, match="temperature is 0"):
        damped_spectrum_loss(FEATURES_Y, FEATURES_X, Y, X, temperature=0)


def test_a_shape_and_itself_in_another_order_cost_nothing(make) -> None:
    """Features that name each point make an exact map of an isometry."""
    basis = compute_operators(make.blob(2)).basis.truncated(40)
    order = torch.randperm(basis.n_points, generator=torch.Generator().manual_seed(0))
    other = Basis(
        basis.points[order],
        basis.mass[order],
        basis.eigenvalues,
        basis.eigenvectors[order],
        basis.gradients[order],
        basis.pseudo_inverse[:, order],
    )
    names = torch.eye(basis.n_points)
    coefficients, times = torch.randn(40, 8), torch.rand(8) / 100

    def losses(of_y: Tensor) -> list[float]:
        mapped = softly_mapped(of_y, names, basis.eigenvectors, temperature=0.01)
        return [
            coupling_loss(torch.eye(40), mapped, other.pseudo_inverse).item(),
            diffusion_loss(of_y, names, other, basis, coefficients, times, temperature=0.01).item(),
            damped_spectrum_loss(of_y, names, other, basis, temperature=0.01).item(),
        ]

    assert max(losses(names[order])) < 1e-6
    assert min(losses(names)) > 1e-3  # the wrong map


def test_gradients_are_those_of_differences() -> None:
    coefficients, times = random(5, 3, seed=8), torch.tensor([0.01, 0.1, 0.3], dtype=torch.float64)
    c_xy, target = random(5, 5, seed=5), torch.tensor([3, 0, 8, 8, 1, 2, 5])

    def coupled(y: Tensor, x: Tensor, c: Tensor) -> Tensor:
        return coupling_loss(c, softly_mapped(y, x, X.eigenvectors, temperature=0.3), Y.pseudo_inverse)

    given = FEATURES_Y.clone().requires_grad_(), FEATURES_X.clone().requires_grad_()
    assert torch.autograd.gradcheck(coupled, (*given, c_xy.requires_grad_()))
    for loss in (
        lambda y, x: teacher_loss(y, x, target, temperature=0.3),
        lambda y, x: diffusion_loss(y, x, Y, X, coefficients, times, temperature=0.3),
        lambda y, x: damped_spectrum_loss(y, x, Y, X, sizes=(3, 5), temperature=0.3),
    ):
        assert torch.autograd.gradcheck(loss, given)


def test_diffusion_keeps_constants_and_smooths() -> None:
    ones = torch.ones(9, 1, dtype=torch.float64)
    torch.testing.assert_close(diffused(X, ones, torch.tensor([0.5], dtype=torch.float64)), ones)
    rough = X.eigenvectors[:, -1:]
    after = diffused(X, rough, torch.tensor([0.1], dtype=torch.float64))
    torch.testing.assert_close(after, rough * np.exp(-1.6))
