"""Confidence in a map, and the overlap of a partial and a full shape; descriptors that need no learning."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from homolog.core.errors import ArgumentError
from homolog.geometry import Operators, OperatorSettings, compute_operators
from homolog.maps import (
    ConfidenceSettings,
    confidence,
    coverage_density,
    neighbourhoods,
    overlap,
    smoothed_positions,
    wave_kernel_signature,
)
from homolog.shapes import Shape


@pytest.fixture(scope="module")
def blob(make) -> Operators:
    return compute_operators(make.blob(3), settings=OperatorSettings(n_eigenpairs=40))


def slow_confidence(y: np.ndarray, x: np.ndarray, y_to_x: np.ndarray, x_to_y: np.ndarray) -> np.ndarray:
    """Point by point, over its twenty nearest neighbours and itself."""
    home = np.array([np.linalg.norm(y[i] - y[x_to_y[y_to_x[i]]]) for i in range(len(y))])
    values = []
    for point in range(len(y)):
        near = np.argsort(np.linalg.norm(y - y[point], axis=1), kind="stable")[:21]
        stretch = [abs(np.linalg.norm(x[y_to_x[i]] - x[y_to_x[point]]) - np.linalg.norm(y[i] - y[point])) for i in near]
        values.append(np.exp(-(np.mean(home[near]) + np.mean(stretch)) / 0.1))
    return np.array(values)


def test_confidence_equals_a_loop_over_the_points() -> None:
    rng = np.random.default_rng(0)
    y, x = 0.2 * rng.standard_normal((60, 3)), 0.2 * rng.standard_normal((80, 3))
    y_to_x, x_to_y = rng.integers(0, 80, 60), rng.integers(0, 60, 80)
    found = confidence(*(torch.from_numpy(array) for array in (y, x, y_to_x, x_to_y)))
    np.testing.assert_allclose(found, slow_confidence(y, x, y_to_x, x_to_y), rtol=1e-9)


def test_a_true_map_is_trusted_and_a_scrambled_part_of_it_is_not(demo, demo_operators) -> None:
    boris = demo_operators[1].points
    identity = torch.arange(len(boris))
    trusted = confidence(boris, boris, identity, identity)
    assert (trusted <= 1).all() and (trusted > 0.999).all()
    scrambled = identity.clone()
    upper = torch.nonzero(boris[:, 1] > boris[:, 1].quantile(0.8)).flatten()
    scrambled[upper] = upper[torch.randperm(len(upper), generator=torch.Generator().manual_seed(0))]
    doubted = confidence(boris, boris, scrambled, identity)
    inside = torch.zeros(len(boris), dtype=torch.bool)
    inside[upper] = True
    assert doubted[inside].mean() < 0.1
    assert doubted[~inside].mean() > 0.95 * trusted[~inside].mean()


def test_an_isometry_is_trusted_and_a_stretch_is_not(blob: Operators, make) -> None:
    points, identity = blob.points, torch.arange(blob.n_points)
    turned = points @ torch.from_numpy(make.rotation(4)).float().T + 3
    assert (confidence(points, turned, identity, identity) > 0.999).all()
    assert (confidence(points, 3 * points, identity, identity) < 0.5).all()


def test_confidence_belongs_to_the_first_shape_s_points(blob: Operators) -> None:
    few = blob.points[:100]
    there, back = torch.arange(100), torch.arange(blob.n_points).clamp(max=99)
    assert confidence(few, blob.points, there, back).shape == (100,)
    assert confidence(blob.points, few, back, there).shape == (blob.n_points,)


def cut(shape: Shape, keep: np.ndarray) -> tuple[Shape, np.ndarray]:
    """The faces whose corners are all kept, and the original index of each of their points."""
    faces = shape.faces[keep[shape.faces].all(axis=1)]
    kept = np.unique(faces)
    new_index = np.full(shape.n_points, -1)
    new_index[kept] = np.arange(len(kept))
    return Shape(shape.points[kept], new_index[faces]), kept


def f1(found: np.ndarray, true: np.ndarray) -> float:
    return 2 * (found & true).sum() / (found.sum() + true.sum())


@pytest.mark.parametrize("name", ["sphere", "amber", "boris"])
@pytest.mark.parametrize("modality", ["mesh", "cloud"])
def test_a_cut_is_found_given_the_true_map(name: str, modality: str, demo, make) -> None:
    full = make.sphere(4) if name == "sphere" else getattr(demo, name)
    height = full.points @ np.array([0.3, 1.0, 0.2])
    partial_shape, kept = cut(full, height > np.median(height))
    if modality == "cloud":
        full, partial_shape = full.as_cloud(), partial_shape.as_cloud()
    few = OperatorSettings(n_eigenpairs=5)
    full_operators = compute_operators(full, settings=few)
    partial = compute_operators(partial_shape, settings=few, scale=full_operators.scale)
    found = overlap(full_operators, partial, torch.from_numpy(kept)).numpy()
    # The edge is where it was cut: a lower threshold would add a rim all around, a higher one would take one away.
    assert float(full_operators.mass[found].sum()) == pytest.approx(float(partial.mass.sum()), rel=0.01)
    missing = np.ones(full.n_points, dtype=bool)
    missing[kept] = False
    assert f1(~found, missing) >= 0.9
    assert f1(found, ~missing) >= 0.9


def test_a_full_shape_covers_itself_and_a_coarse_one_the_fine_one(make) -> None:
    few = OperatorSettings(n_eigenpairs=5)
    coarse, fine = (compute_operators(make.sphere(level), settings=few) for level in (3, 4))
    identity = torch.arange(fine.n_points)
    assert overlap(fine, fine, identity).all()
    # Points of the coarse sphere are the first ones of the fine: a quarter of them hold all of the mass.
    assert overlap(fine, coarse, identity[: coarse.n_points]).float().mean() > 0.99
    nowhere = identity[: coarse.n_points].clone()
    nowhere[3] = -1
    with pytest.raises(ArgumentError, match="partial_to_full holds -1"):
        overlap(fine, coarse, nowhere)


def test_smoothing_keeps_the_mass_and_uniform_density_is_one(blob: Operators) -> None:
    identity = torch.arange(blob.n_points)
    ones = coverage_density(blob, blob.mass, identity)
    torch.testing.assert_close(ones, torch.ones(blob.n_points), atol=1e-4, rtol=0)
    target = torch.randint(0, blob.n_points, (300,), generator=torch.Generator().manual_seed(0))
    pushed = coverage_density(blob, torch.full((300,), 0.002), target)
    assert float((pushed * blob.mass).sum()) == pytest.approx(0.6, rel=1e-4)
    assert (pushed >= -1e-6).all()


def signature(operators: Operators, **options: int) -> Tensor:
    return wave_kernel_signature(operators.eigenvalues, operators.eigenvectors, **options)


def test_the_signature_is_the_weighted_mean_of_squared_eigenfunctions(blob: Operators) -> None:
    values = blob.eigenvalues.double().numpy()
    logs = np.log(values[1:])
    spread = 7 * (logs[-1] - logs[0]) / 25
    energies = np.linspace(logs[0] + 2 * spread, logs[-1] - 2 * spread, 25)
    expected = np.zeros((blob.n_points, 25))
    for i, energy in enumerate(energies):
        weights = np.exp(-((energy - logs) ** 2) / (2 * spread**2))
        for k, weight in enumerate(weights):
            expected[:, i] += weight * blob.eigenvectors[:, k + 1].double().numpy() ** 2 / weights.sum()
    np.testing.assert_allclose(signature(blob, n_energies=25), expected, rtol=1e-3, atol=1e-3)


def test_the_signature_forgets_signs_labels_place_pose_and_reflection(blob: Operators, make) -> None:
    own = signature(blob)
    assert own.shape == (blob.n_points, 100) and (own >= 0).all()
    flips = torch.sign(torch.randn(40, generator=torch.Generator().manual_seed(0)))
    torch.testing.assert_close(wave_kernel_signature(blob.eigenvalues, blob.eigenvectors * flips), own)
    shape = make.blob(3)
    order = np.random.default_rng(0).permutation(shape.n_points)
    mirrored = Shape(shape.points @ make.rotation(1).T * [1, 1, -1] * 3 + 5, shape.faces)
    settings = OperatorSettings(n_eigenpairs=40)
    other = signature(compute_operators(make.relabelled(mirrored, order), settings=settings))
    torch.testing.assert_close(other, own[order], rtol=1e-2, atol=1e-3)


def test_the_signature_is_the_same_everywhere_on_a_sphere_and_nowhere_else(blob: Operators, make) -> None:
    sphere = signature(compute_operators(make.sphere(3), settings=OperatorSettings(n_eigenpairs=49)))
    assert (sphere.std(dim=0) / sphere.mean(dim=0)).max() < 0.1
    own = signature(blob)
    assert (own.std(dim=0) / own.mean(dim=0)).max() > 0.3


def test_smoothed_positions_are_the_projection_onto_the_lowest_functions(blob: Operators) -> None:
    phi, mass = blob.eigenvectors[:, :20].double().numpy(), blob.mass.double().numpy()
    root = np.sqrt(mass)[:, None]
    fit = np.linalg.lstsq(root * phi, root * blob.points.double().numpy(), rcond=None)[0]
    np.testing.assert_allclose(smoothed_positions(blob), phi @ fit, atol=1e-5)
    constant = smoothed_positions(blob, n_eigenpairs=1)
    np.testing.assert_allclose(constant, constant[:1].expand(blob.n_points, 3), atol=1e-6)


def test_a_last_point_without_neighbours_is_covered_by_itself_alone(blob):
    """Its rows and columns of the Laplacian are empty; on the others nothing changes."""
    n = len(blob.mass)
    laplacian = torch.sparse_csr_tensor(
        torch.cat([blob.laplacian.crow_indices(), blob.laplacian.crow_indices()[-1:]]),
        blob.laplacian.col_indices(),
        blob.laplacian.values(),
        size=(n + 1, n + 1),
        check_invariants=True,
    )
    mean = blob.mass.mean()
    lonely = replace(blob, laplacian=laplacian, mass=torch.cat([blob.mass, mean[None]]))
    target = torch.arange(n)
    density = coverage_density(lonely, blob.mass, target)
    torch.testing.assert_close(density[:n], torch.ones(n), atol=1e-4, rtol=0)
    assert density[n] == 0
    assert coverage_density(lonely, mean[None], torch.tensor([n]))[n] == pytest.approx(1)


def test_neighbourhoods_that_are_known_are_not_looked_for_again():
    """The same numbers, whether they are given or found; other ones give others."""
    generator = torch.Generator().manual_seed(0)
    points, images = torch.rand(60, 3, generator=generator), torch.rand(50, 3, generator=generator)
    there, back = torch.arange(60) % 50, torch.arange(50)
    found = confidence(points, images, there, back, settings=ConfidenceSettings(n_neighbours=7))
    assert torch.equal(found, confidence(points, images, there, back, near=neighbourhoods(points, 7)))
    assert not torch.equal(found, confidence(points, images, there, back, near=neighbourhoods(points, 3)))
