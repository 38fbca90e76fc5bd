"""Network weights on disk: safetensors with the settings inside, and the authors' released checkpoints."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from os import PathLike
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor

from homolog.core.arguments import check_kind
from homolog.core.errors import WeightsError
from homolog.core.files import atomic_path, sha256
from homolog.core.pretrained import weights_file
from homolog.features.diffusion_net import DiffusionNet, NetworkSettings
from homolog.geometry import CLOUD_NEIGHBOURS, LaplacianKind

_FORMAT = "homolog-weights-1"


@dataclass(frozen=True)
class WeightsInfo:
    """What one must know to use weights rightly.

    Args:
        name: a short name, or the file's.
        licence: the terms of the weights.
        upright: whether shapes must stand as those trained on did: +y up, facing +z.
        n_eigenpairs: eigenpairs of the operators that the network was trained with.
        laplacian: the Laplacian of meshes that it was trained with.
        n_neighbours: points that each point of a cloud is connected to in its operators.
        map_eigenpairs: eigenpairs of the functional map that it was trained with.
        partial: whether it was trained on parts with their complete shapes.
        near_isometric: whether surfaces were taken to bend without stretching much: maps between meshes are then
            functional maps, and all maps are refined as such. Where not, features alone say what goes where.
        sha256: hash of the file; empty before it is saved.
    """

    name: str = "untitled"
    licence: str = "unknown"
    upright: bool = True
    n_eigenpairs: int = 128
    laplacian: LaplacianKind = "robust"
    n_neighbours: int = CLOUD_NEIGHBOURS
    map_eigenpairs: int = 80
    partial: bool = False
    near_isometric: bool = True
    sha256: str = field(default="", compare=False)


def save_weights(path: str | Path, network: DiffusionNet, info: WeightsInfo) -> None:
    """Write a network as safetensors, its settings and ``info`` in the header. Written whole or not at all."""
    described = {"format": _FORMAT, "settings": json.dumps(asdict(network.settings)), "info": json.dumps(asdict(info))}
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in network.state_dict().items()}
    with atomic_path(path) as temporary:
        save_file(tensors, temporary, metadata=described)


def load_weights(weights: str | Path) -> tuple[DiffusionNet, WeightsInfo]:
    """Read a network in evaluation mode from a safetensors file of ours or a ``.pth`` of the paper's authors.

    Neither can run code: a ``.pth`` is read for its tensors alone.

    Args:
        weights: the file, or the name of weights that ship with the package.

    Raises:
        ArgumentError: if ``weights`` is neither.
        WeightsError: if the file is missing, damaged, or not the weights of such a network.
    """
    check_kind("weights", weights, PathLike, str)
    path = weights_file(weights)
    read = _read_published if path.suffix.lower() in (".pth", ".pt") else _read_own
    try:
        settings, info, tensors = read(path)
        network = DiffusionNet(settings)
        network.load_state_dict(tensors)
    except WeightsError:
        raise
    except PermissionError as error:
        raise WeightsError(f"{path} cannot be read: {error.strerror}; change its permissions") from None
    except Exception as error:  # on damaged bytes the readers raise nearly anything
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise WeightsError(f"{path} does not hold weights of this network ({reason}); check the file") from None
    if not all(torch.isfinite(tensor).all() for tensor in network.state_dict().values()):
        raise WeightsError(f"{path} holds weights that are not finite; check the file")
    return network.eval(), info


_Contents = tuple[NetworkSettings, WeightsInfo, dict[str, Tensor]]


def _read_own(path: Path) -> _Contents:
    with safe_open(path, framework="pt") as file:
        described = file.metadata() or {}
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    if "progress" in described:
        raise WeightsError(f"{path} is a checkpoint, to go on training from; give the weights.safetensors beside it")
    if described.get("format") != _FORMAT:
        raise WeightsError(f"{path} is a safetensors file, but not one that homolog wrote")
    settings = NetworkSettings(**_known(NetworkSettings, json.loads(described["settings"])))
    info = _known(WeightsInfo, json.loads(described["info"]))
    return settings, WeightsInfo(**{**info, "sha256": sha256(path)}), tensors


def _read_published(path: Path) -> _Contents:
    try:
        checkpoint = torch.load(path, map_location="cpu", weights_only=True)
    except UnpicklingError:
        raise ValueError("it holds something other than numbers, or is damaged") from None
    published = checkpoint["networks"]["feature_extractor"]
    tensors = {_own_name(name): tensor for name, tensor in published.items()}
    settings = NetworkSettings(
        in_channels=tensors["first.weight"].shape[1],
        out_channels=tensors["last.weight"].shape[0],
        width=tensors["first.weight"].shape[0],
        blocks=sum(name.endswith(".times") for name in tensors),
        gradient_product="published",
    )
    info = WeightsInfo(name=path.stem, licence="as its authors state", laplacian="cotangent", sha256=sha256(path))
    return settings, info, tensors


_OWN_NAMES = {
    "first_linear": "first",
    "last_linear": "last",
    "diffusion.diffusion_time": "times",
    "gradient_features.A_re": "real",
    "gradient_features.A_im": "imaginary",
    "mlp.miniMLP_linear_00": "perceptron.",
}


def _own_name(published: str) -> str:
    for theirs, ours in _OWN_NAMES.items():
        published = published.replace(theirs, ours)
    return published


def _known(settings: type, given: Mapping[str, Any]) -> dict[str, Any]:
    names = {f.name for f in fields(settings)}
    unknown = sorted(set(given) - names)
    if unknown:
        raise ValueError(f"its header has an unknown setting {unknown[0]!r}; it may need a newer homolog")
    return dict(given)
