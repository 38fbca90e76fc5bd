"""The eigenbasis at all points of a shape, and at samples."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from homolog.features import DiffusionNet, NetworkSettings
from homolog.geometry import Basis, Operators, OperatorSettings, compute_operators
from homolog.shapes.sampling import farthest_points

WANTED = OperatorSettings(n_eigenpairs=24)
SMALL = NetworkSettings(width=16, out_channels=8, blocks=2)


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


@pytest.fixture(scope="module", params=["mesh", "cloud"])
def operators(request, make) -> Operators:
    blob = make.blob(3)
    return compute_operators(blob if request.param == "mesh" else blob.as_cloud(), settings=WANTED)


@pytest.fixture(scope="module")
def basis(operators: Operators) -> Basis:
    return operators.basis


def synthesis(basis: Basis) -> Tensor:
    """What takes coefficients to functions and to both components of their gradients (n, 3, k)."""
    return torch.cat([basis.eigenvectors[:, None], basis.gradients], dim=1)


def spread(basis: Basis, count: int) -> Tensor:
    return torch.from_numpy(farthest_points(basis.points.numpy(), count, seed=0))


def relative_error(found: Tensor, true: Tensor) -> float:
    return float((found - true).norm() / true.norm())


def test_a_basis_takes_coefficients_to_functions_and_their_gradients_and_back(operators: Operators) -> None:
    basis = operators.basis
    coefficients, values = random(24, 5), random(operators.n_points, 5, seed=1)
    functions = operators.eigenvectors @ coefficients
    torch.testing.assert_close(basis.eigenvectors @ coefficients, functions)
    for component, gradient in ((1, operators.gradient_x), (2, operators.gradient_y)):
        expected = gradient.to_dense() @ functions
        torch.testing.assert_close(synthesis(basis)[:, component] @ coefficients, expected, atol=1e-3, rtol=1e-4)
    torch.testing.assert_close(basis.pseudo_inverse @ values, operators.coefficients(values))
    torch.testing.assert_close(basis.pseudo_inverse @ functions, coefficients, atol=1e-4, rtol=1e-4)
    assert basis.n_points == operators.n_points and operators.basis is basis
    assert synthesis(operators.truncated(7).basis).shape == (operators.n_points, 3, 7)


def test_samples_keep_eigenvectors_gradients_and_order(basis: Basis) -> None:
    kept = torch.tensor([7, 400, 3, 200, *range(500, 600)])
    samples = basis.sampled(kept)
    assert torch.equal(synthesis(samples), synthesis(basis)[kept]) and torch.equal(samples.points, basis.points[kept])
    assert torch.equal(samples.eigenvalues, basis.eigenvalues) and samples.pseudo_inverse.shape == (24, 104)


@pytest.mark.parametrize("count", [30, 100, 400])
def test_samples_give_the_coefficients_of_what_the_eigenvectors_span(count: int, basis: Basis) -> None:
    kept, coefficients = spread(basis, count), random(24, 5)
    functions = basis.eigenvectors @ coefficients
    # But for the ridge, of 1e-4.
    assert relative_error(basis.sampled(kept).pseudo_inverse @ functions[kept], coefficients) < 3e-4
    everywhere = basis.sampled(torch.arange(basis.n_points))
    assert relative_error(everywhere.pseudo_inverse, basis.pseudo_inverse) < 2e-4


def test_other_functions_are_fitted_by_least_squares_weighted_with_the_mass(basis: Basis) -> None:
    kept = torch.from_numpy(np.random.default_rng(0).choice(basis.n_points, 90, replace=False))
    samples, values = basis.sampled(kept), random(90, 4)
    root = samples.mass.double().sqrt()[:, None]
    expected = torch.linalg.lstsq(root * samples.eigenvectors.double(), root * values.double()).solution
    assert relative_error((samples.pseudo_inverse @ values).double(), expected) < 1e-2
    unweighted = torch.linalg.lstsq(samples.eigenvectors.double(), values.double()).solution
    assert relative_error((samples.pseudo_inverse @ values).double(), unweighted) > 0.1


def test_fewer_samples_than_eigenvectors_still_give_bounded_coefficients(basis: Basis) -> None:
    samples = basis.sampled(spread(basis, 10))
    values = samples.eigenvectors @ random(24, 3)
    assert relative_error(samples.eigenvectors @ (samples.pseudo_inverse @ values), values) < 1e-2
    assert (samples.pseudo_inverse @ values).norm() < 2 * random(24, 3).norm()


def test_samples_of_a_small_part_give_bounded_coefficients_even_for_noise(basis: Basis) -> None:
    kept = (basis.points - basis.points[5]).norm(dim=1).argsort()[:60]
    samples = basis.sampled(kept)
    weighted = samples.mass.sqrt()[:, None] * samples.eigenvectors
    # No singular value s of these leads to more than s / (s^2 + ridge), which is at most 1 / (2 sqrt(ridge)).
    ridge = 1e-4 * weighted.square().sum() / 24
    gain = torch.linalg.matrix_norm(samples.pseudo_inverse / samples.mass.sqrt(), ord=2)
    assert gain <= 1.001 / (2 * ridge.sqrt())
    assert 1 / torch.linalg.svdvals(weighted).min() > 10 * gain


def test_every_point_s_mass_goes_to_its_nearest_sample(basis: Basis) -> None:
    kept = spread(basis, 60)
    nearest = torch.cdist(basis.points.double(), basis.points[kept].double()).argmin(dim=1)
    expected = torch.stack([basis.mass[nearest == i].sum() for i in range(60)])
    mass = basis.sampled(kept).mass
    torch.testing.assert_close(mass, expected, rtol=1e-5, atol=0)
    torch.testing.assert_close(mass.sum(), basis.mass.sum(), rtol=1e-5, atol=0)


def test_features_at_samples_are_those_of_the_whole_shape(basis: Basis) -> None:
    torch.manual_seed(0)
    network = DiffusionNet(SMALL).eval()
    with torch.no_grad():
        for block in network.blocks:
            block.times.uniform_(0, 0.05)
            block.real.weight.mul_(3)
            block.imaginary.weight.mul_(3)
        everywhere = network(basis.points, basis)
        for count, tolerance in ((48, 5e-3), (100, 2e-3), (400, 2e-3)):
            kept = spread(basis, count)
            samples = basis.sampled(kept)
            error = (network(samples.points, samples) - everywhere[kept]).norm()
            # Quadrature by the samples' masses errs ten times as much.
            assert error < tolerance * (everywhere[kept] - everywhere.mean(dim=0)).norm()


def test_a_basis_made_in_inference_mode_can_be_trained_with(make) -> None:
    blob = make.blob(1)
    outside = compute_operators(blob, settings=WANTED)
    kept = torch.arange(0, blob.n_points, 2)
    with torch.inference_mode():
        inside = compute_operators(blob, settings=WANTED)
        bases = outside.basis, outside.basis.sampled(kept), inside.truncated(10).basis, inside.basis.to("cpu")
    for basis in (*bases, inside.basis, inside.basis.sampled(kept)):
        network = DiffusionNet(SMALL)
        network(basis.points, basis).square().sum().backward()
        assert all(p.grad is not None and torch.isfinite(p.grad).all() for p in network.parameters())


def test_a_basis_goes_to_a_device_whole(basis: Basis) -> None:
    moved = basis.to("meta")
    tensors = moved.points, moved.mass, moved.eigenvalues, moved.eigenvectors, moved.gradients, moved.pseudo_inverse
    assert all(tensor.device.type == "meta" for tensor in tensors)
    assert moved.pseudo_inverse.shape == basis.pseudo_inverse.shape and moved.gradients.shape == basis.gradients.shape
