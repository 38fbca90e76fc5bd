"""The losses against formulas written out slowly in float64, their gradients, and the published code's numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from homolog.core.errors import ArgumentError
from homolog.core.memory import working_memory
from homolog.maps.losses import (
    alignment_loss,
    bijectivity_loss,
    commutativity_loss,
    descriptor_loss,
    infonce_loss,
    multiplication_operators,
    orthogonality_loss,
    partial_alignment_loss,
    partial_bijectivity_loss,
    partial_orthogonality_loss,
    partial_rank,
    registration_loss,
    smoothness_loss,
)

MEMORIES = (1e-6, 0.01, 1024.0)


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def unit(*shape: int, seed: int = 0) -> Tensor:
    return torch.nn.functional.normalize(random(*shape, seed=seed), dim=1)


def orthogonal(k: int, seed: int = 0) -> Tensor:
    return torch.linalg.qr(random(k, k, seed=seed)).Q


# --- losses of functional maps


def test_losses_of_maps_are_sums_over_their_entries() -> None:
    c_xy, c_yx = random(3, 4).numpy(), random(4, 3, seed=1).numpy()

    def misfit(left: np.ndarray, right: np.ndarray) -> float:
        """|left right - I|^2, entry by entry."""
        return sum(
            (sum(left[i, m] * right[m, j] for m in range(left.shape[1])) - (i == j)) ** 2
            for i in range(left.shape[0])
            for j in range(right.shape[1])
        )

    np.testing.assert_allclose(bijectivity_loss(c_xy, c_yx), misfit(c_xy, c_yx) + misfit(c_yx, c_xy))
    np.testing.assert_allclose(orthogonality_loss(c_xy, c_yx), misfit(c_xy.T, c_xy) + misfit(c_yx.T, c_yx))
    x, y = random(4, seed=2).abs().numpy(), random(3, seed=3).abs().numpy()
    crossed = sum((c_xy[i, j] * (x[j] - y[i]) / max(*x, *y)) ** 2 for i in range(3) for j in range(4))
    np.testing.assert_allclose(commutativity_loss(c_xy, x, y), crossed)
    d_x, d_y = random(4, 2, 4, seed=6).numpy(), random(3, 2, 3, seed=7).numpy()
    apart = [c_xy @ d_x[:, i] - d_y[:, i] @ c_xy for i in range(2)]
    np.testing.assert_allclose(descriptor_loss(c_xy, d_x, d_y), sum((each**2).sum() for each in apart) / 2)
    here, there = random(4, 3, seed=4).numpy(), random(3, 3, seed=5).numpy()
    moved = [[sum(c_xy[i, j] * here[j, a] for j in range(4)) - there[i, a] for a in range(3)] for i in range(3)]
    rough = sum(y[i] * moved[i][a] ** 2 for i in range(3) for a in range(3))
    np.testing.assert_allclose(smoothness_loss(c_xy, here, there, y), rough)


def test_maps_that_do_what_is_asked_cost_nothing() -> None:
    c, turn, values = random(5, 5), orthogonal(5), random(5).abs()
    assert bijectivity_loss(c, torch.linalg.inv(c)) < 1e-20 and orthogonality_loss(c, torch.linalg.inv(c)) > 1
    assert orthogonality_loss(turn, turn.T) < 1e-20 and bijectivity_loss(turn, turn) > 1
    assert commutativity_loss(torch.diag(values), values, values) == 0
    assert commutativity_loss(turn, values, values) > 0.1
    # Composition with a point map preserves products of functions, here of five points in two orders.
    order, phi, functions = torch.tensor([3, 0, 4, 1, 2]), random(5, 5, seed=9), random(5, 2, seed=10)
    x = multiplication_operators(functions, phi, torch.linalg.inv(phi))
    torch.testing.assert_close(phi @ x[:, 1] @ c[0], functions[:, 1] * (phi @ c[0]))
    y = multiplication_operators(functions[order], turn, turn.T)
    assert descriptor_loss(turn.T @ phi[order], x, y) < 1e-20 and descriptor_loss(turn.T @ phi, x, y) > 0.1
    # A part keeps three dimensions of five: the map's range is spanned by its first functions.
    part = torch.diag(torch.tensor([1.0, 1, 1, 0, 0], dtype=torch.float64)) @ turn
    assert partial_bijectivity_loss(part, part.T, rank=3) < 1e-20 and partial_orthogonality_loss(part, rank=3) < 1e-20
    for rank in (2, 4):
        assert partial_bijectivity_loss(part, part.T, rank=rank).item() == pytest.approx(1)
        assert partial_orthogonality_loss(part, rank=rank).item() == pytest.approx(1)
    # The other way round, from the part and back, is not asked for.
    assert partial_bijectivity_loss(part.T, part, rank=3) > 1


def test_a_displacement_costs_its_dirichlet_energy() -> None:
    """Of a sphere of unit area: its positions are its second to fourth eigenfunctions, of eigenvalue 2 / radius^2."""
    square = 1 / (4 * np.pi)
    values = torch.tensor([0.0, 2 / square, 2 / square, 2 / square], dtype=torch.float64)
    positions = torch.cat([torch.zeros(1, 3), (square / 3) ** 0.5 * torch.eye(3)]).double()
    eye = torch.eye(4, dtype=torch.float64)
    shifted = positions + torch.tensor([[5.0, -2, 1], [0, 0, 0], [0, 0, 0], [0, 0, 0]])
    assert smoothness_loss(eye, positions, shifted, values) < 1e-20
    for turn in (1.3 * torch.eye(3), -torch.eye(3), orthogonal(3)):
        energy = (turn - torch.eye(3)).square().sum().item() * 2 / 3  # that of a linear function, over unit area
        moved = positions @ turn.double().T
        assert smoothness_loss(eye, moved, positions, values).item() == pytest.approx(energy)


def test_positions_on_a_sphere_are_the_features_that_the_elastic_loss_wants() -> None:
    """There a product of positions falls off with their squared distance: |s - x|^2 = 2 - 2 s x."""
    x, skin, reach, temperature = unit(9, 3), unit(6, 3, seed=1), 0.4, 0.2
    right = x * temperature**0.5 / reach, skin * temperature**0.5 / reach
    assert registration_loss(*right, x, skin, reach=reach, temperature=temperature).item() == pytest.approx(
        0, abs=1e-12
    )
    for wrong in ((right[0].flip(0), right[1]), (right[0], right[1].flip(0)), (1.1 * right[0], right[1])):
        assert registration_loss(*wrong, x, skin, reach=reach, temperature=temperature) > 1e-3


def test_the_elastic_loss_is_the_mean_divergence_of_its_rows() -> None:
    features, x, skin = (random(5, 4), random(7, 4, seed=1)), random(5, 3, seed=2), random(7, 3, seed=3)
    total = 0.0
    for feature, place in zip(features[1].tolist(), skin.tolist(), strict=True):
        found = [
            math.exp(sum(a * b for a, b in zip(feature, other, strict=True)) / 0.3) for other in features[0].tolist()
        ]
        wanted = [math.exp(-(math.dist(place, other) ** 2) / (2 * 0.7**2)) for other in x.tolist()]
        for p, q in zip(found, wanted, strict=True):
            total += q / sum(wanted) * math.log(q / sum(wanted) / (p / sum(found))) / len(skin)
    assert registration_loss(*features, x, skin, reach=0.7, temperature=0.3).item() == pytest.approx(total)


@pytest.mark.parametrize("wrong", [{"reach": 0.0}, {"reach": -1.0}, {"temperature": 0.0}])
def test_a_reach_or_temperature_of_nothing_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ArgumentError, match=f"{next(iter(wrong))} is .*positive"):
        registration_loss(random(3, 2), random(3, 2), random(3, 3), random(3, 3), **wrong)


def test_full_rank_is_half_of_the_complete_losses() -> None:
    c_xy, c_yx = random(4, 4), random(4, 4, seed=1)
    there, back = (partial_bijectivity_loss(*maps, rank=4) for maps in ((c_xy, c_yx), (c_yx, c_xy)))
    torch.testing.assert_close(there + back, bijectivity_loss(c_xy, c_yx))
    rows = partial_orthogonality_loss(c_xy.T, rank=4) + partial_orthogonality_loss(c_yx.T, rank=4)
    torch.testing.assert_close(rows, orthogonality_loss(c_xy, c_yx))


def test_the_scale_of_eigenvalues_does_not_matter() -> None:
    c, x, y = random(3, 4), random(4, seed=1).abs(), random(3, seed=2).abs()
    torch.testing.assert_close(commutativity_loss(c, 1000 * x, 1000 * y), commutativity_loss(c, x, y))


@pytest.mark.parametrize(("faster", "rank"), [(0.5, 10), (1.0, 10), (2.0, 6), (4.0, 4), (1000.0, 2)])
def test_the_rank_of_a_part_follows_weyls_law(faster: float, rank: int) -> None:
    # Below 9 lie 0, 2, 4, 6, 8 of the part's eigenvalues if they grow twice as fast, and so on.
    assert partial_rank(torch.arange(10.0), faster * torch.arange(10.0)) == rank
    assert partial_rank(np.arange(10.0), faster * np.arange(10.0)) == rank


# --- alignment of soft maps and functional maps


def slow_alignment(c: Tensor, phi_x: Tensor, phi_y: Tensor, logits: Tensor, iterations: int | None) -> Tensor:
    """With Sinkhorn's map of the logits, or if there are no iterations the softmax of their rows."""
    for _ in range(iterations or 0):
        logits = logits - torch.logsumexp(logits, dim=0, keepdim=True)
        logits = logits - torch.logsumexp(logits, dim=1, keepdim=True)
    return (phi_y @ c - torch.softmax(logits, dim=1) @ phi_x).square().sum()


@pytest.mark.parametrize("memory", MEMORIES)
@pytest.mark.parametrize("temperature", [0.001, 0.07, 1.0])
@pytest.mark.parametrize("partial", [False, True], ids=["complete", "partial"])
def test_alignment_compares_eigenfunctions_carried_in_both_ways(
    partial: bool, temperature: float, memory: float
) -> None:
    c, phi_x, phi_y = random(4, 5), random(60, 5, seed=1), random(40, 4, seed=2)
    x, y = unit(60, 6, seed=3).requires_grad_(), unit(40, 6, seed=4).requires_grad_()
    expected = slow_alignment(c, phi_x, phi_y, y @ x.T / temperature, None if partial else 7)
    gradients = torch.autograd.grad(expected, (x, y))
    with working_memory(memory):
        loss = partial_alignment_loss if partial else alignment_loss
        options = {} if partial else {"iterations": 7}
        found = loss(c, phi_x, phi_y, x, y, temperature=temperature, **options)
        torch.testing.assert_close(found, expected, rtol=1e-10, atol=1e-10)
        for own, other in zip(torch.autograd.grad(found, (x, y)), gradients, strict=True):
            torch.testing.assert_close(own, other, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("loss", [alignment_loss, partial_alignment_loss])
def test_the_functional_map_teaches_the_features_and_not_the_other_way_round(loss) -> None:
    c, x, y = random(3, 3).requires_grad_(), unit(9, 4).requires_grad_(), unit(8, 4, seed=1).requires_grad_()
    loss(c, random(9, 3), random(8, 3), x, y).backward()
    assert c.grad is None and x.grad.abs().sum() > 0 and y.grad.abs().sum() > 0


def test_the_soft_map_of_a_part_does_not_depend_on_what_all_logits_of_a_row_share() -> None:
    c, phi_x, phi_y, x, y = random(3, 3), random(9, 3), random(8, 3), unit(9, 4), unit(8, 4, seed=1)
    shifted = torch.cat([x, torch.ones(9, 1)], dim=1), torch.cat([y, 5 * random(8, 1)], dim=1)
    torch.testing.assert_close(
        partial_alignment_loss(c, phi_x, phi_y, *shifted), partial_alignment_loss(c, phi_x, phi_y, x, y)
    )


def test_the_softmax_keeps_nothing_of_all_points_of_both_shapes(large_tensors) -> None:
    n, k = 1500, 4
    c, phi, x = random(k, k).float(), random(n, k).float(), unit(n, 6).float().requires_grad_()
    with large_tensors(4 * n * n / 2) as seen:
        partial_alignment_loss(c, phi, phi, x, x.detach()).backward()
        infonce_loss(x, x.detach()).backward()
    assert seen.most_alive == 0


# --- contrast


def slow_contrast(features: Tensor, counterparts: Tensor, temperature: float) -> Tensor:
    return torch.nn.functional.cross_entropy(features @ counterparts.T / temperature, torch.arange(len(features)))


def hardest(scale: float) -> dict[str, tuple[Tensor, Tensor]]:
    """Features that resemble their counterparts by chance, perfectly, and less than all others."""
    one, other = unit(70, 5) * scale, unit(70, 5, seed=1) * scale
    return {"chance": (one, other), "equal": (one, one.clone()), "opposite": (one, -one)}


@pytest.mark.parametrize("memory", MEMORIES)
@pytest.mark.parametrize("scale", [1.0, 3.0, 8.4], ids=["logits of 14", "of 129", "of 1000"])
@pytest.mark.parametrize("kind", ["chance", "equal", "opposite"])
def test_contrast_is_cross_entropy(kind: str, scale: float, memory: float) -> None:
    temperature = 0.07
    features = [tensor.float().double().requires_grad_() for tensor in hardest(scale)[kind]]
    expected = slow_contrast(*features, temperature)
    gradients = torch.autograd.grad(expected, features)
    logit = scale**2 / temperature
    for dtype, rounding in ((torch.float64, 1e-15), (torch.float32, 3e-7)):
        own = [tensor.detach().to(dtype).requires_grad_() for tensor in features]
        with working_memory(memory):
            found = infonce_loss(*own, temperature=temperature)
        assert found.dtype == dtype
        most = rounding * (10 + logit)
        torch.testing.assert_close(found.double(), expected, rtol=rounding * 10, atol=most)
        for mine, true in zip(torch.autograd.grad(found, own), gradients, strict=True):
            # A gradient is a mean of differences of features, over the temperature.
            assert (mine.double() - true).norm() <= most * (true.norm() + scale / temperature / len(true) ** 0.5)


@given(n=st.integers(1, 20), scale=st.floats(0.1, 8), seed=st.integers(0, 1000))
def test_contrast_lies_between_nothing_and_the_logarithm_for_equal_features(n: int, scale: float, seed: int) -> None:
    same = torch.ones(n, 3).double()
    torch.testing.assert_close(infonce_loss(same, same), torch.tensor(n).double().log(), atol=1e-9, rtol=0)
    features = scale * unit(n, 3, seed=seed)
    assert infonce_loss(features, features) >= 0
    # In another order it is the same mean.
    order = torch.randperm(n, generator=torch.Generator().manual_seed(seed))
    other = unit(n, 3, seed=seed + 1)
    torch.testing.assert_close(infonce_loss(features[order], other[order]), infonce_loss(features, other))


def test_contrast_scales_its_gradient_with_what_comes_in() -> None:
    features, other = unit(9, 4).requires_grad_(), unit(9, 4, seed=1)
    (once,) = torch.autograd.grad(infonce_loss(features, other), features)
    (thrice,) = torch.autograd.grad(-3 * infonce_loss(features, other), features)
    torch.testing.assert_close(thrice, -3 * once)


@pytest.mark.parametrize("temperature", [0.0, -0.07, float("nan")])
def test_a_temperature_that_is_not_positive_is_refused(temperature: float) -> None:
    with pytest.raises(ArgumentError, match="temperature"):
        infonce_loss(unit(3, 2), unit(3, 2), temperature=temperature)
    for loss in (alignment_loss, partial_alignment_loss):
        with pytest.raises(ArgumentError, match="temperature"):
            loss(random(2, 2), random(3, 2), random(3, 2), unit(3, 2), unit(3, 2), temperature=temperature)


# --- derivatives of all


def test_gradients_of_every_loss_are_right() -> None:
    maps = random(3, 3).requires_grad_(), random(3, 3, seed=1).requires_grad_()
    values = random(3, seed=2).abs(), random(3, seed=3).abs()
    features = unit(7, 4, seed=4).requires_grad_(), unit(7, 4, seed=5).requires_grad_()
    c, phi_x, phi_y = random(3, 3, seed=6), random(7, 3, seed=7), random(7, 3, seed=8)
    losses = (
        (bijectivity_loss, maps),
        (orthogonality_loss, maps),
        (lambda c_xy, c_yx: partial_bijectivity_loss(c_xy, c_yx, rank=2), maps),
        (lambda c_xy: partial_orthogonality_loss(c_xy, rank=2), maps[:1]),
        (lambda c_xy: commutativity_loss(c_xy, *values), maps[:1]),
        (descriptor_loss, (maps[0], *(random(3, 2, 3, seed=seed).requires_grad_() for seed in (9, 10)))),
        (lambda c_xy: smoothness_loss(c_xy, phi_x[:3], phi_y[:3], values[1]), maps[:1]),
        (lambda x, y: alignment_loss(c, phi_x, phi_y, x, y, temperature=0.3, iterations=3), features),
        (lambda x, y: partial_alignment_loss(c, phi_x, phi_y, x, y, temperature=0.3), features),
        (lambda x, y: registration_loss(x, y, phi_x, phi_y, reach=0.5, temperature=0.3), features),
        (lambda x, y: infonce_loss(x, y, temperature=0.3), features),
    )
    for loss, inputs in losses:
        assert torch.autograd.gradcheck(loss, inputs, eps=1e-6, atol=1e-7, rtol=1e-5)


# --- the numbers of the published code


@pytest.mark.reference
def test_losses_of_given_maps_and_features_are_those_of_the_published_code(faust) -> None:
    maps = faust["Cxy"], faust["Cyx"]
    assert bijectivity_loss(*maps) == pytest.approx(float(faust["l_bij"]), rel=1e-4)
    assert orthogonality_loss(*maps) == pytest.approx(float(faust["l_orth"]), rel=1e-4)
    assert partial_bijectivity_loss(*maps, rank=80) == pytest.approx(float(faust["partial_l_bij"]), rel=1e-4)
    assert partial_orthogonality_loss(maps[0], rank=80) == pytest.approx(float(faust["partial_l_orth"]), rel=1e-4)
    x, y = (faust[f"{side}_mesh_evecs"][:, :80] for side in "xy")
    aligned = 1e-3 * alignment_loss(maps[0], x, y, faust["x_cloud_features"], faust["y_cloud_features"])
    assert aligned == pytest.approx(float(faust["l_align"]), rel=1e-4)

    def unit_features(which: str) -> Tensor:
        return torch.nn.functional.normalize(torch.from_numpy(faust[f"{which}_features"]), dim=1)

    # The clouds' rows are those that must find their partners among the meshes'.
    pairs = [(unit_features(f"{side}_cloud"), unit_features(f"{side}_mesh")) for side in "xy"]
    forward, backward = (10 * sum(float(infonce_loss(*pair[::step])) for pair in pairs) for step in (1, -1))
    assert forward == pytest.approx(float(faust["l_nce"]), rel=1e-4)
    assert backward != pytest.approx(float(faust["l_nce"]), rel=1e-3)


@pytest.mark.reference
def test_losses_of_a_part_are_those_of_the_published_code(reference) -> None:
    with np.load(reference / "cuts_david.npz") as stored:
        david = {name: stored[name] for name in stored.files}
    rank = partial_rank(david["complete_evals"], david["partial_evals"])
    assert rank == david["ones"]
    c_xy, c_yx = david["C_complete_partial"], david["C_partial_complete"]
    assert partial_bijectivity_loss(c_xy, c_yx, rank=rank) == pytest.approx(float(david["l_bij"]), rel=1e-4)
    assert partial_orthogonality_loss(c_xy, rank=rank) == pytest.approx(float(david["l_orth"]), rel=1e-4)
    known = [david[f"{side}_{what}"] for what in ("evecs", "features") for side in ("complete", "partial")]
    aligned = 1e-3 * partial_alignment_loss(c_xy, *known)
    assert aligned == pytest.approx(float(david["l_align"]), rel=1e-4)
