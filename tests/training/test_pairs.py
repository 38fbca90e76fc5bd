"""Pairs as steps train on them: partial ones at the full shape's scale, registration targets where a loss asks."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree

from homolog.geometry import compute_operators, unit_frame
from homolog.maps import registered_positions
from homolog.shapes import Shape, read_shape, write_shape
from homolog.training.data import TrainingSet
from homolog.training.losses import Loss
from homolog.training.objective import losses_of
from homolog.training.pairs import PairLoader
from homolog.training.sampling import PairSampler, SampledPair, SampledShape
from homolog.training.state import TrainingState
from homolog.training.store import ShapeStore
from homolog.training.validation import validation_losses


def store_of(root, recipe):
    return ShapeStore(TrainingSet.open(root, recipe), recipe, compute_operators)


def loader_of(root, recipe):
    return PairLoader(store_of(root, recipe), recipe.partial, losses_of(recipe.loss))


def synthesis(basis):
    """What takes coefficients to functions and to both components of their gradients (n, 3, k)."""
    return torch.cat([basis.eigenvectors[:, None], basis.gradients], dim=1)


@pytest.fixture
def full_and_part(tmp_path, make):
    """A surface, and about half of it, in the same units."""
    blob = make.blob(3)
    kept = blob.points[blob.faces].mean(axis=1)[:, 0] > -0.1
    used, faces = np.unique(blob.faces[kept], return_inverse=True)
    write_shape(tmp_path / "a_part.off", Shape(3 * blob.points[used], faces.reshape(-1, 3)))
    write_shape(tmp_path / "full.off", Shape(3 * blob.points, blob.faces))
    return tmp_path


@pytest.mark.parametrize("turned", [False, True])
def test_the_larger_shape_is_the_full_one_and_gives_the_scale(full_and_part, small, turned):
    recipe = small(partial={}, samples={"points": 0})
    loader = loader_of(full_and_part, recipe)
    full, part = SampledShape("full", 0, 0), SampledShape("a_part", 0, 0)
    pair = loader.pairs([SampledPair(part, full, 5) if turned else SampledPair(full, part, 5)])[0]
    assert (pair.x.name, pair.y.name, str(pair.sampled)) == ("full", "a_part", "full - a_part")
    shapes = {name: read_shape(full_and_part / f"{name}.off") for name in ("full", "a_part")}
    scale = unit_frame(shapes["full"]).scale
    expected = compute_operators(shapes["a_part"], settings=recipe.operators, scale=scale).basis
    found = pair.y.mesh
    torch.testing.assert_close(found.points, expected.points, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(found.mass, expected.mass, atol=1e-7, rtol=1e-3)
    torch.testing.assert_close(found.eigenvalues, expected.eigenvalues, atol=1e-2, rtol=1e-3)
    functions = expected.points
    for name in ("eigenvectors", "x", "y"):
        row = ("eigenvectors", "x", "y").index(name)
        projected, wanted = (synthesis(b)[:, row] @ (b.pseudo_inverse @ functions) for b in (found, expected))
        torch.testing.assert_close(projected, wanted, atol=2e-2, rtol=2e-2)
    own = store_of(full_and_part, recipe).shape(full).mesh
    assert torch.equal(pair.x.mesh.points, own.points) and torch.equal(pair.x.mesh.eigenvectors, own.eigenvectors)


def test_pre_aligned_parts_lie_on_their_full_shapes(full_and_part, small):
    """Points of the part, mesh and cloud, are points of the full shape: they have the same positions."""
    recipe = small(partial={"pre_aligned": True}, samples={"points": 0}, clouds={"cut": [0.5]})
    loader = loader_of(full_and_part, recipe)
    pair = loader.pairs([SampledPair(SampledShape("full", 0, 0), SampledShape("a_part", 1, 0), 5)])[0]
    for basis in (pair.y.mesh, pair.y.cloud):
        assert KDTree(pair.x.mesh.points.numpy()).query(basis.points.numpy())[0].max() < 1e-5
    assert pair.y.cloud.n_points < pair.y.mesh.n_points < pair.x.mesh.n_points
    apart = loader_of(full_and_part, small(partial={}, samples={"points": 0}, clouds={"cut": [0.5]})).pairs(
        [pair.sampled]
    )
    for basis in (apart[0].y.mesh, apart[0].y.cloud):
        assert basis.points.mean(dim=0).norm() < 1e-4


def test_steps_load_what_was_sampled(meshes, small):
    recipe = small(training={"pairs_per_step": 2})
    sampled = PairSampler(TrainingSet.open(meshes, recipe), recipe).of_step(3)
    pairs = loader_of(meshes, recipe).pairs(sampled)
    assert [(pair.x.name, pair.y.name) for pair in pairs] == [(each.x.name, each.y.name) for each in sampled]
    assert [pair.sampled for pair in pairs] == list(sampled)


@pytest.mark.parametrize("variants", [(0, 0), (0, 1), (1, 0)])
def test_registration_is_of_all_points_and_given_at_the_samples(clouds, small, variants):
    recipe = small(data={"clouds": True}, clouds={"subsampled": [0.6]}, loss={"registration": 1.0})
    store, loader = store_of(clouds, recipe), loader_of(clouds, recipe)
    bee, ape = SampledShape("bee", variants[0], 1), SampledShape("ape", variants[1], 0)
    for sampled in (SampledPair(bee, ape, 0), SampledPair(ape, bee, 0)):
        (pair,) = loader.pairs([sampled])
        x, y = (store.samples(shape.name, shape.variant) for shape in (sampled.x, sampled.y))
        _, on_x = registered_positions(x.points, y.points)
        indices = torch.from_numpy(y.indices[sampled.y.subset])
        torch.testing.assert_close(pair.registration_targets, on_x[indices], atol=1e-5, rtol=0)
        torch.testing.assert_close(y.points[indices], pair.y.cloud.points)


def test_no_registration_where_no_loss_asks_for_it_and_none_of_partial_clouds(clouds, meshes, small):
    sampled = SampledPair(SampledShape("bee", 0, 0), SampledShape("ape", 0, 0), 0)
    assert loader_of(clouds, small(data={"clouds": True})).pairs([sampled])[0].registration_targets is None
    parts = loader_of(meshes, small(clouds={"cut": [0.5]}, loss={"registration": 1.0}))
    (pair,) = parts.pairs([SampledPair(SampledShape("bee", 0, 0), SampledShape("ape", 1, 0), 0)])
    assert pair.registration_targets is None


def test_a_loss_of_one_s_own_may_ask_for_registration(clouds, small):
    recipe = small(data={"clouds": True})
    mine = Loss("mine", 1.0, {"registration_targets"}, lambda registration_targets: registration_targets.sum())
    loader = PairLoader(store_of(clouds, recipe), None, [mine])
    (pair,) = loader.pairs([SampledPair(SampledShape("bee", 0, 0), SampledShape("ape", 0, 0), 0)])
    assert pair.registration_targets.shape == (150, 3)


def test_validation_uses_the_registration_of_all_points(clouds, small):
    recipe = small(data={"clouds": True}, loss={"registration": 1.0})
    (pair,) = loader_of(clouds, recipe).pairs([SampledPair(SampledShape("bee", 0, 0), SampledShape("ape", 0, 0), 0)])
    network, losses = TrainingState.new(recipe).result(), losses_of(recipe.loss)

    def total(*pairs):
        return validation_losses(network, pairs, recipe.loss, losses, partial=False)["total"]

    opposite = replace(pair, registration_targets=-pair.registration_targets)
    assert total(opposite) > total(pair) + 0.1
    assert total(pair, opposite) == pytest.approx((total(pair) + total(opposite)) / 2)
