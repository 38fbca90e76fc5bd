"""What a pair teaches: the losses put together, against the same written out slowly and the published code."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from homolog.core.errors import ArgumentError
from homolog.features import DiffusionNet, NetworkSettings, load_weights
from homolog.features.published import LAYOUTS
from homolog.geometry import Basis, OperatorSettings, compute_operators
from homolog.maps import functional_map, registered_positions, resolvent_mask
from homolog.shapes import Shape
from homolog.training import AugmentationSettings, LossSettings, TrainingShape, pair_losses

SMALL = NetworkSettings(width=16, out_channels=12, blocks=2, dropout=0.5)
FEW = LossSettings(map_eigenpairs=15)
Losses = dict[str, Tensor]
NAMES = ("bijectivity", "orthogonality", "alignment", "infonce", "commutativity", "smoothness", "registration")


def network_of(seed: int = 0) -> DiffusionNet:
    torch.manual_seed(seed)
    network = DiffusionNet(SMALL)
    with torch.no_grad():
        for block in network.blocks:
            block.times.uniform_(0, 0.05)
    return network.eval()


def both(shape: Shape, name: str = "") -> TrainingShape:
    wanted = OperatorSettings(n_eigenpairs=20)
    bases = [compute_operators(s, settings=wanted).basis for s in (shape, shape.as_cloud())]
    return TrainingShape(name, *bases)


@pytest.fixture(scope="module")
def pair(make) -> tuple[TrainingShape, TrainingShape]:
    """A blob, and another of fewer points that is a little longer."""
    blob = make.blob(2)
    kept = make.sphere(1)
    other = Shape(blob.points[: kept.n_points] * [1, 1.2, 0.9], kept.faces)
    return both(blob, "blob"), both(other, "long")


def reordered(basis: Basis, order: Tensor) -> Basis:
    return Basis(
        basis.points[order],
        basis.mass[order],
        basis.eigenvalues,
        basis.eigenvectors[order],
        basis.gradients[order],
        basis.pseudo_inverse[:, order],
    )


def sparse_selection(order: Tensor, n: int) -> Tensor:
    """Row i takes entry ``order[i]``."""
    starts = torch.arange(len(order) + 1)
    return torch.sparse_csr_tensor(starts, order, torch.ones(len(order)), (len(order), n), check_invariants=True)


def weighted(settings: LossSettings, **weights: float) -> LossSettings:
    return replace(settings, weights={**settings.weights, **weights})


def values(losses: Losses) -> dict[str, float]:
    return {name: float(value.detach()) for name, value in losses.items()}


def gradients(network: DiffusionNet, losses: Losses) -> dict[str, Tensor]:
    network.zero_grad()
    losses["total"].backward()
    return {name: parameter.grad.clone() for name, parameter in network.named_parameters()}


def assert_same(found: Losses, expected: Losses, rel: float = 1e-4) -> None:
    assert values(found) == pytest.approx(values(expected), rel=rel, abs=1e-7)


# --- the losses put together


def slow_losses(network: DiffusionNet, x: TrainingShape, y: TrainingShape, settings: LossSettings) -> dict[str, Tensor]:
    """Of a complete pair without weights, in float64 from the features on."""
    k = settings.map_eigenpairs
    bases = {"x": x.mesh, "y": y.mesh, "X": x.cloud, "Y": y.cloud}
    clouds = x.cloud.points, y.cloud.points
    features = {key: network(b.points, b).double() for key, b in bases.items()}
    unit = {key: value / value.norm(dim=1, keepdim=True) for key, value in features.items()}
    phi = {"x": x.mesh.eigenvectors[:, :k].double(), "y": y.mesh.eigenvectors[:, :k].double()}
    mass, values = {"x": x.mesh.mass, "y": y.mesh.mass}, {"x": x.mesh.eigenvalues[:k], "y": y.mesh.eigenvalues[:k]}
    a, b = (phi[s].T @ (mass[s].double()[:, None] * features[s]) for s in "xy")
    there = functional_map(a, b, resolvent_mask(values["x"], values["y"]), regularisation=settings.regularisation)
    back = functional_map(b, a, resolvent_mask(values["y"], values["x"]), regularisation=settings.regularisation)
    eye = torch.eye(k, dtype=torch.float64)
    logits = unit["Y"] @ unit["X"].T / settings.soft_temperature
    for _ in range(settings.soft_iterations):
        logits = torch.log_softmax(torch.log_softmax(logits, dim=0), dim=1)
    positions = {s: phi[s].T @ (mass[s].double()[:, None] * bases[s].points) for s in "xy"}
    stretch = max(values["x"].max(), values["y"].max())
    plain, (_, wanted) = unit["Y"] @ unit["X"].T / settings.soft_temperature, registered_positions(*clouds)
    offsets = wanted[:, None] - x.cloud.points
    near = torch.softmax(-offsets.square().sum(dim=2).double() / (2 * settings.registration_reach**2), dim=1)
    crossed = (there * values["x"] - values["y"][:, None] * there, back * values["y"] - values["x"][:, None] * back)
    return {
        "bijectivity": sum(((m - eye) ** 2).sum() for m in (there @ back, back @ there)),
        "orthogonality": sum(((c.T @ c - eye) ** 2).sum() for c in (there, back)),
        "alignment": ((phi["y"] @ there.detach() - logits.exp() @ phi["x"]) ** 2).sum() * 5000 / len(phi["y"]),
        "infonce": sum(
            torch.nn.functional.cross_entropy(
                unit[s.upper()] @ unit[s].T / settings.infonce_temperature, torch.arange(len(unit[s]))
            )
            for s in "xy"
        ),
        "commutativity": sum((c**2).sum() for c in crossed) / stretch**2,
        "smoothness": sum(
            (values[s][:, None] * (c @ positions[o] - positions[s]) ** 2).sum()
            for c, o, s in ((there, "x", "y"), (back, "y", "x"))
        ),
        "registration": torch.nn.functional.cross_entropy(plain, near)
        - torch.distributions.Categorical(near).entropy().mean(),
    }


def test_a_full_pair_s_losses_and_gradients_are_the_paper_s(pair) -> None:
    settings = LossSettings(
        map_eigenpairs=12,
        regularisation=30.0,
        weights={
            "bijectivity": 1.5,
            "orthogonality": 0.7,
            "alignment": 0.01,
            "infonce": 3.0,
            "commutativity": 500.0,
            "smoothness": 2.0,
            "registration": 20.0,
        },
        registration_reach=0.05,
        soft_temperature=0.15,
        soft_iterations=1,
        infonce_temperature=0.1,
    )
    network = network_of()
    slow = slow_losses(network, *pair, settings)
    expected = {name: settings.weights[name] * slow[name] for name in NAMES}
    expected["total"] = sum(expected.values())
    found = pair_losses(network, *pair, settings=settings)
    assert min(values(found).values()) > 0.1
    assert_same(found, expected, rel=1e-3)
    true = gradients(network, expected)
    for name, gradient in gradients(network, found).items():
        assert (gradient - true[name]).norm() < 1e-3 * true[name].norm() + 1e-5, name


def test_the_total_is_the_sum_and_weights_weigh(pair) -> None:
    network, full = network_of(), weighted(FEW, commutativity=1.0, smoothness=1.0, registration=1.0)
    losses = values(pair_losses(network, *pair, settings=full))
    assert list(losses) == [*NAMES, "total"]
    assert losses["total"] == pytest.approx(sum(losses[name] for name in NAMES))
    for name in NAMES:
        twice = weighted(full, **{name: 2 * full.weights[name]})
        doubled = values(pair_losses(network, *pair, settings=twice))
        without = values(pair_losses(network, *pair, settings=weighted(full, **{name: 0.0})))
        assert doubled[name] == pytest.approx(2 * losses[name]) and name not in without
        assert all(doubled[n] == without[n] == losses[n] for n in NAMES if n != name)
        assert without["total"] == pytest.approx(losses["total"] - losses[name])


def test_clouds_that_no_loss_looks_at_are_left_out_and_change_nothing(pair, monkeypatch) -> None:
    network = network_of()
    alone = replace(FEW, weights=dict.fromkeys(FEW.weights, 0.0) | {"bijectivity": 1.0, "orthogonality": 2.0})
    slow = slow_losses(network, *pair, alone)  # of four passes
    expected = {name: alone.weights[name] * slow[name] for name in ("bijectivity", "orthogonality")}
    expected["total"] = sum(expected.values())
    passed, several = [], network.several
    monkeypatch.setattr(network, "several", lambda *words, **more: passed.append(words[1]) or several(*words, **more))
    found = pair_losses(network, *pair, settings=alone)
    assert passed == [[pair[0].mesh, pair[1].mesh]]
    assert_same(found, expected, rel=1e-3)
    true = gradients(network, expected)
    for name, gradient in gradients(network, found).items():
        assert (gradient - true[name]).norm() < 1e-3 * true[name].norm() + 1e-5, name


def test_swapping_the_shapes_of_a_full_pair_changes_its_alignment_alone(pair) -> None:
    network, settings = network_of(), weighted(FEW, commutativity=1.0, smoothness=1.0)
    there = values(pair_losses(network, *pair, settings=settings))
    back = values(pair_losses(network, *reversed(pair), settings=settings))
    for name in ("bijectivity", "orthogonality", "infonce", "commutativity", "smoothness"):
        assert back[name] == pytest.approx(there[name], rel=1e-4)
    assert back["alignment"] != pytest.approx(there["alignment"], rel=1e-2)


def test_a_shape_and_itself_cost_less_than_two(pair) -> None:
    network, x = network_of(), pair[0]
    same, other = (pair_losses(network, x, y, settings=FEW) for y in pair)
    assert same["bijectivity"] < other["bijectivity"] and same["orthogonality"] < other["orthogonality"]


def test_a_part_is_compared_by_as_many_functions_as_it_can_tell_apart(pair) -> None:
    network, (x, y) = network_of(), pair
    # At half the area eigenvalues are twice as large: 1 + those below the largest of the complete shape.
    part = replace(y, mesh=replace(y.mesh, eigenvalues=2 * x.mesh.eigenvalues))
    losses = pair_losses(network, x, part, settings=FEW, partial=True)
    largest = x.mesh.eigenvalues[14]
    rank = 1 + int((2 * x.mesh.eigenvalues[:15] < largest).sum())
    assert rank < 12
    a, b = (shape.mesh.pseudo_inverse[:15] @ network(shape.mesh.points, shape.mesh) for shape in (x, part))
    mask = resolvent_mask(x.mesh.eigenvalues[:15], part.mesh.eigenvalues[:15])
    there, back = functional_map(a, b, mask), functional_map(b, a, mask.T)
    wanted = torch.diag((torch.arange(15) < rank).float())
    assert losses["bijectivity"].item() == pytest.approx((there @ back - wanted).square().sum().item(), rel=1e-4)
    assert losses["orthogonality"].item() == pytest.approx((there @ there.T - wanted).square().sum().item(), rel=1e-4)
    cloud_x, cloud_y = (torch.nn.functional.normalize(network(s.cloud.points, s.cloud), dim=1) for s in (x, part))
    soft = torch.softmax(cloud_y @ cloud_x.T / FEW.soft_temperature, dim=1)
    misfit = (part.mesh.eigenvectors[:, :15] @ there - soft @ x.mesh.eigenvectors[:, :15]).square().sum()
    assert losses["alignment"].item() == pytest.approx(5000 / len(cloud_y) * 1e-3 * misfit.item(), rel=1e-3)
    gradients(network, losses)


def test_raw_products_use_features_as_they_come(pair) -> None:
    network, larger = network_of(), network_of()
    with torch.no_grad():
        for parameter in larger.last.parameters():
            parameter.mul_(3)

    def losses(network: DiffusionNet, **settings) -> Losses:
        return pair_losses(network, *pair, settings=replace(FEW, **settings))

    # Features three times as long give the same functional maps at nine times the regularisation, and where products
    # are taken of them the same soft map at nine times the temperature.
    assert_same(losses(larger, regularisation=900.0), losses(network))
    raw = {"raw_products": True}
    assert_same(losses(larger, regularisation=900.0, soft_temperature=0.9, **raw), losses(network, **raw))
    longer, shorter = losses(larger, regularisation=900.0, **raw), losses(network, **raw)
    assert not torch.isclose(longer["alignment"], shorter["alignment"], rtol=0.05)


# --- clouds at other points than their mesh's


def test_an_identity_as_pairing_is_none(pair) -> None:
    network = network_of()
    paired = [
        replace(shape, pairing=sparse_selection(torch.arange(shape.mesh.n_points), shape.mesh.n_points))
        for shape in pair
    ]
    found, expected = pair_losses(network, *paired, settings=FEW), pair_losses(network, *pair, settings=FEW)
    assert_same(found, expected)
    true = gradients(network, expected)
    for name, gradient in gradients(network, found).items():
        torch.testing.assert_close(gradient, true[name], rtol=1e-3, atol=1e-4)


def test_a_cloud_in_another_order_costs_the_same_where_its_pairing_says_so(pair) -> None:
    network, (x, y) = network_of(), pair
    orders = [torch.randperm(s.mesh.n_points, generator=torch.Generator().manual_seed(1)) for s in pair]
    shuffled = [
        TrainingShape(s.name, s.mesh, reordered(s.cloud, order), sparse_selection(order, s.mesh.n_points))
        for s, order in zip(pair, orders, strict=True)
    ]
    expected = pair_losses(network, x, y, settings=FEW)
    assert_same(pair_losses(network, *shuffled, settings=FEW), expected, rel=1e-3)
    unpaired = [replace(shape, pairing=None) for shape in shuffled]
    assert pair_losses(network, *unpaired, settings=FEW)["infonce"] > 1.01 * expected["infonce"]


def test_a_pairing_takes_functions_to_fewer_points(pair) -> None:
    x = pair[0]
    kept = torch.arange(0, x.mesh.n_points, 2)
    shape = TrainingShape("few", x.mesh, x.cloud.sampled(kept), sparse_selection(kept, x.mesh.n_points))
    assert torch.equal(shape.at_cloud(x.mesh.eigenvectors), x.mesh.eigenvectors[kept])
    network = network_of()
    few, all_points = (pair_losses(network, x, y, settings=FEW) for y in (shape, x))
    assert few["bijectivity"] == all_points["bijectivity"]
    # Each of half as many samples stands for two points.
    assert few["alignment"].item() == pytest.approx(all_points["alignment"].item(), rel=0.15)


# --- what is random


def test_the_generator_alone_decides_a_pair_s_losses(pair) -> None:
    network = network_of().train()

    def losses(seed: int | None, augmentation: AugmentationSettings | None) -> dict[str, float]:
        generator = None if seed is None else torch.Generator().manual_seed(seed)
        return values(pair_losses(network, *pair, settings=FEW, augmentation=augmentation, generator=generator))

    for augmentation in (None, AugmentationSettings(turn="any")):
        first = losses(3, augmentation)
        torch.manual_seed(17)
        assert losses(3, augmentation) == first
        assert losses(4, augmentation)["total"] != first["total"]
    assert losses(3, None) != losses(3, AugmentationSettings())


def test_augmentation_needs_no_generator_and_each_pass_has_its_own(pair) -> None:
    network = network_of()
    still, moved = (
        pair_losses(network, *pair, settings=FEW, augmentation=augmentation)["infonce"]
        for augmentation in (None, AugmentationSettings())
    )
    assert not torch.equal(still, moved)
    # A mesh and a cloud of the same basis resemble each other perfectly unless they were varied apart.
    equal = [replace(shape, cloud=shape.mesh) for shape in pair]
    same, apart = (
        pair_losses(network, *equal, settings=FEW, augmentation=augmentation)["infonce"]
        for augmentation in (None, AugmentationSettings(turn="any"))
    )
    assert apart > 1.01 * same


def test_points_are_not_changed_by_their_augmentation(pair) -> None:
    before = [basis.points.clone() for shape in pair for basis in (shape.mesh, shape.cloud)]
    pair_losses(network_of(), *pair, settings=FEW, augmentation=AugmentationSettings())
    after = [basis.points for shape in pair for basis in (shape.mesh, shape.cloud)]
    assert all(torch.equal(one, other) for one, other in zip(before, after, strict=True))


# --- training


@pytest.mark.parametrize("partial", [False, True], ids=["full", "partial"])
def test_a_few_steps_reduce_the_losses(partial: bool, pair) -> None:
    network = network_of()
    optimiser, generator = torch.optim.Adam(network.parameters(), lr=3e-3), torch.Generator().manual_seed(0)
    before = values(pair_losses(network, *pair, settings=FEW, partial=partial))
    network.train()
    for _ in range(20):
        optimiser.zero_grad()
        pair_losses(
            network,
            *pair,
            settings=FEW,
            augmentation=AugmentationSettings(degrees=10),
            generator=generator,
            partial=partial,
        )["total"].backward()
        optimiser.step()
    after = values(pair_losses(network.eval(), *pair, settings=FEW, partial=partial))
    assert after["total"] < 0.8 * before["total"], (before, after)


@pytest.mark.parametrize("partial", [False, True], ids=["full", "partial"])
def test_training_keeps_nothing_between_all_points_of_two_shapes(partial: bool, make, large_tensors) -> None:
    x = both(make.blob(3))
    n, network, kept = x.mesh.n_points, network_of().train(), []
    with large_tensors(4 * n * n) as seen:
        with torch.autograd.graph.saved_tensors_hooks(lambda t: kept.append(t.numel()) or t, lambda t: t):
            total = pair_losses(network, x, x, settings=FEW, partial=partial)["total"]
        total.backward()
    assert max(kept) <= 4 * n * 2 * SMALL.width < n * n  # two components of all channels, in four passes
    assert seen.most_alive <= 1  # of tiles, which are all of a matrix this small


# --- settings


@pytest.mark.parametrize(
    ("name", "value"),
    [("regularisation", value) for value in (-1.0, float("inf"), float("nan"))]
    + [(name, value) for name in ("soft_temperature", "infonce_temperature") for value in (0.0, -1.0, float("inf"))]
    + [(name, value) for name in ("map_eigenpairs", "soft_iterations") for value in (0, -3)],
)
def test_settings_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(ArgumentError, match=f"^{name} is {value}, but must be"):
        LossSettings(**{name: value})


# --- the numbers of the published code


@pytest.fixture(scope="module")
def published(reference, stored_operators: Callable) -> tuple[DiffusionNet, Losses]:
    network = load_weights(reference / "surreal.pth").network
    x, y = (
        TrainingShape(side, *(stored_operators(f"{side}_{kind}").basis for kind in ("mesh", "cloud"))) for side in "xy"
    )
    losses = pair_losses(network, x, y, settings=LossSettings(raw_products=True, soft_temperature=0.2))
    losses["total"].backward()
    return network, losses


@pytest.mark.reference
def test_losses_of_a_pair_are_those_of_the_published_code(published, faust) -> None:
    found = values(published[1])
    theirs = ("l_bij", "l_orth", "l_align", "l_nce")
    for name, their in zip((*NAMES[:4], "total"), (*theirs, "l_total"), strict=True):
        assert found[name] == pytest.approx(float(faust[their]), rel=1e-4), name
    assert list(found) == [*NAMES[:4], "total"]


@pytest.mark.reference
def test_gradients_of_a_pair_are_those_of_the_published_code(published, faust) -> None:
    parameters = dict(published[0].named_parameters())
    names = [name for name in faust if name.startswith("grad:")]
    assert len(names) == 16
    for name in names:
        found, expected = parameters[LAYOUTS[0].own_name(name.removeprefix("grad:"))].grad.numpy(), faust[name]
        assert np.linalg.norm(found - expected) < 1e-2 * np.linalg.norm(expected), name


def test_registration_targets_that_are_given_are_used(pair) -> None:
    network, (x, y), settings = network_of(), pair, weighted(FEW, registration=2.0)
    own = registered_positions(x.cloud.points, y.cloud.points)[1]
    plain, given, opposite = (
        pair_losses(network, x, y, settings=settings, registration_targets=targets)["registration"]
        for targets in (None, own, -own)
    )
    assert given == plain and opposite > plain + 0.5


def test_partial_clouds_have_no_registration_and_no_alignment_from_them(pair) -> None:
    """With a partial cloud of the first shape there is no alignment; with one of the second, no Sinkhorn."""
    network, (x, y), settings = network_of(), pair, weighted(FEW, registration=1.0)
    whole = pair_losses(network, x, y, settings=settings)
    first = pair_losses(network, replace(x, cloud_is_partial=True), y, settings=settings)
    assert first["alignment"] == first["registration"] == 0 and whole["alignment"] > 0 and whole["registration"] > 0
    assert first["infonce"] == whole["infonce"] and first["bijectivity"] == whole["bijectivity"]
    second = pair_losses(network, x, replace(y, cloud_is_partial=True), settings=settings)
    softly = pair_losses(network, x, y, settings=settings, partial=True)
    assert second["registration"] == softly["registration"] == 0
    assert second["alignment"].item() == pytest.approx(softly["alignment"].item(), rel=1e-5)
    assert second["alignment"].item() != pytest.approx(whole["alignment"].item(), rel=1e-3)
