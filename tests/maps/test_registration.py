"""Clouds drawn onto each other, against maps that are known."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import ConvexHull, KDTree
from scipy.spatial.transform import Rotation
from torch import Tensor

from homolog.core.errors import ArgumentError
from homolog.geometry import areas_by_density
from homolog.maps import (
    RegistrationSettings,
    RegistrationStart,
    SampledSurface,
    Similarity,
    closest_point_similarity,
    registered_positions,
    registered_surfaces,
    registration_start,
    rotation_angle,
)


def skin(n: int, seed: int = 0) -> Tensor:
    """Points on an ellipsoid of the axes 1, 1.4 and 2, spread evenly along a spiral, jittered, and shuffled."""
    random = np.random.default_rng(seed)
    height, angle = 1 - (2 * np.arange(n) + 1) / n, np.pi * (3 - 5**0.5) * np.arange(n) + random.uniform(0, 6)
    width = np.sqrt(1 - height**2)
    points = np.stack([width * np.cos(angle), width * np.sin(angle), height], axis=1)
    points += random.normal(scale=0.3 / n**0.5, size=points.shape)
    points *= np.array([1, 1.4, 2]) / np.linalg.norm(points, axis=1, keepdims=True)
    return torch.from_numpy(random.permutation(points))


def bent(points: Tensor) -> Tensor:
    """Bulged, pinched and curved, by up to half of the least axis."""
    x, y, z = points.T
    return torch.stack([x * (1 + 0.25 * z) + 0.1 * z**2, y * (1 - 0.15 * z), 1.1 * z + 0.3 * x * y], dim=1)


def off(found: Tensor, true: Tensor) -> float:
    return (found - true).norm(dim=1).mean().item()


def slow_drawn(points: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """One cloud drawn onto another, point by point; sums reach a hundredth of the points at first, then ever fewer."""
    n = len(points)
    near = [set(np.argsort(np.linalg.norm(points - point, axis=1))[:9]) for point in points]
    around = [[j for j in range(n) if j in near[i] or i in near[j]] for i in range(n)]
    size, aim = (np.sqrt(((cloud - cloud.mean(axis=0)) ** 2).sum(axis=1).mean()) for cloud in (points, goals))
    positions = goals.mean(axis=0) + (points - points.mean(axis=0)) * aim / size
    reach = round(0.01 * n)
    while reach >= 1:
        sums, counts = np.zeros((n, 3)), np.zeros(n)
        for goal in goals:
            pulled = np.argmin(np.linalg.norm(positions - goal, axis=1))
            sums[pulled] += goal
            counts[pulled] += 1
        for _ in range(reach):
            sums = np.array([sums[each].mean(axis=0) for each in around])
            counts = np.array([counts[each].mean() for each in around])
        moved = counts > 1e-6 * counts.mean()
        positions[moved] = sums[moved] / counts[moved, None]
        reach //= 2
    return positions


def slow_back(points: np.ndarray, others_on: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Beside the other point that came nearest, and as far away, in the other cloud's size."""
    size, aim = (np.sqrt(((cloud - cloud.mean(axis=0)) ** 2).sum(axis=1).mean()) for cloud in (points, others))
    nearest = [np.argmin(np.linalg.norm(others_on - point, axis=1)) for point in points]
    return others[nearest] + (points - others_on[nearest]) * aim / size


def test_it_is_the_slow_reference() -> None:
    """Of so many points that there are three rounds: averages that reach four neighbours, two, and one."""
    x, y = skin(400), bent(skin(450, seed=1))
    found = registered_positions(x, y)
    x, y = x.numpy(), y.numpy()
    x_on_y, y_on_x = slow_drawn(x, y), slow_drawn(y, x)
    expected = (x_on_y + slow_back(x, y_on_x, y)) / 2, (y_on_x + slow_back(y, x_on_y, x)) / 2
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)


def test_a_cloud_stays_on_itself() -> None:
    x = skin(700)
    order = torch.randperm(700, generator=torch.Generator().manual_seed(1))
    on_y, on_x = registered_positions(x, x[order])
    spacing = KDTree(x.numpy()).query(x.numpy(), k=2)[0][:, 1].mean()
    assert off(on_y, x) < 0.5 * spacing and off(on_x, x[order]) < 0.5 * spacing


def test_a_bend_is_followed_where_nearest_points_do_not() -> None:
    """The same points, and others of the same surface; both ways."""
    x = skin(900)
    true, nearest = bent(x), KDTree(bent(x).numpy())
    alone = off(true[nearest.query(x - x.mean(dim=0) + true.mean(dim=0))[1]], true)
    order = torch.randperm(900, generator=torch.Generator().manual_seed(2))
    on_y, on_x = registered_positions(x, true[order])
    assert off(on_y, true) < 0.7 * alone and off(on_x, x[order]) < 0.7 * alone
    other = bent(skin(1200, seed=5))
    on_y, on_x = registered_positions(x, other)
    assert off(on_y, true) < 0.7 * alone and off(on_x, skin(1200, seed=5)) < 0.7 * alone


def test_places_and_sizes_do_not_matter() -> None:
    x, y = skin(300), bent(skin(400, seed=1))
    on_y, on_x = registered_positions(x, y)
    far_on_y, far_on_x = registered_positions(3 * x + 7, 0.01 * y - 40)
    # Rounding may tip who is nearest where two are as near.
    assert off(far_on_y, 0.01 * on_y - 40) < 3e-5 and off(far_on_x, 3 * on_x + 7) < 1e-2


def test_the_two_ways_are_one() -> None:
    x, y = skin(300), bent(skin(400, seed=1))
    there, back = registered_positions(x, y), registered_positions(y, x)
    torch.testing.assert_close(there[0], back[1])
    torch.testing.assert_close(there[1], back[0])


@pytest.mark.parametrize("n", [1, 2, 5])
def test_few_points_are_drawn_too(n: int) -> None:
    on_y, on_x = registered_positions(skin(n), skin(40, seed=3))
    assert on_y.shape == (n, 3) and on_x.shape == (40, 3)
    assert torch.isfinite(on_y).all() and torch.isfinite(on_x).all()


def test_it_keeps_the_kind_of_number() -> None:
    on_y, on_x = registered_positions(skin(50).float(), skin(60).float())
    assert on_y.dtype == on_x.dtype == torch.float32


def rotation_about_z(degrees: float) -> Tensor:
    return torch.from_numpy(Rotation.from_euler("z", degrees, degrees=True).as_matrix())


def test_points_that_are_doubled_change_nothing_if_they_share_their_area() -> None:
    """By hand: twice the points in one half, each of half the area, pull as the points did once."""
    x, y = skin(500), bent(skin(600, seed=1))
    upper = y[:, 2] > 0
    doubled, areas = (
        torch.cat([y, y[upper]]),
        torch.cat([torch.where(upper, 0.5, 1.0), torch.full((int(upper.sum()),), 0.5)]),
    )
    plain, _ = registered_positions(x, y, settings=RegistrationSettings(start_width=0))
    shared, _ = registered_surfaces(
        SampledSurface(x), SampledSurface(doubled, areas.double()), settings=RegistrationSettings(start_width=0)
    )
    alike, _ = registered_positions(x, doubled, settings=RegistrationSettings(start_width=0))
    assert off(shared, plain) < 0.1 * off(alike, plain)


def test_areas_make_up_for_unlike_sampling() -> None:
    """A skin against itself, with four times as many points above as below."""
    x, many = skin(800), skin(3000, seed=1)
    kept = (many[:, 2] > 0) | (torch.arange(3000) % 4 == 0)
    y, areas = many[kept], torch.where(many[kept][:, 2] > 0, 1.0, 4.0).double()
    by_area = registered_surfaces(SampledSurface(x), SampledSurface(y, areas))
    alike = registered_positions(x, y)
    assert off(by_area[0], x) < 0.5 * off(alike[0], x)
    assert off(by_area[1], y) < 0.5 * off(alike[1], y)
    # The two ways are one.
    back = registered_surfaces(SampledSurface(y, areas), SampledSurface(x))
    torch.testing.assert_close(back[0], by_area[1])


def lobed(points: Tensor) -> Tensor:
    """With three lobes about the third axis."""
    out = points / points.norm(dim=1, keepdim=True)
    x, y, z = out.T
    return out * (1 + 0.6 * (x**2 + y**2) * torch.cos(3 * torch.atan2(y, x)) + 0.3 * z)[:, None]


def test_the_start_turns_a_distinct_form_back() -> None:
    turn, y = rotation_about_z(12), 2 * lobed(skin(1700, seed=1)) + 5
    start = registration_start(SampledSurface(lobed(skin(1500)) @ turn.T), SampledSurface(y))
    assert rotation_angle(start.similarity.rotation @ turn) < 3
    assert abs(start.similarity.scale - 2) < 0.05


def test_the_start_leaves_a_form_that_is_smooth_all_round_as_it_stands() -> None:
    """Two spheres: nothing tells a turn."""
    x, y = (skin(1200, seed=seed) / torch.tensor([1, 1.4, 2]) for seed in (0, 1))
    assert rotation_angle(registration_start(SampledSurface(x), SampledSurface(y)).similarity.rotation) < 2


def test_a_start_that_is_given_is_taken() -> None:
    x, turn = bent(skin(700)), rotation_about_z(60)
    start = Similarity(turn, 3.0, torch.ones(3).double())
    on_y, on_x = registered_positions(x, start(x), start=RegistrationStart(start))
    assert off(on_y, start(x)) < 0.15 and off(on_x, x) < 0.05


def horned(points: Tensor) -> tuple[Tensor, Tensor]:
    """With three lobes and a horn, which shifts its centre and its size; and which points are on the horn."""
    along = (points / points.norm(dim=1, keepdim=True)) @ torch.tensor([0, 0.6, 0.8], dtype=points.dtype)
    on_horn = along > 0.9
    return lobed(points) * (1 + 12 * (along - 0.9) * on_horn)[:, None], on_horn


def surface(seed: int) -> trimesh.Trimesh:
    """An ellipsoid, which is to become something else, in triangles of its own."""
    points = skin(2500, seed=seed).numpy()
    return trimesh.Trimesh(points, ConvexHull(points).simplices, process=False)


def normals_of(points: Tensor, mesh: trimesh.Trimesh) -> Tensor:
    """Outward, of a surface whose points were moved along rays from the middle."""
    mesh = trimesh.Trimesh(points.numpy(), mesh.faces, process=False)
    normals = torch.tensor(np.array(mesh.face_normals))
    outward = (normals * torch.tensor(np.array(mesh.triangles_center))).sum(dim=1).sign()
    summed = torch.zeros_like(points)
    for corner in torch.tensor(np.array(mesh.faces)).T.long():
        summed.index_add_(0, corner, normals * outward[:, None])
    return summed / summed.norm(dim=1, keepdim=True)


@pytest.mark.parametrize("degrees", [0, 12])
def test_a_part_that_one_lacks_misleads_no_start_with_normals(degrees: float) -> None:
    """Truth: y is x with a horn, turned, shifted and made larger; most of it is a copy."""
    turn, meshes = rotation_about_z(degrees), (surface(0), surface(1))
    x, (y, _) = lobed(torch.tensor(np.array(meshes[0].vertices))), horned(torch.tensor(np.array(meshes[1].vertices)))
    normals = normals_of(x, meshes[0]), normals_of(y, meshes[1]) @ turn.T
    y = 1.3 * y @ turn.T + 5
    goal, on_horn = horned(torch.tensor(np.array(meshes[0].vertices)))
    goal = 1.3 * goal @ turn.T + 5
    surfaces = SampledSurface(x, normals=normals[0]), SampledSurface(y, normals=normals[1])
    start, plain = registration_start(*surfaces), registration_start(SampledSurface(x), SampledSurface(y))
    assert start.near_rigid and not plain.near_rigid
    errors = [off(each.similarity(x)[~on_horn], goal[~on_horn]) for each in (start, plain)]
    assert errors[0] < 0.05 and errors[0] < 0.5 * errors[1]
    on_y, _ = registered_surfaces(*surfaces, start=start)
    assert off(on_y[~on_horn], goal[~on_horn]) < 0.08


def test_a_smooth_form_that_differs_is_no_rigid_copy() -> None:
    meshes = surface(0), surface(1)
    x, y = (torch.tensor(np.array(mesh.vertices)) for mesh in meshes)
    y = bent(y)
    surfaces = (SampledSurface(each, normals=normals_of(each, mesh)) for each, mesh in zip((x, y), meshes, strict=True))
    assert not registration_start(*surfaces).near_rigid


@pytest.mark.parametrize(("name", "shape"), [("areas", (40, 1)), ("normals", (39, 3))])
def test_areas_and_normals_are_those_of_the_points(name: str, shape: tuple[int, ...]) -> None:
    with pytest.raises(ArgumentError, match=f"{name} have shape .*, but must have shape"):
        SampledSurface(skin(40), **{name: torch.ones(shape)})


def test_what_is_nearly_rigid_does_not_shrink() -> None:
    """Of a copy that lies where it belongs: a mean of positions draws what the other lacks into it."""
    x = lobed(skin(1500))
    there = Similarity(torch.eye(3), 1.0, torch.zeros(3))
    y = lobed(skin(1700, seed=1))
    y, cut = y[y[:, 2] < 0.5], x[:, 2] > 0.7
    rigid, drawn = (registered_positions(x, y, start=RegistrationStart(there, rigid))[0] for rigid in (True, False))
    assert off(rigid[cut], x[cut]) < 0.7 * off(drawn[cut], x[cut])


def test_closest_points_leave_out_what_the_other_lacks() -> None:
    """A tenth of the points more, far off, on one of them."""
    whole = lobed(skin(2000))
    turn = rotation_about_z(8)
    true = Similarity(turn, 1.1, torch.ones(3).double())
    more = torch.cat([true(whole), true(whole[:200]) + 10])
    assert off(closest_point_similarity(whole, more, kept=0.9)(whole), true(whole)) < 1e-6
    assert off(closest_point_similarity(whole, more, kept=1.0)(whole), true(whole)) > 0.05


def test_normals_tell_the_sides_of_a_thin_plate() -> None:
    """It begins one thickness off, where each side lies nearest to the other side of the other plate."""
    flat = torch.rand(800, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    side = torch.where(torch.arange(800) % 2 == 0, 1.0, -1.0).double()[:, None]
    plate, normals = torch.cat([flat, 0.05 * side], dim=1), torch.cat([torch.zeros(800, 2).double(), side], dim=1)
    moved = plate + torch.tensor([0, 0, 0.08], dtype=torch.float64)
    told = closest_point_similarity(moved, plate, normals_x=normals, normals_y=normals)
    assert off(told(moved), plate) < 1e-6
    first = closest_point_similarity(moved, plate, normals_x=normals, normals_y=normals, steps=1)
    assert off(first(moved), plate) < 0.3 * off(closest_point_similarity(moved, plate, steps=1)(moved), plate)


def contours(points: Tensor, mesh: trimesh.Trimesh, n: int) -> Tensor:
    """A surface in some horizontal slices; 150 points of each, along the contour."""
    mesh = trimesh.Trimesh(points.numpy(), mesh.faces, process=False)
    low, high = mesh.bounds[:, 2]
    random, rows = np.random.default_rng(0), []
    for height in np.linspace(low, high, 2 * n + 1)[1::2]:
        ends = trimesh.intersections.mesh_plane(mesh, (0, 0, 1), (0, 0, height))
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        drawn = random.choice(len(ends), 150, p=lengths / lengths.sum())
        along = random.random((150, 1))
        rows.append((1 - along) * ends[drawn, 0] + along * ends[drawn, 1])
    return torch.from_numpy(np.concatenate(rows))


@pytest.mark.parametrize("turns", [False, True])
def test_slices_of_a_surface_stay_on_it(turns: bool) -> None:
    """Truth: the slices are the surface's own, in other units and at another place; centre and size do not tell it."""
    mesh = surface(0)
    whole = lobed(torch.tensor(np.array(mesh.vertices)))
    slices = contours(whole, mesh, 16)
    moved = SampledSurface(3 * slices + 5, torch.from_numpy(areas_by_density(slices.numpy())), in_lines=True)
    full = SampledSurface(whole, normals=normals_of(whole, mesh))
    start = registration_start(full, moved, turns=turns)
    assert start.near_rigid
    assert off(start.similarity(whole), 3 * whole + 5) < 3 * 0.03
    assert off(registered_surfaces(full, moved, start=start)[1], slices) < 0.05
    # The other way round, too.
    back = registration_start(moved, full, turns=turns)
    assert back.near_rigid
    assert off(back.similarity(3 * slices + 5), slices) < 0.03


def test_slices_of_a_surface_that_is_bent_are_no_copy_and_are_followed() -> None:
    mesh = surface(0)
    whole = lobed(torch.tensor(np.array(mesh.vertices)))
    slices = contours(whole, mesh, 16)
    full, areas = SampledSurface(bent(whole), normals=None), torch.from_numpy(areas_by_density(slices.numpy()))
    start = registration_start(full, SampledSurface(slices, areas, in_lines=True), turns=False)
    assert not start.near_rigid
    in_lines, not_told = (
        off(registered_surfaces(full, SampledSurface(slices, areas, in_lines=told), start=start)[1], bent(slices))
        for told in (True, False)
    )
    assert in_lines < 0.8 * not_told
