"""DiffusionNet: its symmetries, its gradients, and the numbers of the published code."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from torch import Tensor

from homolog.core.errors import ArgumentError
from homolog.features import DiffusionNet, NetworkSettings, diffusion_net, heat_decay, load_weights
from homolog.features.block import Stack
from homolog.features.diffusion_net import DiffusionBlock, _kept
from homolog.geometry import Operators, OperatorSettings, compute_operators
from homolog.geometry.operators import compressed_rows

SMALL = NetworkSettings(width=16, out_channels=8, blocks=2, dropout=0.5)
WANTED = OperatorSettings(n_eigenpairs=24)


def network_of(settings: NetworkSettings = SMALL, seed: int = 0) -> DiffusionNet:
    """A network of random weights that uses all of its parts, with times at which heat has spread somewhat."""
    torch.manual_seed(seed)
    network = DiffusionNet(settings)
    with torch.no_grad():
        for block in network.blocks:
            block.times.uniform_(0, 0.05)
            block.real.weight.mul_(3)
            block.imaginary.weight.mul_(3)
    return network.eval()


@pytest.fixture(scope="module")
def operators(make) -> Operators:
    return compute_operators(make.blob(2), settings=WANTED)


def turned(operators: Operators, angles: Tensor) -> Operators:
    """The same shape with each point's tangent frame turned by an angle of its own."""
    rows = torch.repeat_interleave(torch.arange(operators.n_points), operators.gradient_x.crow_indices().diff())
    x, y = operators.gradient_x.values(), operators.gradient_y.values()
    cosine, sine = angles.cos()[rows], angles.sin()[rows]
    pattern = operators.gradient_x.crow_indices(), operators.gradient_x.col_indices()
    return replace(
        operators,
        gradient_x=compressed_rows(*pattern, cosine * x + sine * y),
        gradient_y=compressed_rows(*pattern, cosine * y - sine * x),
    )


def in_double(operators: Operators) -> Operators:
    values = {f.name: getattr(operators, f.name) for f in fields(operators)}
    return Operators(**{k: v.double() if isinstance(v, Tensor) else v for k, v in values.items()})


def two_shapes(make) -> Stack:
    """Of 12 and 10 points, with 5 and 3 eigenpairs."""
    shapes = make.sphere(0), make.sphere(0)
    bases = [
        in_double(compute_operators(shape, settings=OperatorSettings(n_eigenpairs=k))).basis
        for shape, k in zip(shapes, (5, 3), strict=True)
    ]
    return Stack([bases[0], bases[1].sampled(torch.arange(2, 12))])


def slow_block(block: DiffusionBlock, hidden: Tensor, operators: Operators, kept: Sequence[Tensor] = ()) -> Tensor:
    """Equations of the paper, channel by channel and with complex numbers; of half the activations, what is kept."""
    phi, mass = operators.eigenvectors.double(), operators.mass.double()
    hidden = hidden.double()
    diffused = torch.zeros_like(hidden)
    for channel, time in enumerate(block.times.double()):
        heat = phi @ torch.diag(torch.exp(-operators.eigenvalues.double() * time.clamp(min=1e-8))) @ phi.T
        diffused[:, channel] = heat @ (mass * hidden[:, channel])
    x = operators.gradient_x.to_dense().double() @ diffused
    y = operators.gradient_y.to_dense().double() @ diffused
    gradient = torch.complex(x, y)
    mixed = gradient @ torch.complex(block.real.weight.double(), block.imaginary.weight.double()).T
    features = torch.tanh((gradient.conj() * mixed).real)
    out = torch.cat([hidden, diffused, features], dim=1)
    for i, layer in enumerate(block.perceptron):
        out = torch.relu(out) if i else out
        out = 2 * kept[i - 1] * out if i and kept else out
        out = out @ layer.weight.double().T + layer.bias.double()
    return hidden + out


def test_a_block_equals_the_paper_s_equations(operators: Operators) -> None:
    block = network_of().blocks[0]
    hidden = torch.randn(operators.n_points, 16, generator=torch.Generator().manual_seed(1))
    expected = slow_block(block, hidden, operators)
    torch.testing.assert_close(block(hidden, Stack([operators.basis])).double(), expected, atol=1e-3, rtol=1e-3)


def test_turning_every_tangent_frame_changes_nothing(operators: Operators) -> None:
    angles = 2 * torch.pi * torch.rand(operators.n_points, generator=torch.Generator().manual_seed(2))
    network = network_of()
    before, after = (network(operators.points, ops) for ops in (operators, turned(operators, angles)))
    torch.testing.assert_close(after, before, atol=1e-4, rtol=1e-4)


def test_the_published_order_does_depend_on_the_frames(operators: Operators) -> None:
    angles = 2 * torch.pi * torch.rand(operators.n_points, generator=torch.Generator().manual_seed(2))
    network = network_of(replace(SMALL, gradient_product="published"))
    before, after = (network(operators.points, ops) for ops in (operators, turned(operators, angles)))
    assert (after - before).abs().max() > 0.01


@pytest.mark.parametrize("modality", ["mesh", "cloud"])
def test_relabelling_the_points_relabels_the_features(modality: str, make) -> None:
    blob = make.blob(2)
    order = np.random.default_rng(0).permutation(blob.n_points)
    shapes = [blob, make.relabelled(blob, order)]
    if modality == "cloud":
        shapes = [shape.as_cloud() for shape in shapes]
    network = network_of()
    first, second = (network(ops.points, ops) for ops in (compute_operators(s, settings=WANTED) for s in shapes))
    assert first.std(dim=0).min() > 0.01
    torch.testing.assert_close(second, first[order], atol=2e-3, rtol=2e-3)


def test_features_hardly_depend_on_the_resolution(make) -> None:
    coarse, fine = make.blob(3), make.blob(4)
    np.testing.assert_allclose(fine.points[: coarse.n_points], coarse.points, atol=1e-12)
    network = network_of()
    operators = [compute_operators(shape, settings=WANTED) for shape in (coarse, fine)]
    # One frame for both, so that the inputs at the shared points are the same.
    points = [(torch.from_numpy(s.points - coarse.points.mean(0)) / operators[0].scale).float() for s in (coarse, fine)]
    few, many = (network(p, ops) for p, ops in zip(points, operators, strict=True))
    shared = many[: coarse.n_points]
    assert (shared - few).norm() < 0.05 * (few - few.mean(dim=0)).norm()


def test_diffusion_smooths_for_each_channel_s_time(operators: Operators) -> None:
    values = torch.randn(operators.n_points, 4, generator=torch.Generator().manual_seed(0))
    times = torch.tensor([0.0, -3.0, 0.01, 1e4])
    out = operators.eigenvectors @ (heat_decay(operators.eigenvalues, times) * operators.coefficients(values))
    inside = operators.eigenvectors @ operators.coefficients(values)
    torch.testing.assert_close(out[:, :2], inside[:, :2], atol=1e-4, rtol=1e-4)  # no time, and none below zero
    decay = torch.exp(-0.01 * operators.eigenvalues)
    torch.testing.assert_close(
        operators.coefficients(out)[:, 2], decay * operators.coefficients(values)[:, 2], atol=1e-4, rtol=1e-4
    )
    mean = (operators.mass @ values[:, 3]) / operators.mass.sum()
    torch.testing.assert_close(out[:, 3], mean.expand(operators.n_points), atol=1e-4, rtol=1e-4)


def test_long_times_leave_no_numbers_that_are_slow_to_multiply() -> None:
    eigenvalues, times = torch.linspace(0, 2000, 300), torch.linspace(1e-4, 0.1, 50).requires_grad_()
    decay = heat_decay(eigenvalues, times)
    expected = torch.exp(-eigenvalues[:, None] * times).detach()
    assert ((expected > 0) & (expected < torch.finfo(torch.float32).tiny)).any()
    assert not ((decay > 0) & (decay < 1e-15)).any()
    torch.testing.assert_close(decay, expected, atol=1e-13, rtol=1e-6)
    decay.sum().backward()
    torch.testing.assert_close(times.grad, -(eigenvalues[:, None] * expected).sum(dim=0))


def test_the_times_learn_from_where_they_begin_and_are_lifted_from_below_zero(operators: Operators) -> None:
    torch.manual_seed(0)
    network = DiffusionNet(SMALL)
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-3)
    for _ in range(3):
        optimiser.zero_grad()
        network(operators.points, operators).square().sum().backward()
        optimiser.step()
    times = torch.cat([block.times for block in network.blocks])
    assert (times > 5e-4).any() and (times > -5e-3).all()
    below = torch.tensor([-1.0, -1.0, 0.5], requires_grad=True)
    decay = heat_decay(torch.tensor([1.0, 2.0]), below)
    (decay * torch.tensor([1.0, -1.0, 1.0])).sum().backward()
    # A larger first time lowers the sum, so it is lifted; a larger second one raises it, so it stays where it is.
    assert below.grad[0] < 0 and below.grad[1] == 0 and below.grad[2] < 0


def test_the_published_architecture_has_its_number_of_parameters() -> None:
    assert sum(parameter.numel() for parameter in DiffusionNet().parameters()) == 477_824


def test_dropout_acts_in_training_alone(operators: Operators) -> None:
    network = network_of()
    torch.testing.assert_close(
        network(operators.points, operators), network(operators.points, operators), atol=0, rtol=0
    )
    network.train()
    torch.manual_seed(5)
    first, second = network(operators.points, operators), network(operators.points, operators)
    assert (first - second).abs().max() > 0.01
    undropped = network_of(replace(SMALL, dropout=0.0)).train()
    torch.testing.assert_close(
        undropped(operators.points, operators), network_of()(operators.points, operators), atol=1e-6, rtol=0
    )


@pytest.mark.parametrize("product", ["equivariant", "published"])
def test_gradients_of_a_block_are_right(product: str, make) -> None:
    stack = two_shapes(make)
    settings = NetworkSettings(width=3, dropout=0.0, gradient_product=product)
    torch.manual_seed(0)
    block = DiffusionBlock(settings).double()
    parameters = {name: value.detach().clone() for name, value in block.named_parameters()}
    parameters["times"] = torch.tensor([0.02, 0.1, 0.3], dtype=torch.float64)
    names = list(parameters)

    def run(hidden: Tensor, *values: Tensor) -> Tensor:
        return torch.func.functional_call(block, dict(zip(names, values, strict=True)), (hidden, stack))

    inputs = [torch.randn(22, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1)), *parameters.values()]
    assert torch.autograd.gradcheck(run, [value.requires_grad_() for value in inputs], eps=1e-6, atol=1e-6)


def keep(monkeypatch: pytest.MonkeyPatch, masks: Sequence[Tensor]) -> None:
    """Have the first and the second hidden layer of every pass keep these."""
    turns = itertools.cycle(masks)
    monkeypatch.setattr(diffusion_net, "_kept", lambda like, dropped, generator: next(turns))


def masks_like(*shape: int) -> list[Tensor]:
    return [torch.rand(*shape, generator=torch.Generator().manual_seed(i)) < 0.5 for i in (7, 8)]


def test_a_block_with_dropout_equals_the_paper_s_equations(operators: Operators, monkeypatch) -> None:
    block = network_of().blocks[0].train()
    hidden = torch.randn(operators.n_points, 16, generator=torch.Generator().manual_seed(1))
    masks = masks_like(operators.n_points, 16)
    keep(monkeypatch, masks)
    found, expected = block(hidden, Stack([operators.basis])).double(), slow_block(block, hidden, operators, masks)
    torch.testing.assert_close(found, expected, atol=1e-3, rtol=1e-3)
    assert (found - slow_block(block, hidden, operators)).abs().max() > 0.01


@pytest.mark.parametrize("product", ["equivariant", "published"])
def test_gradients_of_a_block_with_dropout_are_right(product: str, make, monkeypatch) -> None:
    stack = two_shapes(make)
    torch.manual_seed(0)
    block = DiffusionBlock(NetworkSettings(width=4, dropout=0.4, gradient_product=product)).double().train()
    parameters = {name: value.detach().clone() for name, value in block.named_parameters()}
    parameters["times"] = torch.tensor([0.02, 0.1, 0.3, 0.01], dtype=torch.float64)
    names, masks = list(parameters), masks_like(22, 4)
    keep(monkeypatch, masks)

    def run(hidden: Tensor, *values: Tensor) -> Tensor:
        return torch.func.functional_call(block, dict(zip(names, values, strict=True)), (hidden, stack))

    inputs = [torch.randn(22, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(1)), *parameters.values()]
    assert torch.autograd.gradcheck(run, [value.requires_grad_() for value in inputs], eps=1e-6, atol=1e-6)


@pytest.mark.parametrize("dropped", [1, 77, 128, 255])
def test_dropout_keeps_its_share_of_every_point_and_channel_independently(dropped: int) -> None:
    kept = _kept(torch.empty(50_000, 16), dropped, torch.Generator().manual_seed(0)).double()
    share = 1 - dropped / 256
    deviation = (share * (1 - share)) ** 0.5
    assert abs(kept.mean() - share) < 5 * deviation / kept.numel() ** 0.5
    # Each drawn number makes eight entries of a row: none is special, and none knows of another.
    assert (kept.mean(dim=0) - share).abs().max() < 5 * deviation / 50_000**0.5
    correlation = torch.corrcoef(kept.T) - torch.eye(16)
    assert correlation.abs().max() < 6 / 50_000**0.5


@pytest.mark.parametrize("n", [1, 7, 8, 9])
def test_dropout_has_an_entry_for_each_activation(n: int) -> None:
    kept = _kept(torch.empty(n, 3), 100, None)
    assert kept.shape == (n, 3) and kept.max() <= 1


@pytest.mark.parametrize("share", [0.01, 0.3, 0.5, 0.75, 0.999])
def test_what_dropout_keeps_grows_by_as_much_as_is_dropped(share: float, operators: Operators, monkeypatch) -> None:
    seen: list[int] = []

    def counted(like: Tensor, dropped: int, generator: torch.Generator | None) -> Tensor:
        seen.append(dropped)
        return _kept(like, dropped, generator)

    monkeypatch.setattr(diffusion_net, "_kept", counted)
    block = DiffusionBlock(NetworkSettings(width=16, dropout=share)).train()
    with torch.no_grad():
        # The hidden layers are one wherever they are kept, and the output what is left of the second.
        for layer, weight in zip(block.perceptron, (0.0, 0.0, 1.0), strict=True):
            layer.weight.copy_(weight * torch.eye(*layer.weight.shape))
            layer.bias.fill_(1 - weight)
        out = block(torch.zeros(operators.n_points, 16), Stack([operators.basis]), torch.Generator().manual_seed(0))
    grown = out.max()
    assert torch.isclose(out, grown).logical_or(out == 0).all()
    assert grown.item() == pytest.approx(1 / (1 - seen[0] / 256)) and seen[0] == seen[1]
    assert abs(seen[0] / 256 - share) <= 1 / 256
    assert abs(out.mean() - 1) < 5 * ((grown - 1) / out.numel()) ** 0.5


def test_dropout_follows_its_generator_alone(operators: Operators) -> None:
    network = network_of().train()
    passes = []
    for seed, other in ((3, 0), (3, 1), (4, 1)):
        torch.manual_seed(other)
        passes.append(network(operators.points, operators, generator=torch.Generator().manual_seed(seed)))
    assert torch.equal(passes[0], passes[1]) and not torch.equal(passes[1], passes[2])


def test_shapes_go_together_up_to_a_number_of_points() -> None:
    most = diffusion_net._POINTS_TOGETHER
    sizes = [most - 1, 1, 1, most + 5, most // 2, most // 2, 1]
    assert [sizes[some] for some in diffusion_net._groups(sizes)] == [
        sizes[:2],
        sizes[2:3],
        sizes[3:4],
        sizes[4:6],
        [1],
    ]


@pytest.mark.parametrize("together", [10_000, 230, 1])
def test_several_shapes_at_once_are_each_by_itself(together: int, make, monkeypatch) -> None:
    monkeypatch.setattr(diffusion_net, "_POINTS_TOGETHER", together)
    bases = [compute_operators(make.blob(2), settings=WANTED).basis]
    bases.append(bases[0].sampled(torch.arange(0, bases[0].n_points, 3)))
    bases.append(compute_operators(make.blob(1).as_cloud(), settings=OperatorSettings(n_eigenpairs=15)).basis)
    network = network_of()

    def gradients(features: Sequence[Tensor]) -> list[Tensor]:
        network.zero_grad()
        sum((i + 1) * each.square().sum() for i, each in enumerate(features)).backward()
        return [weight.grad.clone() for weight in network.parameters()]

    at_once = network.several([basis.points for basis in bases], bases)
    apart = [network(basis.points, basis) for basis in bases]
    for one, other in zip(at_once, apart, strict=True):
        torch.testing.assert_close(one, other, atol=1e-4, rtol=1e-4)
    for one, other in zip(gradients(at_once), gradients(apart), strict=True):
        assert (one - other).norm() < 1e-4 * other.norm()


def test_dropout_drops_something_else_in_each_of_several_shapes(operators: Operators) -> None:
    network, basis = network_of().train(), operators.basis
    first, second = network.several([basis.points] * 2, [basis] * 2, generator=torch.Generator().manual_seed(0))
    assert (first - second).abs().max() > 0.01


@pytest.mark.parametrize("dropout", [-0.1, 1.0, 50, float("nan")])
def test_a_share_that_cannot_be_dropped_is_refused(dropout: float) -> None:
    with pytest.raises(ArgumentError, match=r"^dropout is"):
        DiffusionNet(replace(SMALL, dropout=dropout))


def test_an_unknown_gradient_product_is_refused() -> None:
    with pytest.raises(ArgumentError, match="did you mean 'equivariant'"):
        DiffusionNet(NetworkSettings(gradient_product="equivarient"))


@pytest.mark.reference
@pytest.mark.parametrize("which", ["x_mesh", "y_mesh", "x_cloud", "y_cloud"])
def test_features_are_those_of_the_published_code(which: str, reference, faust, stored_operators) -> None:
    found = load_weights(reference / "surreal.pth")
    network, info = found.network, found.info
    assert network.settings == NetworkSettings(gradient_product="published") and info.name == "surreal"
    operators = stored_operators(which)
    with torch.inference_mode():
        found = network(operators.points, operators)
        exact = network.double()(operators.points.double(), in_double(operators))
    stored = torch.from_numpy(faust[f"{which}_features"])

    def errors(features):
        return ((features.double() - exact).norm(dim=1) / exact.norm(dim=1)).numpy()

    # The stored features were computed in float32 and err by up to 1.6e-4 at the worst points, as ours may, and on some
    # processors somewhat more: at 6 of 5,000 points of one shape they are farther off than 1e-4.
    assert (errors(stored) < 1e-4).mean() > 0.998 and errors(stored).max() < 2e-4
    assert (errors(found) < 1e-4).mean() > 0.995 and errors(found).max() < 5e-4
    assert (found - stored).norm() < 1e-5 * stored.norm()


def test_half_precision_gives_nearly_the_same_features_and_gradients(demo_operators) -> None:
    body, network, found = demo_operators[0], network_of(), []
    for half in (False, True):
        network.zero_grad()
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=half):
            features = network(body.points, body)
        assert features.dtype == torch.float32
        torch.autograd.backward((features * (1 + body.points[:, :1])).sum())
        found.append([features.detach(), *(weight.grad.clone() for weight in network.parameters())])
    for exact, rounded in zip(*found, strict=True):
        assert 0 < (rounded - exact).norm() < 0.05 * exact.norm()
