"""Losses of soft maps within a training: what they ask for is what it should be, and they are learned from."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from homolog import Matcher
from homolog.core.errors import DataError
from homolog.features import load_weights, network_input
from homolog.geometry import compute_operators
from homolog.maps import normalised, wave_kernel_signature
from homolog.maps.soft_losses import map_from_common_points
from homolog.shapes import read_shape
from homolog.training import LossSettings, PairQuantities, train
from homolog.training.data import TrainingSet
from homolog.training.sampling import SampledShape
from homolog.training.store import ShapeStore

TERMS = ("descriptors", "coupling", "true_maps", "teacher", "diffusion", "damped_spectrum")
NONE = {"bijectivity": 0.0, "orthogonality": 0.0, "alignment": 0.0, "infonce": 0.0}


def store_of(root, recipe):
    return ShapeStore(TrainingSet.open(root, recipe), recipe, compute_operators)


@pytest.fixture(scope="module")
def pair(meshes, small):
    store = store_of(meshes, small(samples={"points": 300}, loss={"true_maps": 1.0}))
    return tuple(store.shape(SampledShape(name, 0, 0)) for name in ("ape", "bee"))


def quantities(pair, *, seed=0, features=None, **changes):
    generator = torch.Generator().manual_seed(7)
    sizes = [shape.mesh.n_points for shape in pair]
    features = features or [torch.randn(size, 16, generator=generator) for size in sizes]
    settings = LossSettings(map_eigenpairs=12, **changes)
    return PairQuantities(*pair, [*features, *features], settings, generator=torch.Generator().manual_seed(seed))


def test_true_maps_are_those_of_the_files(pair, meshes):
    """Of the eigenvectors at all template points; stretched copies nearly have the same functions."""
    found = quantities(pair)
    expected = []
    for name in ("ape", "bee"):
        shape = read_shape(meshes / "off" / f"{name}.off")
        vertices = np.loadtxt(meshes / "corres" / f"{name}.vts", dtype=int) - 1
        operators = compute_operators(shape)
        expected.append(operators.eigenvectors[vertices, :12])
    there = map_from_common_points(*expected)
    # Eigenvectors have a sign of their own in every computation.
    torch.testing.assert_close(found.true_c_xy.abs(), there.abs(), rtol=0.02, atol=0.02)
    product = found.true_c_xy @ found.true_c_yx
    assert (product - torch.eye(12)).norm() < 2.0
    assert found.true_c_xy[0, 0].abs() == pytest.approx(1.0, abs=0.1)
    with pytest.raises(DataError, match="ape -> bee have no common template"):
        assert quantities((pair[0], replace(pair[1], template_eigenvectors=None))).true_c_xy


def test_points_that_a_shape_lacks_are_left_out(pair):
    whole = quantities(pair).true_c_xy
    lacking = pair[1].template_eigenvectors.clone()
    lacking[::4] = torch.nan
    found = quantities((pair[0], replace(pair[1], template_eigenvectors=lacking))).true_c_xy
    kept = torch.arange(100) % 4 != 0
    expected = map_from_common_points(*(shape.template_eigenvectors[kept] for shape in pair))
    torch.testing.assert_close(found, expected)
    assert not torch.allclose(found, whole)


def test_eigenvectors_are_mapped_by_unit_features_both_ways(pair):
    found = quantities(pair, coupling_temperature=0.2)
    x, y = normalised(found._x.features), normalised(found._y.features)
    soft = torch.softmax(y @ x.T / 0.2, dim=1)
    torch.testing.assert_close(found.mapped_to_y, soft @ pair[0].mesh.eigenvectors[:, :12], rtol=1e-4, atol=1e-5)
    soft = torch.softmax(x @ y.T / 0.2, dim=1)
    torch.testing.assert_close(found.mapped_to_x, soft @ pair[1].mesh.eigenvectors[:, :12], rtol=1e-4, atol=1e-5)


def test_products_multiply_with_unit_features(pair):
    """Of functions in the span of the eigenvectors, up to what the product has outside it."""
    found = quantities(pair)
    basis, features = pair[1].mesh, normalised(found._y.features)
    function = basis.eigenvectors[:, :12] @ torch.ones(12)
    for channel in (0, 15):
        expected = basis.pseudo_inverse[:12] @ (features[:, channel] * function)
        torch.testing.assert_close(found.of(["products_y"])["products_y"][:, channel] @ torch.ones(12), expected)


def test_refined_maps_have_no_gradient_and_find_the_points_again(pair):
    same = (pair[0], pair[0])
    features = [pair[0].mesh.eigenvectors[:, 1:17].clone().requires_grad_() for _ in range(2)]
    found = quantities(same, features=features)
    assert not found.refined_y_to_x.requires_grad
    assert (found.refined_y_to_x == torch.arange(300)).float().mean() > 0.95
    assert (found.refined_x_to_y == torch.arange(300)).float().mean() > 0.95


def test_random_functions_are_of_size_one_and_come_from_the_generator(pair):
    found = quantities(pair, diffusion_functions=400, diffusion_time=0.02)
    functions = pair[0].mesh.eigenvectors @ found.random_coefficients
    mass = pair[0].mesh.mass
    assert ((mass @ functions.square()) / mass.sum()).mean().item() == pytest.approx(1.0, rel=0.15)
    assert 0 <= found.random_times.min() < 0.002 < 0.018 < found.random_times.max() <= 0.02
    again, other = (quantities(pair, seed=seed, diffusion_functions=400) for seed in (0, 1))
    torch.testing.assert_close(again.random_coefficients, found.random_coefficients)
    assert not torch.allclose(other.random_coefficients, found.random_coefficients)


def test_signatures_beside_positions(pair):
    """Each channel of unit norm on the surface, and positions as they are given."""
    basis, points = pair[0].mesh, torch.randn(300, 3)
    found = network_input(basis, "xyz+wks", 23, points=points)
    assert torch.equal(found[:, :3], points)
    signature = wave_kernel_signature(basis.eigenvalues, basis.eigenvectors, n_energies=20)
    norms = (basis.mass[:, None] * signature.square()).sum(dim=0).sqrt()
    torch.testing.assert_close(found[:, 3:], signature / norms)
    assert torch.equal(network_input(basis, "xyz", 3), basis.points)


def test_a_training_with_signatures_gives_weights_that_match(meshes, small, tmp_path):
    recipe = small(input="xyz+wks", network={"in_channels": 11})
    train(recipe, meshes, tmp_path / "run", operators=compute_operators, device="cpu")
    extractor = load_weights(tmp_path / "run" / "weights.safetensors")
    assert (extractor.info.input, extractor.info.follows_pose) == ("xyz+wks", True)
    operators = compute_operators(read_shape(meshes / "off" / "ape.off"))
    inputs = network_input(operators, "xyz+wks", 11)
    torch.testing.assert_close(extractor(operators), extractor.network(inputs, operators))
    matcher = Matcher(extractor, operators=compute_operators)
    assert len(matcher.match(*(meshes / "off" / f"{name}.off" for name in ("ape", "bee"))).target_to_source) == 642


@pytest.mark.slow
@pytest.mark.parametrize("term", TERMS)
def test_training_by_one_term_alone_lowers_it(meshes, small, tmp_path, term):
    weights = {**NONE, term: 1.0}
    recipe = small(samples={"points": 300}, loss=weights, training={"steps": 30}, network={"dropout": 0.0})
    state = train(recipe, meshes, tmp_path / "run", operators=compute_operators, device="cpu")
    first, *_, last = [record[f"validation/{term}"] for record in state.records]
    assert last < 0.98 * first
