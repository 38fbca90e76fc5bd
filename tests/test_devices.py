"""What takes tensors gives on every device and in either precision what float64 on the CPU gives, gradients included.

What the values are to be is for the tests of each function; here they must lie where the arguments lie.
"""

from __future__ import annotations

import inspect
from dataclasses import fields, is_dataclass

import pytest
import torch
from torch import Tensor

from homolog import maps
from homolog.features import DiffusionNet, NetworkSettings
from homolog.geometry import Operators, OperatorSettings, compute_operators
from homolog.maps import losses

CPU = torch.device("cpu")


def random(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def unit(*shape, seed=0):
    return torch.nn.functional.normalize(random(*shape, seed=seed), dim=1)


def indices(count, largest, seed=0):
    return torch.randint(largest, (count,), generator=torch.Generator().manual_seed(seed))


# Two shapes of 50 and 40 points with 12 and 10 eigenpairs, three times as many points in space, and a map between them.
VALUES = random(12, seed=1).abs().cumsum(0) * 20, random(10, seed=2).abs().cumsum(0) * 20
PHI = tuple(torch.linalg.qr(random(n, k, seed=n)).Q * n**0.5 for n, k in ((50, 12), (40, 10)))
FEATURES = unit(50, 6, seed=3), unit(40, 6, seed=4)
POINTS = 0.3 * random(50, 3, seed=5), 0.3 * random(40, 3, seed=6)
C_XY, C_YX = random(10, 12, seed=7), random(12, 10, seed=8)
Y_TO_X, X_TO_Y = indices(40, 50), indices(50, 40, seed=1)

# Name and arguments of each function of tensors; a name may come twice.
FUNCTIONS = [
    (maps.confidence, (POINTS[1], POINTS[0], Y_TO_X, X_TO_Y)),
    (maps.cycle_error, (POINTS[1], Y_TO_X, X_TO_Y)),
    (maps.functional_map, (random(12, 20), random(10, 20, seed=1), random(10, 12, seed=2).abs())),
    (maps.functional_map_from_point_map, (Y_TO_X, *PHI, random(40).abs())),
    (maps.heat_kernel_signature, (VALUES[0], PHI[0])),
    (maps.local_stretch, (POINTS[0], random(50, 3), indices(50 * 4, 50).reshape(50, 4))),
    (maps.most_similar, FEATURES),
    (maps.nearest_neighbour, POINTS),
    (maps.normalised, (random(20, 5),)),
    (maps.point_map_from_functional_map, (C_XY, *PHI)),
    (maps.principal_rotations, POINTS),
    (maps.registered_positions, POINTS),
    (maps.resolvent_mask, VALUES),
    (maps.best_rotation, (POINTS[0], POINTS[0] @ torch.linalg.qr(random(3, 3)).Q.T)),
    (maps.handedness, (POINTS[0], POINTS[0] @ torch.linalg.qr(random(3, 3)).Q.T)),
    (maps.rotation_angle, (torch.eye(3),)),
    (maps.rigid_motion, (POINTS[0], POINTS[0] @ torch.linalg.qr(random(3, 3)).Q.T + 1)),
    (maps.best_similarity, (POINTS[0], 2 * POINTS[0] @ torch.linalg.qr(random(3, 3)).Q.T + 1)),
    (maps.closest_point_similarity, (POINTS[0], POINTS[0] + 0.01)),
    (maps.neighbourhoods, (POINTS[0], 5)),
    (maps.sinkhorn_matches, FEATURES),
    (maps.wave_kernel_signature, (VALUES[0], PHI[0])),
    (maps.zoomout, (Y_TO_X, X_TO_Y, *PHI, *FEATURES)),
    (maps.zoomout_partial, (Y_TO_X, *PHI, *VALUES, *FEATURES)),
    (losses.bijectivity_loss, (C_XY, C_YX)),
    (losses.orthogonality_loss, (C_XY, C_YX)),
    (losses.commutativity_loss, (C_XY, *VALUES)),
    (losses.descriptor_loss, (C_XY, random(12, 4, 12), random(10, 4, 10, seed=1))),
    (losses.multiplication_operators, (POINTS[0], PHI[0], PHI[0].T)),
    (losses.smoothness_loss, (C_XY, random(12, 3), random(10, 3, seed=1), VALUES[1])),
    (losses.alignment_loss, (C_XY, *PHI, *FEATURES)),
    (losses.partial_alignment_loss, (C_XY, *PHI, *FEATURES)),
    (losses.registration_loss, (*FEATURES, *POINTS)),
    (losses.infonce_loss, (FEATURES[0], unit(50, 6, seed=9))),
]
# These take operators, see below; surfaces, which are numpy, or their points; transforms; lists; or are no functions.
OTHERS = {
    "coarse_fit",
    "surface_handedness",
    "closest_point_rotations",
    "composed",
    "registered_surfaces",
    "registration_start",
    "coverage",
    "coverage_density",
    "dirichlet_energy",
    "distinct_rotations",
    "flipped_triangles",
    "joint_rotations",
    "overlap",
    "smooth_dirichlet_energy",
    "smoothed_positions",
}


def test_none_is_left_out():
    named = {name for name in maps.__all__ if inspect.isfunction(getattr(maps, name))}
    assert named == {function.__name__ for function, _ in FUNCTIONS if hasattr(maps, function.__name__)} | OTHERS


def moved(value, device, dtype):
    if not isinstance(value, Tensor):
        return value
    return value.to(device, dtype if value.is_floating_point() else None)


def tensors(result):
    """The tensors of a result, which may be one, several, or a dataclass of them."""
    if is_dataclass(result):
        values = (getattr(result, field.name) for field in fields(result))
        return [value for value in values if isinstance(value, Tensor)]
    return list(result) if isinstance(result, tuple) else [result]


def assert_same(found, expected, device, dtype, *, tolerance=1e-9):
    """Where it should be; equal but for rounding, and for near ties, which that decides."""
    tolerance = tolerance if dtype == torch.float64 else 2e-3
    for one, other in zip(found, expected, strict=True):
        assert one.device.type == device.type
        if not other.is_floating_point():
            assert not one.is_floating_point()
            assert (one.cpu() == other).double().mean() > 0.95
        else:
            assert one.dtype == dtype
            size = float(other.double().abs().max())
            torch.testing.assert_close(one.cpu().double(), other.double(), rtol=tolerance, atol=tolerance * size)


@pytest.mark.parametrize(("function", "given"), FUNCTIONS, ids=lambda value: getattr(value, "__name__", ""))
def test_functions(function, given, device, dtype):
    given = [moved(value, CPU, dtype) for value in given]  # rounded first, so that only the arithmetic differs
    expected = tensors(function(*(moved(value, CPU, torch.float64) for value in given)))
    found = tensors(function(*(moved(value, device, dtype) for value in given)))
    assert_same(found, expected, device, dtype)


DIFFERENTIABLE = [(f, given) for f, given in FUNCTIONS if f.__name__.endswith("_loss") or f is maps.functional_map]


@pytest.mark.parametrize(("function", "given"), DIFFERENTIABLE, ids=lambda value: getattr(value, "__name__", ""))
def test_gradients(function, given, device, dtype):
    def gradients(device, dtype):
        values = [moved(value, device, dtype).requires_grad_() for value in given]
        return torch.autograd.grad(function(*values).sum(), values, allow_unused=True)

    expected, found = gradients(CPU, torch.float64), gradients(device, dtype)
    assert [one is None for one in found] == [one is None for one in expected]
    pairs = [(one, other) for one, other in zip(found, expected, strict=True) if other is not None]
    assert_same([one for one, _ in pairs], [other for _, other in pairs], device, dtype, tolerance=1e-7)


@pytest.fixture(scope="module")
def operators(make) -> Operators:
    return compute_operators(make.blob(2), settings=OperatorSettings(n_eigenpairs=24))


def test_functions_of_operators(operators, device):
    on_device = operators.to(device)
    point_map, mass = indices(162, 162), operators.mass
    for function, given in (
        (maps.smoothed_positions, ()),
        (maps.coverage_density, (mass, point_map)),
    ):
        found = function(on_device, *(value.to(device) for value in given))
        assert_same([found], [function(operators, *given)], device, torch.float32)
    covered = maps.overlap(on_device, on_device, point_map.to(device))
    assert_same([covered], [maps.overlap(operators, operators, point_map)], device, torch.float32)
    points = random(162, 3).float()
    energy = maps.dirichlet_energy(on_device, points.to(device), point_map.to(device))
    assert energy == pytest.approx(maps.dirichlet_energy(operators, points, point_map), rel=1e-4)
    on_basis, basis = on_device.basis, operators.basis
    smooth = maps.smooth_dirichlet_energy(on_basis, on_basis, point_map.to(device))
    assert smooth == pytest.approx(maps.smooth_dirichlet_energy(basis, basis, point_map), rel=1e-3)
    share = maps.coverage(on_device, on_device, point_map.to(device))
    assert share == pytest.approx(maps.coverage(operators, operators, point_map), abs=0.01)


def test_operators_and_their_basis_move_whole(operators, device):
    on_device = operators.to(device)
    for name in ("points", "mass", "eigenvalues", "eigenvectors", "laplacian", "gradient_x", "gradient_y"):
        assert getattr(on_device, name).device.type == device.type, name
    samples = indices(100, 162).unique()
    functions = random(len(samples), 4).float()
    found = on_device.basis.sampled(samples.to(device)).pseudo_inverse @ functions.to(device)
    assert_same([found], [operators.basis.sampled(samples).pseudo_inverse @ functions], device, torch.float32)


def test_the_network_and_its_gradients(operators, device):
    torch.manual_seed(0)
    network = DiffusionNet(NetworkSettings(width=16, out_channels=8, blocks=2)).eval()

    def of(device):
        moved, shape = network.to(device), operators.to(device)
        features = moved(shape.points, shape)
        gradients = torch.autograd.grad(features.square().mean(), list(moved.parameters()))
        return [features.detach(), *gradients]

    expected = [value.clone() for value in of(CPU)]
    assert_same(of(device), expected, device, torch.float32)
