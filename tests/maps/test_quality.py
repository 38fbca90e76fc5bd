"""Figures of a map without ground truth: maps of which they are known, slow references, and what must not matter."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

from homolog.core.errors import ArgumentError
from homolog.geometry import OperatorSettings, Surface, compute_operators
from homolog.maps import (
    coverage,
    cycle_error,
    dirichlet_energy,
    flipped_triangles,
    nearest_neighbour,
    smooth_dirichlet_energy,
)
from homolog.shapes import Shape

FEW = OperatorSettings(n_eigenpairs=5)


def operators(shape):
    return compute_operators(shape, settings=FEW)


def surface(shape):
    return Surface(shape.points, shape.faces)


@pytest.fixture(scope="module", params=["mesh", "cloud"])
def blob(request, make):
    return operators(make.blob(3) if request.param == "mesh" else make.blob(3).as_cloud())


def test_the_identity_is_perfect(blob, make):
    identity = torch.arange(blob.n_points)
    assert coverage(blob, blob, identity) == pytest.approx(1)
    assert cycle_error(blob.points, identity, identity).max() == 0
    assert dirichlet_energy(blob, blob.points, identity) == pytest.approx(1)
    shape = make.blob(3)
    assert not flipped_triangles(surface(shape), surface(shape), identity.numpy()).any()


def test_the_smooth_energy_of_samples_is_that_of_calculus():
    """Twice round the axis where the identity goes once: the coordinates have 5 / 2 of the energy on a sphere."""
    mesh = trimesh.creation.icosphere(subdivisions=4)
    sphere = compute_operators(Shape(mesh.vertices, mesh.faces), settings=OperatorSettings(n_eigenpairs=60)).basis
    x, y, z = sphere.points.T
    radius = (x**2 + y**2).sqrt().clamp(min=1e-9)
    twice = torch.stack([(x**2 - y**2) / radius, 2 * x * y / radius, z], dim=1)
    kept = torch.randperm(sphere.n_points, generator=torch.Generator().manual_seed(0))[:500]
    for at in (torch.arange(sphere.n_points), kept):
        samples = sphere.sampled(at)
        identity, doubled = (nearest_neighbour(points[at], sphere.points).index for points in (sphere.points, twice))
        assert smooth_dirichlet_energy(samples, sphere, identity) == pytest.approx(1, abs=0.02)
        assert smooth_dirichlet_energy(samples, sphere, doubled) == pytest.approx(2.5, rel=0.03)
        turned = sphere.turned(torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))
        assert smooth_dirichlet_energy(samples, turned, doubled) == pytest.approx(2.5, rel=0.03)


def test_without_the_edges_that_add_most_a_map_that_tears_a_few_is_smooth(blob):
    identity = torch.arange(blob.n_points)
    torn = identity.clone()
    torn[0] = int((blob.points - blob.points[0]).norm(dim=1).argmax())
    n_edges = blob.laplacian.values().numel() - blob.n_points
    n_torn = 2 * int((blob.laplacian.crow_indices().diff())[0] - 1)  # both ways
    assert dirichlet_energy(blob, blob.points, torn) > 2
    without = dirichlet_energy(blob, blob.points, torn, left_out=n_torn / n_edges)
    kept = blob.laplacian.to_dense().clone()
    kept[0] = kept[:, 0] = 0
    lengths = torch.cdist(blob.points.double(), blob.points.double()).square()
    weights = -blob.laplacian.to_dense().double()
    expected = (-kept.double() * lengths).sum() / (weights * lengths).sum()  # lengths on the diagonal are zero
    assert without == pytest.approx(float(expected), rel=1e-5)


def test_a_constant_map_has_no_energy_and_covers_next_to_nothing(blob, make):
    constant = torch.full((blob.n_points,), 7)
    near = (blob.points - blob.points[7]).norm(dim=1) <= 2 * float((blob.mass.sum() / blob.n_points).sqrt())
    expected = float(blob.mass[near].sum() / blob.mass.sum())
    assert coverage(blob, blob, constant) == pytest.approx(expected, rel=1e-5)
    assert 0 < expected < 0.1
    assert dirichlet_energy(blob, blob.points, constant) == pytest.approx(0, abs=1e-5)
    misses = cycle_error(blob.points, constant, constant)
    torch.testing.assert_close(misses, (blob.points - blob.points[7]).norm(dim=1))
    shape = make.blob(3)
    assert not flipped_triangles(surface(shape), surface(shape), constant.numpy()).any()


def test_energy_is_that_of_a_loop_over_the_edges(blob):
    """1/2 sum_ij w_ij |Y_i - Y_j|^2, for rows of L that sum to zero."""
    point_map = np.random.default_rng(0).integers(0, 300, blob.n_points)
    dense = blob.laplacian.to_dense().double().numpy()
    points = blob.points.double().numpy()
    energies = {"own": 0.0, "mapped": 0.0}
    for i, j in zip(*np.nonzero(dense), strict=True):
        energies["own"] -= dense[i, j] * np.sum((points[i] - points[j]) ** 2) / 2
        energies["mapped"] -= dense[i, j] * np.sum((points[point_map[i]] - points[point_map[j]]) ** 2) / 2
    found = dirichlet_energy(blob, blob.points[:300], torch.from_numpy(point_map))
    assert found == pytest.approx(energies["mapped"] / energies["own"], rel=1e-4)
    assert found > 10


def with_near_duplicates(shape, count, share):
    """A point more in each of some triangles, as near to a corner as ``share`` of a side."""
    rng = np.random.default_rng(0)
    which = rng.choice(shape.n_faces, count, replace=False)
    a, b, c = shape.faces[which].T
    new = shape.n_points + np.arange(count)
    points = shape.points[a] * (1 - 2 * share) + shape.points[b] * share + shape.points[c] * share
    fans = np.concatenate([np.stack(sides, axis=1) for sides in ((a, b, new), (b, c, new), (c, a, new))])
    return Shape(np.concatenate([shape.points, points]), np.concatenate([np.delete(shape.faces, which, axis=0), fans]))


@pytest.fixture(scope="module")
def energy_onto_another_mesh(make):
    """The energy of the map from a mesh of the blob to the nearest points of another mesh of it."""
    turned = make.sphere(3).points @ make.rotation(3).T
    x, y, z = turned.T
    radius = 1 + 0.25 * x * y + 0.2 * np.sin(2 * z + 0.4) + 0.15 * np.cos(3 * x + y + 0.7) + 0.1 * np.sin(2 * x - z)
    other = operators(Shape(turned * radius[:, None] * [1.0, 1.4, 0.8], make.sphere(3).faces))

    def energy(shape, **options):
        own = operators(shape)
        there = torch.cdist(own.points.double(), other.points.double()).argmin(dim=1)
        return dirichlet_energy(own, other.points, there, **options), other.mass.sqrt()

    def robust(shape):
        return energy(shape, spacing_y=energy(shape)[1])[0]

    return lambda shape: energy(shape)[0], robust


@pytest.mark.parametrize("share", [1e-2, 1e-4, 1e-6])
def test_energy_does_not_depend_on_points_that_are_nearly_equal(energy_onto_another_mesh, make, share):
    plain, robust = energy_onto_another_mesh
    # A map on the edge between two points sends a point and its near duplicate to different ones.
    shape, rng = make.blob(3), np.random.default_rng(1)
    crowded = with_near_duplicates(shape, 100, share)
    jittered = Shape(crowded.points + 1e-9 * rng.normal(size=crowded.points.shape), crowded.faces)
    assert robust(jittered) == pytest.approx(robust(shape), rel=0.03)
    assert robust(shape) == pytest.approx(plain(shape), rel=0.08)


def test_energy_of_nearly_equal_points_that_are_torn_apart(blob, make):
    """The Laplacian's weight between them grows as their distance shrinks; what they add does not."""
    crowded = operators(with_near_duplicates(make.blob(3), 50, 1e-5))
    own = make.blob(3)
    there = torch.cat(
        [torch.arange(own.n_points), torch.randint(own.n_points, (50,), generator=torch.Generator().manual_seed(0))]
    )
    other = operators(own)
    near = torch.cdist(crowded.points.double(), other.points.double()).topk(4, largest=False).indices
    there[own.n_points :] = near[own.n_points :, 3]
    assert dirichlet_energy(crowded, other.points, there) > 20
    assert dirichlet_energy(crowded, other.points, there, spacing_y=other.mass.sqrt()) < 1.2


@pytest.mark.slow
def test_energy_does_not_depend_on_how_finely_the_shape_is_meshed(energy_onto_another_mesh, make):
    plain, robust = energy_onto_another_mesh
    coarse = make.blob(3)
    fine = trimesh.remesh.subdivide(coarse.points, coarse.faces)
    finest = trimesh.remesh.subdivide(*fine)
    energies = [robust(shape) for shape in (coarse, Shape(*fine), Shape(*finest))]
    assert np.ptp(energies) < 0.12 * energies[0]
    assert plain(Shape(*finest)) > 3 * energies[0]


def slow_flips(x, y, point_map, facing):
    flips = []
    for face in x.faces:
        a, b, c = (y.points[point_map[corner]] for corner in face)
        below = sum(slow_normal(y, point_map[corner]) for corner in face)
        flips.append(facing * np.dot(np.cross(b - a, c - a), below) < 0)
    return np.array(flips)


def slow_normal(shape, vertex):
    around = shape.faces[(shape.faces == vertex).any(axis=1)]
    corners = shape.points[around]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    return normal / np.linalg.norm(normal)


def test_flips_are_those_of_a_loop_over_the_triangles(make):
    x, bent = make.sphere(2), make.blob(2)  # of which no triangle stands upright on another by symmetry
    y = Shape(bent.points * [1, 0.7, 1.2], bent.faces)
    point_map = np.arange(x.n_points)
    point_map[::9] = np.random.default_rng(0).permutation(point_map[::9])
    expected = slow_flips(x, y, point_map, 1)
    assert 0.05 < expected.mean() < 0.5
    np.testing.assert_array_equal(flipped_triangles(surface(x), surface(y), point_map), expected)


@pytest.mark.parametrize("inside_out", [False, True])
def test_a_mirrored_surface_is_turned_over_and_one_with_reversed_faces_is_not(make, inside_out):
    shape = make.blob(3)
    identity = np.arange(shape.n_points)
    reversed_faces = shape.faces[:, ::-1] if inside_out else shape.faces
    mirrored = Surface(shape.points * [-1, 1, 1], reversed_faces)
    assert flipped_triangles(surface(shape), mirrored, identity).all()
    assert not flipped_triangles(surface(shape), Surface(shape.points, reversed_faces), identity).any()


def test_sheets_have_no_outside_so_that_most_triangles_are_right(make):
    sheet = make.grid(9)
    identity = np.arange(sheet.n_points)
    assert not flipped_triangles(surface(sheet), Surface(sheet.points * [-1, 1, 1], sheet.faces), identity).any()
    inverse = identity.copy()
    inverse[[40, 41]] = [41, 40]
    flips = flipped_triangles(surface(sheet), Surface(sheet.points, sheet.faces[:, ::-1]), inverse)
    assert 0 < flips.mean() < 0.1


def test_a_bowl_bent_the_other_way_is_the_same_bowl(make):
    sheet = make.grid(9, width=2.0)
    bulge = np.array([0, 0, 1]) * ((sheet.points[:, :2] - 1) ** 2).sum(axis=1, keepdims=True)
    up, down = Surface(sheet.points + bulge, sheet.faces), Surface(sheet.points - bulge, sheet.faces)
    assert not flipped_triangles(up, down, np.arange(sheet.n_points)).any()


def test_half_of_a_shape_is_half_covered_however_it_is_sampled(make):
    coarse, fine = operators(make.sphere(3)), operators(make.sphere(4))
    upper = torch.nonzero(coarse.points[:, 1] > 0).flatten()
    assert coverage(fine, coarse, torch.arange(coarse.n_points)) == pytest.approx(1)
    # Points of the coarse sphere are the first ones of the fine; the rim of two spacings is covered too: by Archimedes,
    # a band's share of a sphere is that of its height.
    rim = 2 * (4 * np.pi / coarse.n_points) ** 0.5 / 2
    assert coverage(fine, coarse, upper) == pytest.approx(0.5 + rim, abs=0.05)
    nowhere = torch.full((coarse.n_points,), -1)
    assert coverage(fine, coarse, nowhere) == 0


def test_neither_size_nor_place_nor_numbering_matters(make):
    x, y = make.blob(2), make.sphere(2)
    rng = np.random.default_rng(1)
    x_to_y, y_to_x = rng.integers(0, 162, 162), rng.permutation(162)
    order, other = rng.permutation(162), rng.permutation(162)
    place, other_place = np.argsort(order), np.argsort(other)
    moved_x = make.relabelled(Shape(1000 * x.points @ make.rotation(0).T + 5, x.faces), order)
    moved_y = make.relabelled(Shape(0.01 * y.points - 3, y.faces), other)
    here = figures(x, y, x_to_y, y_to_x)
    there = figures(moved_x, moved_y, other_place[x_to_y[order]], place[y_to_x[other]])
    assert there == pytest.approx(here, rel=1e-3)


def figures(x, y, x_to_y, y_to_x):
    a, b = operators(x), operators(y)
    there, back = torch.from_numpy(x_to_y), torch.from_numpy(y_to_x)
    return (
        coverage(b, a, there),
        float(cycle_error(a.points, there, back).mean()),
        dirichlet_energy(a, b.points, there),
        flipped_triangles(surface(x), surface(y), x_to_y).mean(),
    )


def test_points_without_a_counterpart_are_refused_where_they_cannot_be(make):
    shape = make.sphere(1)
    none = torch.arange(42)
    none[3] = -1
    whole = operators(shape)
    for ask in (
        lambda: cycle_error(whole.points, none, torch.arange(42)),
        lambda: dirichlet_energy(whole, whole.points, none),
        lambda: flipped_triangles(surface(shape), surface(shape), none.numpy()),
        lambda: coverage(whole, whole, torch.arange(43)),
    ):
        with pytest.raises(ArgumentError, match="must hold indices from 0 to 41"):
            ask()
