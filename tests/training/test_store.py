"""Shapes made ready to train on."""

import pytest
import torch

from homolog.core.errors import ArgumentError, DataError
from homolog.geometry import OperatorCache, compute_operators
from homolog.shapes import read_shape
from homolog.training.data import TrainingSet
from homolog.training.sampling import SampledShape
from homolog.training.store import ShapeStore, keep_operators


def store_of(root, recipe, operators=compute_operators):
    return ShapeStore(TrainingSet.open(root, recipe), recipe, operators)


def same(one, other):
    names = ("points", "mass", "eigenvalues", "eigenvectors", "gradients", "pseudo_inverse")
    return all(torch.equal(getattr(one, name), getattr(other, name)) for name in names)


def test_meshes_and_noisy_clouds_share_their_points(meshes, small):
    store = store_of(meshes, small(clouds={"noise": [0.01]}))
    clean, noisy = (store.shape(SampledShape("bee", variant, 1)) for variant in (0, 1))
    assert clean.pairing is None and noisy.pairing is None
    assert same(clean.mesh, noisy.mesh)
    assert clean.mesh.n_points == clean.cloud.n_points == 150
    torch.testing.assert_close(clean.mesh.points, clean.cloud.points)
    moved = (noisy.cloud.points - clean.cloud.points).std()
    assert 0.008 < moved < 0.012
    assert not same(store.shape(SampledShape("bee", 0, 0)).mesh, clean.mesh)


def test_bases_are_samples_of_full_operators(meshes, small):
    recipe = small()
    found = store_of(meshes, recipe).shape(SampledShape("cat", 0, 0)).mesh
    shape = read_shape(meshes / "off" / "cat.off")
    full = compute_operators(shape, settings=recipe.operators)
    distance, nearest = torch.cdist(found.points.double(), full.points.double()).min(dim=1)
    assert distance.max() < 1e-5
    torch.testing.assert_close(found.eigenvectors, full.eigenvectors[nearest], atol=1e-3, rtol=1e-3)
    assert len(set(nearest.tolist())) == 150


@pytest.mark.parametrize(("clouds", "spacing"), [({"subsampled": [0.5]}, 1e-5), ({"resampled": [800]}, 0.06)])
def test_other_clouds_are_paired_with_the_mesh_where_they_lie(meshes, small, clouds, spacing):
    shape = store_of(meshes, small(clouds=clouds)).shape(SampledShape("ape", 1, 1))
    assert shape.cloud.n_points == 150 and shape.pairing.shape == (150, shape.mesh.n_points)
    apart = shape.at_cloud(shape.mesh.points) - shape.cloud.points
    assert (apart - apart.mean(dim=0)).norm(dim=1).max() < spacing  # each is centred for itself
    torch.testing.assert_close(shape.at_cloud(torch.ones(shape.mesh.n_points, 1)), torch.ones(150, 1))


def test_with_all_points_clouds_are_paired_exactly(meshes, small):
    shape = store_of(meshes, small(samples={"points": 0}, clouds={"resampled": [800]})).shape(SampledShape("ape", 1, 0))
    assert (shape.mesh.n_points, shape.cloud.n_points) == (642, 800)
    apart = shape.at_cloud(shape.mesh.points) - shape.cloud.points
    assert (apart - apart.mean(dim=0)).abs().max() < 1e-5
    assert same(shape.mesh, store_of(meshes, small(samples={"points": 0})).shape(SampledShape("ape", 0, 0)).mesh)


def test_what_does_not_fit_into_memory_is_read_again_and_is_the_same(meshes, small):
    counted = []

    def operators(shape, **options):
        counted.append(shape.name)
        return compute_operators(shape, **options)

    ample = store_of(meshes, small(clouds={"noise": [0.01]}))
    tight = store_of(meshes, small(data={"memory_gb": 1e-6}, clouds={"noise": [0.01]}), operators)
    tight.prepare(tight.shapes.used, lambda *told: None)
    before = len(counted)
    assert before >= 12  # four shapes with two clouds each
    for member in (SampledShape("ape", 1, 0), SampledShape("bee", 0, 1), SampledShape("ape", 1, 0)):
        one, other = ample.shape(member), tight.shape(member)
        assert same(one.mesh, other.mesh) and same(one.cloud, other.cloud)
    assert len(counted) > before


def test_a_prepared_bank_computes_no_more(meshes, small):
    counted, told = [], []

    def operators(shape, **options):
        counted.append(shape.name)
        return compute_operators(shape, **options)

    store = store_of(meshes, small(clouds={"noise": [0.01]}), operators)
    store.prepare(store.shapes.used, lambda *progress: told.append(progress))
    assert len(counted) == 12
    assert [(done, total) for done, total, _ in told] == [(1, 4), (2, 4), (3, 4), (4, 4)]
    for variant in (0, 1):
        for subset in (0, 1):
            store.shape(SampledShape("dog", variant, subset))
    assert len(counted) == 12


@pytest.mark.parametrize("clouds", [{"cut": [0.4]}, {"holes": [6]}])
@pytest.mark.parametrize("points", [0, 150])
def test_parts_of_a_mesh_are_paired_with_their_own_points(meshes, small, clouds, points):
    """All samples of the mesh stay, as its coefficients need them; the part has those of them that lie on it."""
    shape = store_of(meshes, small(clouds=clouds, samples={"points": points})).shape(SampledShape("ape", 1, 0))
    assert shape.cloud_is_partial
    assert shape.mesh.n_points == (points or 642)
    assert 0.2 < shape.cloud.n_points / shape.mesh.n_points < 0.95
    apart = shape.at_cloud(shape.mesh.points) - shape.cloud.points
    assert (apart - apart.mean(dim=0)).norm(dim=1).max() < 1e-5
    assert not store_of(meshes, small(clouds=clouds)).shape(SampledShape("ape", 0, 0)).cloud_is_partial


def test_what_is_seen_of_a_mesh_has_the_point_nearest_to_each_sample(meshes, small):
    """A depth camera's points lie between the mesh's: interpolated exactly from all, from samples off by an edge."""
    exact = store_of(meshes, small(clouds={"views": [0.0]}, samples={"points": 0})).shape(SampledShape("ape", 1, 0))
    apart = exact.at_cloud(exact.mesh.points) - exact.cloud.points
    assert (apart - apart.mean(dim=0)).norm(dim=1).max() < 1e-5
    sampled = store_of(meshes, small(clouds={"views": [0.0]}, samples={"points": 150})).shape(SampledShape("ape", 1, 0))
    assert sampled.cloud_is_partial and 0.2 < sampled.cloud.n_points / 150 < 0.6
    places = sampled.pairing.to_dense().argmax(dim=1).tolist()
    assert len(set(places)) == len(places)
    apart = sampled.mesh.points[places] - sampled.cloud.points
    edge = torch.cdist(exact.mesh.points, exact.mesh.points).topk(7, largest=False).values[:, -1].max()
    assert (apart - apart.mean(dim=0)).norm(dim=1).max() < edge


def test_a_cloud_stands_for_its_own_mesh(clouds, small):
    store = store_of(clouds, small(data={"clouds": True}, clouds={"noise": [0.01]}))
    clean, noisy = (store.shape(SampledShape("bee", variant, 1)) for variant in (0, 1))
    assert same(clean.mesh, clean.cloud) and same(clean.mesh, noisy.mesh) and clean.pairing is None
    full = compute_operators(read_shape(clouds / "bee.ply"), settings=small().operators)
    torch.testing.assert_close(clean.mesh.eigenvalues, full.basis.eigenvalues)


@pytest.mark.parametrize("kind", ["resampled", "cut", "holes", "views"])
def test_what_takes_faces_is_not_made_of_clouds(clouds, small, kind):
    amount = {"resampled": 300, "holes": 3}.get(kind, 0.5)
    store = store_of(clouds, small(data={"clouds": True}, clouds={kind: [amount]}))
    with pytest.raises(
        DataError, match=rf"\[clouds\] {kind} .* cannot be made of ape: it has no faces; leave that out"
    ):
        store.shape(SampledShape("ape", 1, 0))


def test_operators_are_kept_for_a_training_that_computes_none(meshes, small, tmp_path, monkeypatch):
    recipe, cache = small(clouds={"noise": [0.01]}), OperatorCache(tmp_path / "new")
    shapes, told = TrainingSet.open(meshes, recipe), []
    keep_operators(shapes, recipe, cache.operators, 1, progress=lambda *what: told.append(what[2]))
    assert told == [*(f"operators of {name}" for name in shapes.used), "done"]
    assert cache.size()[0] == 3 * len(shapes.used)  # of each mesh, its points, and a noisy cloud
    monkeypatch.setattr("homolog.geometry.cache.compute_operators", None)
    store_of(meshes, recipe, cache.operators).prepare(shapes.used, lambda *told: None)


def test_a_cluster_has_nowhere_to_keep_operators_without_a_cache(meshes, small):
    recipe = small()
    with pytest.raises(ArgumentError, match="operators come from no cache"):
        keep_operators(TrainingSet.open(meshes, recipe), recipe, compute_operators, 1, progress=lambda *what: None)
