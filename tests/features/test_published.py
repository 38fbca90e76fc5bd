"""Checkpoints of other projects: a network of ours under their names gives the features that it gives under ours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from homolog.core.errors import WeightsError
from homolog.core.files import sha256
from homolog.features import DiffusionNet, NetworkFeatures, NetworkSettings, load_weights
from homolog.geometry import Operators, OperatorSettings, compute_operators
from homolog.matching import Matcher

WIDTH, BLOCKS, OUT = 12, 2, 7


def network_of(in_channels: int, gradient_product: str) -> DiffusionNet:
    torch.manual_seed(3)
    settings = NetworkSettings(in_channels, OUT, WIDTH, BLOCKS, gradient_product=gradient_product)  # type: ignore[arg-type]
    network = DiffusionNet(settings).eval()
    for block in network.blocks:
        with torch.no_grad():
            block.times.copy_(torch.rand(WIDTH) * 0.1)
    return network


def renamed(network: DiffusionNet, *, ends: str, block: str, prefix: str = "") -> dict[str, torch.Tensor]:
    """The tensors of a network as another project calls them: ``first_lin`` and ``block_0``, say."""
    theirs = {}
    for name, tensor in network.state_dict().items():
        words = name.split(".")
        if words[0] in ("first", "last"):
            words[0] += ends
        else:
            words[:2] = [block.format(words[1])]
            if words[1] == "times":
                words[1:] = ["diffusion", "diffusion_time"]
            elif words[1] in ("real", "imaginary"):
                words[1:2] = ["gradient_features", {"real": "A_re", "imaginary": "A_im"}[words[1]]]
            else:
                assert words[1] == "perceptron"
                words[1:3] = ["mlp", f"miniMLP_linear_00{words[2]}"]
        theirs[prefix + ".".join(words)] = tensor
    return theirs


def of_the_paper(network: DiffusionNet) -> dict:
    """Two levels of containers; other networks of the training lie beside it."""
    found = renamed(network, ends="_linear", block="blocks.{}")
    return {"networks": {"feature_extractor": found, "permutation": {"scale": torch.ones(1)}}}


LAYOUTS = {
    "the paper's authors": ("published", of_the_paper),
    "DiffusionNet": ("equivariant", lambda network: renamed(network, ends="_lin", block="block_{}")),
    "DiffusionNet within another model": (
        "equivariant",
        lambda network: {
            **renamed(network, ends="_lin", block="block_{}", prefix="feature_extractor."),
            "fmreg.bias": torch.zeros(4),
        },
    ),
    "DiffusionNet trained on several devices": (
        "equivariant",
        lambda network: {"model_state_dict": renamed(network, ends="_lin", block="block_{}", prefix="module.")},
    ),
}


@pytest.fixture(scope="module")
def operators(make) -> Operators:
    wanted = OperatorSettings(n_eigenpairs=200, laplacian="cotangent")
    return compute_operators(make.blob(3), settings=wanted)


def wave_input(operators: Operators) -> torch.Tensor:
    """Of Aubry et al. by their formula, in double precision: 128 energies of 128 eigenpairs, each of unit norm."""
    values = operators.eigenvalues[1:128].double().numpy()
    squares = operators.eigenvectors[:, 1:128].double().numpy() ** 2
    mass, log = operators.mass.double().numpy(), np.log(values)
    sigma = 7 * (log[-1] - log[0]) / 128
    columns = []
    for energy in np.linspace(log[0] + 2 * sigma, log[-1] - 2 * sigma, 128):
        weights = np.exp(-((energy - log) ** 2) / (2 * sigma**2))
        column = squares @ weights / weights.sum()
        columns.append(column / np.sqrt(mass @ column**2))
    return torch.from_numpy(np.stack(columns, axis=1)).float()


def heat_input(operators: Operators) -> torch.Tensor:
    """Of Sun et al.: 16 times from 0.01 to 1 of 128 eigenpairs."""
    values, squares = operators.eigenvalues[:128].double(), operators.eigenvectors[:, :128].double().square()
    return torch.stack([squares @ torch.exp(-values * 10 ** (-2 + 2 * i / 15)) for i in range(16)], dim=1).float()


INPUTS = {3: ("xyz", lambda operators: operators.points), 16: ("hks", heat_input), 128: ("wks", wave_input)}


@pytest.mark.parametrize("in_channels", INPUTS)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_features_are_those_of_the_network_that_it_was_made_from(layout, in_channels, operators, tmp_path: Path):
    gradient_product, checkpoint = LAYOUTS[layout]
    network, path = network_of(in_channels, gradient_product), tmp_path / "theirs.pth"
    torch.save(checkpoint(network), path)
    found = load_weights(path)
    assert isinstance(found, NetworkFeatures) and not found.network.training
    assert found.network.settings == network.settings
    kind, of = INPUTS[in_channels]
    assert (found.info.name, found.info.input, found.info.sha256) == ("theirs", kind, sha256(path))
    assert found.info.upright == found.info.follows_pose == (kind == "xyz")
    assert found.info.laplacian == "cotangent"
    with torch.no_grad():
        expected = network(of(operators), operators)
        assert expected.std() > 1e-3
        torch.testing.assert_close(found(operators), expected, rtol=1e-3, atol=1e-3 * float(expected.std()))


def test_the_two_products_of_gradients_differ(operators):
    """So that one taken for the other would be seen above."""
    with torch.no_grad():
        one, other = (network_of(3, kind)(operators.points, operators) for kind in ("published", "equivariant"))
    assert (one - other).abs().max() > 0.01 * one.std()


def test_networks_on_wave_kernel_signatures_have_the_sizes_they_were_trained_with(make, tmp_path):
    path = tmp_path / "w.pth"
    torch.save(of_the_paper(network_of(128, "published")), path)
    matcher = Matcher.from_weights(path, device="cpu")
    info = matcher.extractor.info
    assert (info.n_eigenpairs, info.map_eigenpairs, info.temperature) == (200, 200, 0.07)
    blob = make.blob(3)
    pair, _ = matcher.pair(blob, blob)
    assert pair.x.operators.n_eigenpairs == pair.map_size == 200
    # They do not follow the pose: nobody need stand upright.
    lying, _ = matcher.pair(blob, blob, target_up="x")
    torch.testing.assert_close(lying.y.features, pair.y.features, rtol=1e-2, atol=1e-3)
    assert matcher.match(blob, blob).warnings == ()


@pytest.mark.parametrize(
    ("tensors", "said"),
    [
        ({"conv.weight": torch.zeros(3, 3)}, r"has no tensor first_linear\.weight or first_lin\.weight"),
        (of_the_paper(network_of(5, "published")), "is of a network with 5 input channels; known are 3"),
    ],
    ids=["another layout", "another input"],
)
def test_layouts_that_are_not_known_are_one_line(tensors, said, tmp_path):
    torch.save(tensors, tmp_path / "w.pth")
    with pytest.raises(WeightsError, match=said) as caught:
        load_weights(tmp_path / "w.pth")
    assert "\n" not in str(caught.value) and str(tmp_path / "w.pth") in str(caught.value)
