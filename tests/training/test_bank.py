"""Shapes made ready to train on."""

import threading
import time

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree

from homolog.core.errors import DataError
from homolog.geometry import compute_operators, unit_frame
from homolog.maps import registered_positions
from homolog.shapes import Shape, read_shape, write_shape
from homolog.training.bank import ShapeBank, prefetched
from homolog.training.data import TrainingSet
from homolog.training.plan import Draw, Member, Plan


def bank_of(root, recipe, operators=compute_operators):
    return ShapeBank(TrainingSet.open(root, recipe), recipe, operators)


def synthesis(basis):
    """What takes coefficients to functions and to both components of their gradients (n, 3, k)."""
    return torch.cat([basis.eigenvectors[:, None], basis.gradients], dim=1)


def same(one, other):
    names = ("points", "mass", "eigenvalues", "eigenvectors", "gradients", "analysis")
    return all(torch.equal(getattr(one, name), getattr(other, name)) for name in names)


def test_meshes_and_noisy_clouds_share_their_points(meshes, small):
    bank = bank_of(meshes, small(clouds={"noise": [0.01]}))
    clean, noisy = (bank.shape(Member("bee", variant, 1)) for variant in (0, 1))
    assert clean.pairing is None and noisy.pairing is None
    assert same(clean.mesh, noisy.mesh)
    assert clean.mesh.n_points == clean.cloud.n_points == 150
    torch.testing.assert_close(clean.mesh.points, clean.cloud.points)
    moved = (noisy.cloud.points - clean.cloud.points).std()
    assert 0.008 < moved < 0.012
    assert not same(bank.shape(Member("bee", 0, 0)).mesh, clean.mesh)


def test_bases_are_samples_of_full_operators(meshes, small):
    recipe = small()
    found = bank_of(meshes, recipe).shape(Member("cat", 0, 0)).mesh
    shape = read_shape(meshes / "off" / "cat.off")
    full = compute_operators(shape, settings=recipe.operators)
    distance, nearest = torch.cdist(found.points.double(), full.points.double()).min(dim=1)
    assert distance.max() < 1e-5
    torch.testing.assert_close(found.eigenvectors, full.eigenvectors[nearest], atol=1e-3, rtol=1e-3)
    assert len(set(nearest.tolist())) == 150


@pytest.mark.parametrize(("clouds", "spacing"), [({"thinned": [0.5]}, 1e-5), ({"resampled": [800]}, 0.06)])
def test_other_clouds_are_paired_with_the_mesh_where_they_lie(meshes, small, clouds, spacing):
    shape = bank_of(meshes, small(clouds=clouds)).shape(Member("ape", 1, 1))
    assert shape.cloud.n_points == 150 and shape.pairing.shape == (150, shape.mesh.n_points)
    apart = shape.at_cloud(shape.mesh.points) - shape.cloud.points
    assert (apart - apart.mean(dim=0)).norm(dim=1).max() < spacing  # each is centred for itself
    torch.testing.assert_close(shape.at_cloud(torch.ones(shape.mesh.n_points, 1)), torch.ones(150, 1))


def test_with_all_points_clouds_are_paired_exactly(meshes, small):
    shape = bank_of(meshes, small(samples={"points": 0}, clouds={"resampled": [800]})).shape(Member("ape", 1, 0))
    assert (shape.mesh.n_points, shape.cloud.n_points) == (642, 800)
    apart = shape.at_cloud(shape.mesh.points) - shape.cloud.points
    assert (apart - apart.mean(dim=0)).abs().max() < 1e-5
    assert same(shape.mesh, bank_of(meshes, small(samples={"points": 0})).shape(Member("ape", 0, 0)).mesh)


def test_what_does_not_fit_into_memory_is_read_again_and_is_the_same(meshes, small):
    counted = []

    def operators(shape, **options):
        counted.append(shape.name)
        return compute_operators(shape, **options)

    ample = bank_of(meshes, small(clouds={"noise": [0.01]}))
    tight = bank_of(meshes, small(data={"memory_gb": 1e-6}, clouds={"noise": [0.01]}), operators)
    tight.prepare(tight.shapes.used, lambda *told: None)
    before = len(counted)
    assert before >= 12  # four shapes with two clouds each
    for member in (Member("ape", 1, 0), Member("bee", 0, 1), Member("ape", 1, 0)):
        one, other = ample.shape(member), tight.shape(member)
        assert same(one.mesh, other.mesh) and same(one.cloud, other.cloud)
    assert len(counted) > before


def test_a_prepared_bank_computes_no_more(meshes, small):
    counted, told = [], []

    def operators(shape, **options):
        counted.append(shape.name)
        return compute_operators(shape, **options)

    bank = bank_of(meshes, small(clouds={"noise": [0.01]}), operators)
    bank.prepare(bank.shapes.used, lambda *progress: told.append(progress))
    assert len(counted) == 12
    assert [(done, total) for done, total, _ in told] == [(1, 4), (2, 4), (3, 4), (4, 4)]
    for variant in (0, 1):
        for subset in (0, 1):
            bank.shape(Member("dog", variant, subset))
    assert len(counted) == 12


@pytest.fixture
def whole_and_part(tmp_path, make):
    """A surface, and about half of it, in the same units."""
    blob = make.blob(3)
    kept = blob.points[blob.faces].mean(axis=1)[:, 0] > -0.1
    used, faces = np.unique(blob.faces[kept], return_inverse=True)
    write_shape(tmp_path / "a_part.off", Shape(3 * blob.points[used], faces.reshape(-1, 3)))
    write_shape(tmp_path / "whole.off", Shape(3 * blob.points, blob.faces))
    return tmp_path


@pytest.mark.parametrize("turned", [False, True])
def test_the_larger_shape_is_the_complete_one_and_gives_the_scale(whole_and_part, small, turned):
    recipe = small(partial={}, samples={"points": 0})
    bank = bank_of(whole_and_part, recipe)
    whole, part = Member("whole", 0, 0), Member("a_part", 0, 0)
    pair = bank.pairs([Draw(part, whole, 5) if turned else Draw(whole, part, 5)])[0]
    assert (pair.x.name, pair.y.name, str(pair.draw)) == ("whole", "a_part", "whole - a_part")
    shapes = {name: read_shape(whole_and_part / f"{name}.off") for name in ("whole", "a_part")}
    scale = unit_frame(shapes["whole"]).scale
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
    assert same(pair.x.mesh, bank.shape(whole).mesh)


def test_parts_in_place_lie_on_their_wholes(whole_and_part, small):
    """Points of the part, mesh and cloud, are points of the whole: they lie at one place each."""
    recipe = small(partial={"pre_aligned": True}, samples={"points": 0}, clouds={"cut": [0.5]})
    bank = bank_of(whole_and_part, recipe)
    pair = bank.pairs([Draw(Member("whole", 0, 0), Member("a_part", 1, 0), 5)])[0]
    for basis in (pair.y.mesh, pair.y.cloud):
        assert KDTree(pair.x.mesh.points.numpy()).query(basis.points.numpy())[0].max() < 1e-5
    assert pair.y.cloud.n_points < pair.y.mesh.n_points < pair.x.mesh.n_points
    apart = bank_of(whole_and_part, small(partial={}, samples={"points": 0}, clouds={"cut": [0.5]})).pairs([pair.draw])
    for basis in (apart[0].y.mesh, apart[0].y.cloud):
        assert basis.points.mean(dim=0).norm() < 1e-4


@pytest.mark.parametrize("clouds", [{"cut": [0.4]}, {"pierced": [6]}])
@pytest.mark.parametrize("points", [0, 150])
def test_parts_of_a_mesh_are_paired_with_their_own_points(meshes, small, clouds, points):
    """All samples of the mesh stay, as its coefficients need them; the part has those of them that lie on it."""
    shape = bank_of(meshes, small(clouds=clouds, samples={"points": points})).shape(Member("ape", 1, 0))
    assert shape.cloud_is_part
    assert shape.mesh.n_points == (points or 642)
    assert 0.2 < shape.cloud.n_points / shape.mesh.n_points < 0.95
    apart = shape.at_cloud(shape.mesh.points) - shape.cloud.points
    assert (apart - apart.mean(dim=0)).norm(dim=1).max() < 1e-5
    assert not bank_of(meshes, small(clouds=clouds)).shape(Member("ape", 0, 0)).cloud_is_part


def test_what_is_seen_of_a_mesh_has_the_point_nearest_to_each_sample(meshes, small):
    """A depth camera's points lie between the mesh's: interpolated exactly from all, from samples off by an edge."""
    exact = bank_of(meshes, small(clouds={"seen": [0.0]}, samples={"points": 0})).shape(Member("ape", 1, 0))
    apart = exact.at_cloud(exact.mesh.points) - exact.cloud.points
    assert (apart - apart.mean(dim=0)).norm(dim=1).max() < 1e-5
    sampled = bank_of(meshes, small(clouds={"seen": [0.0]}, samples={"points": 150})).shape(Member("ape", 1, 0))
    assert sampled.cloud_is_part and 0.2 < sampled.cloud.n_points / 150 < 0.6
    places = sampled.pairing.to_dense().argmax(dim=1).tolist()
    assert len(set(places)) == len(places)
    apart = sampled.mesh.points[places] - sampled.cloud.points
    edge = torch.cdist(exact.mesh.points, exact.mesh.points).topk(7, largest=False).values[:, -1].max()
    assert (apart - apart.mean(dim=0)).norm(dim=1).max() < edge


def test_prefetched_is_in_order_and_ahead():
    loaded = []

    def load(step):
        loaded.append(step)
        time.sleep(0.01 * (step % 3))
        return step

    steps = prefetched(load, range(3, 20), workers=3)
    assert next(steps) == 3
    assert len(loaded) > 1
    assert list(steps) == list(range(4, 20))
    assert list(prefetched(load, range(0), workers=1)) == []


def test_prefetched_ends_its_threads_and_passes_errors_on():
    def load(step):
        if step == 4:
            raise ValueError("four")
        return step

    before = threading.active_count()
    with pytest.raises(ValueError, match="four"):
        list(prefetched(load, range(10), workers=2))
    steps = prefetched(load, range(10), workers=2)
    next(steps)
    steps.close()
    assert threading.active_count() == before


def test_steps_load_what_was_planned(meshes, small):
    recipe = small(training={"pairs_per_step": 2})
    bank = bank_of(meshes, recipe)
    draws = Plan(bank.shapes, recipe).draws(3)
    pairs = bank.pairs(draws)
    assert [(pair.x.name, pair.y.name) for pair in pairs] == [(draw.x.name, draw.y.name) for draw in draws]


@pytest.fixture(scope="module")
def clouds(tmp_path_factory, make):
    """Three clouds of differently stretched and relabelled surfaces."""
    root, blob = tmp_path_factory.mktemp("clouds"), make.blob(3)
    for number, name in enumerate(("ape", "bee", "cat")):
        order = np.random.default_rng(number).permutation(blob.n_points)
        write_shape(root / f"{name}.ply", Shape(blob.points[order] * [1 + 0.2 * number, 1, 1 - 0.1 * number]))
    return root


def test_a_cloud_stands_for_its_own_mesh(clouds, small):
    bank = bank_of(clouds, small(data={"clouds": True}, clouds={"noise": [0.01]}))
    clean, noisy = (bank.shape(Member("bee", variant, 1)) for variant in (0, 1))
    assert same(clean.mesh, clean.cloud) and same(clean.mesh, noisy.mesh) and clean.pairing is None
    full = compute_operators(read_shape(clouds / "bee.ply"), settings=small().operators)
    torch.testing.assert_close(clean.mesh.eigenvalues, full.basis.eigenvalues)


@pytest.mark.parametrize("kind", ["resampled", "cut", "pierced", "seen"])
def test_what_takes_faces_is_not_made_of_clouds(clouds, small, kind):
    amount = {"resampled": 300, "pierced": 3}.get(kind, 0.5)
    bank = bank_of(clouds, small(data={"clouds": True}, clouds={kind: [amount]}))
    with pytest.raises(
        DataError, match=rf"\[clouds\] {kind} .* cannot be made of ape: it has no faces; leave that out"
    ):
        bank.shape(Member("ape", 1, 0))


@pytest.mark.parametrize("variants", [(0, 0), (0, 1), (1, 0)])
def test_skins_are_drawn_with_all_points_and_given_at_the_samples(clouds, small, variants):
    recipe = small(data={"clouds": True}, clouds={"thinned": [0.6]}, loss={"registration": 1.0})
    bank = bank_of(clouds, recipe)
    draws = [Draw(Member("bee", v, 1), Member("ape", w, 0), 0) for v, w in (variants, variants[::-1])]
    for draw in (draws[0], Draw(draws[0].y, draws[0].x, 0)):
        (pair,) = bank.pairs([draw])
        x, y = (bank._samples(member.name, member.variant) for member in (draw.x, draw.y))
        _, on_x = registered_positions(x.whole, y.whole)
        torch.testing.assert_close(
            pair.registration_targets, on_x[torch.from_numpy(y.kept[draw.y.subset])], atol=1e-5, rtol=0
        )
        torch.testing.assert_close(y.whole[torch.from_numpy(y.kept[draw.y.subset])], pair.y.cloud.points)


def test_no_skin_where_nothing_asks_for_one_and_none_of_parts(clouds, meshes, small):
    draw = Draw(Member("bee", 0, 0), Member("ape", 0, 0), 0)
    assert bank_of(clouds, small(data={"clouds": True})).pairs([draw])[0].registration_targets is None
    parts = bank_of(meshes, small(clouds={"cut": [0.5]}, loss={"registration": 1.0}))
    (pair,) = parts.pairs([Draw(Member("bee", 0, 0), Member("ape", 1, 0), 0)])
    assert pair.registration_targets is None
