"""Weights that other projects released, by the layout of their checkpoints.

A layout is known by the names of its tensors. A checkpoint is read for its tensors alone and cannot run code. Another
layout is another entry of ``LAYOUTS``.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from pickle import UnpicklingError
from typing import Any
from warnings import catch_warnings, simplefilter

import torch
from torch import Tensor

from homolog.core.errors import WeightsError
from homolog.core.files import opened, sha256
from homolog.core.memory import expansion_fault
from homolog.features.diffusion_net import GradientProduct, NetworkSettings
from homolog.features.info import FeatureInfo, NetworkInput

# Where a checkpoint keeps the parameters of the network, from the outside to the inside.
_CONTAINERS = ("networks", "state_dict", "model_state_dict", "model", "feature_extractor")
_INPUTS: dict[int, NetworkInput] = {3: "xyz", 16: "hks", 128: "wks"}
# Networks on wave kernel signatures were trained with as many eigenpairs, which are also the size of their maps.
_WKS_EIGENPAIRS = 200
_WKS_TEMPERATURE = 0.07


@dataclass(frozen=True)
class Layout:
    """How a project names the tensors of a DiffusionNet.

    Args:
        first: the name of the tensor by which the layout is known.
        names: patterns of its names, and ours.
        gradient_product: how its network multiplies gradients with a complex matrix.
    """

    first: str
    names: tuple[tuple[str, str], ...]
    gradient_product: GradientProduct

    def own_name(self, name: str) -> str:
        """What Homolog calls a tensor of the layout."""
        for theirs, ours in self.names:
            name = re.sub(theirs, ours, name)
        return name


_BLOCK_NAMES = (
    (r"\.diffusion\.diffusion_time$", ".times"),
    (r"\.gradient_features\.A_re\.", ".real."),
    (r"\.gradient_features\.A_im\.", ".imaginary."),
    (r"\.mlp\.miniMLP_linear_00(\d)\.", r".perceptron.\1."),
)
LAYOUTS = (
    # Cao and Bernard, "Self-supervised learning for multimodal non-rigid 3D shape matching", CVPR 2023, and
    # Cao, Roetzer and Bernard, "Unsupervised learning of robust spectral shape matching", SIGGRAPH 2023.
    Layout(
        "first_linear.weight",
        ((r"^first_linear\.", "first."), (r"^last_linear\.", "last."), *_BLOCK_NAMES),
        "published",
    ),
    # Sharp et al., "DiffusionNet", ACM TOG 2022, and what builds on its code.
    Layout(
        "first_lin.weight",
        (
            (r"^first_lin\.", "first."),
            (r"^last_lin\.", "last."),
            (r"^block_(\d+)\.", r"blocks.\1."),
            *_BLOCK_NAMES,
        ),
        "equivariant",
    ),
)


def read_published(path: Path) -> tuple[NetworkSettings, FeatureInfo, dict[str, Tensor]]:
    """Read a ``.pth`` of a project whose layout is known: settings, what the network expects, and its tensors.

    Raises:
        WeightsError: if the layout or the network's input is not known.
        ValueError: if the file holds something other than numbers.
    """
    try:
        _check_expansion(path)
        with catch_warnings():
            simplefilter("ignore")  # of PyTorch, about pickles that it refuses next
            checkpoint = torch.load(path, map_location="cpu", weights_only=True)
    except UnpicklingError:
        raise ValueError("it holds something other than numbers, or is damaged") from None
    given = _parameters(checkpoint)
    layout = next((layout for layout in LAYOUTS if layout.first in given), None)
    if layout is None:
        raise WeightsError(
            f"{path} has no tensor {' or '.join(layout.first for layout in LAYOUTS)}; known are checkpoints of "
            "DiffusionNets by the paper's authors and by those of DiffusionNet"
        )
    tensors = {layout.own_name(name): tensor for name, tensor in given.items()}
    # A tensor may repeat one number over and over.
    _check_size(sum(tensor.numel() * tensor.element_size() for tensor in tensors.values()), path)
    settings = NetworkSettings(
        in_channels=tensors["first.weight"].shape[1],
        out_channels=tensors["last.weight"].shape[0],
        width=tensors["first.weight"].shape[0],
        blocks=sum(name.endswith(".times") for name in tensors),
        gradient_product=layout.gradient_product,
    )
    return settings, _info(path, settings), tensors


def _check_expansion(path: Path) -> None:
    """Refuse an archive whose parts would expand to too much."""
    with opened(path) as file:
        if zipfile.is_zipfile(file):
            _check_size(sum(info.file_size for info in zipfile.ZipFile(file).infolist()), path)


def _check_size(n_bytes: int, path: Path) -> None:
    if fault := expansion_fault(n_bytes, path.stat().st_size):
        raise ValueError(fault)


def _parameters(checkpoint: Any) -> dict[str, Tensor]:
    """The tensors of the network, without the containers and prefixes that they lie in."""
    found = checkpoint
    for container in _CONTAINERS:
        if isinstance(found, Mapping) and container in found:
            found = found[container]
    named = {name.removeprefix("module."): tensor for name, tensor in found.items() if isinstance(tensor, Tensor)}
    # What else a model is made of lies beside its features.
    prefix = "feature_extractor." if any(name.startswith("feature_extractor.") for name in named) else ""
    return {name.removeprefix(prefix): tensor for name, tensor in named.items() if name.startswith(prefix)}


def _info(path: Path, settings: NetworkSettings) -> FeatureInfo:
    if settings.in_channels not in _INPUTS:
        raise WeightsError(
            f"{path} is of a network with {settings.in_channels} input channels; known are 3 (positions), 16 (heat "
            "kernel signatures) and 128 (wave kernel signatures)"
        )
    kind = _INPUTS[settings.in_channels]
    info = FeatureInfo(
        name=path.stem,
        licence="as its authors state",
        input=kind,
        upright=kind == "xyz",
        laplacian="cotangent",
        sha256=sha256(path),
    )
    if kind != "wks":
        return info
    size = _WKS_EIGENPAIRS
    return replace(info, n_eigenpairs=size, map_eigenpairs=size, temperature=_WKS_TEMPERATURE)
