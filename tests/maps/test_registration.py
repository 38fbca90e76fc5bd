"""Clouds drawn onto each other, against maps that are known."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from torch import Tensor

from homolog.maps import (
    RegistrationSettings,
    Similarity,
    registered_positions,
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
    shared, _ = registered_positions(x, doubled, areas_y=areas.double(), settings=RegistrationSettings(start_width=0))
    alike, _ = registered_positions(x, doubled, settings=RegistrationSettings(start_width=0))
    assert off(shared, plain) < 0.1 * off(alike, plain)


def test_areas_make_up_for_unlike_sampling() -> None:
    """A skin against itself, with four times as many points above as below."""
    x, many = skin(800), skin(3000, seed=1)
    kept = (many[:, 2] > 0) | (torch.arange(3000) % 4 == 0)
    y, areas = many[kept], torch.where(many[kept][:, 2] > 0, 1.0, 4.0).double()
    by_area = registered_positions(x, y, areas_y=areas)
    alike = registered_positions(x, y)
    assert off(by_area[0], x) < 0.5 * off(alike[0], x)
    assert off(by_area[1], y) < 0.5 * off(alike[1], y)
    # The two ways are one.
    back = registered_positions(y, x, areas_x=areas)
    torch.testing.assert_close(back[0], by_area[1])


def lobed(points: Tensor) -> Tensor:
    """With three lobes about the third axis."""
    out = points / points.norm(dim=1, keepdim=True)
    x, y, z = out.T
    return out * (1 + 0.6 * (x**2 + y**2) * torch.cos(3 * torch.atan2(y, x)) + 0.3 * z)[:, None]


def test_the_start_turns_a_distinct_form_back() -> None:
    turn, y = rotation_about_z(12), 2 * lobed(skin(1700, seed=1)) + 5
    start = registration_start(lobed(skin(1500)) @ turn.T, y)
    assert rotation_angle(start.rotation @ turn) < 3
    assert abs(start.scale - 2) < 0.05


def test_the_start_leaves_a_form_that_is_smooth_all_round_as_it_stands() -> None:
    """Two spheres: nothing tells a turn."""
    x, y = (skin(1200, seed=seed) / torch.tensor([1, 1.4, 2]) for seed in (0, 1))
    assert rotation_angle(registration_start(x, y).rotation) < 2


def test_a_start_that_is_given_is_taken() -> None:
    x, turn = bent(skin(700)), rotation_about_z(60)
    start = Similarity(turn, 3.0, torch.ones(3).double())
    on_y, on_x = registered_positions(x, start(x), start=start)
    assert off(on_y, start(x)) < 0.15 and off(on_x, x) < 0.05
