"""Network weights on disk: safetensors with the settings inside, and the authors' released checkpoints."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from os import PathLike
from pathlib import Path

import torch
from torch import Tensor
from typing_extensions import NotRequired, TypedDict  # before Python 3.12 pydantic takes no other

from homolog.core.arguments import check_kind
from homolog.core.errors import WeightsError
from homolog.core.files import sha256
from homolog.core.messages import shown
from homolog.core.pretrained import DEFAULT_WEIGHTS, pretrained_weights, weights_file
from homolog.core.reasons import reason_of
from homolog.core.records import checked_json, record
from homolog.core.tensors import read_tensors, write_tensors
from homolog.features.diffusion_net import DiffusionNet, NetworkSettings
from homolog.features.extractor import NetworkFeatures
from homolog.features.info import FeatureInfo
from homolog.features.orienter import Orienter
from homolog.features.published import read_published

# The format's name ends in its version, which grows when files can no longer be read by what read them before.
_FORMAT, _VERSION = "homolog-weights-", 1
# What names of an orienter's tensors begin with.
_ORIENTER = "orienter."


@record
class _Header(TypedDict):
    """What is read of the header, whose entries are texts of JSON."""

    settings: str
    info: str
    orienter: NotRequired[str]


def save_weights(
    path: str | Path, network: DiffusionNet, info: FeatureInfo, *, orienter: Orienter | None = None
) -> None:
    """Write a network as safetensors, its settings and ``info`` in the header. Written whole or not at all.

    The same network and ``info`` give the same bytes.

    Args:
        path: of the file.
        network: to write.
        info: what it expects.
        orienter: which tells how shapes stand, if there is one.
    """
    described = {name: value for name, value in asdict(info).items() if name != "sha256"}
    notes = {
        "format": f"{_FORMAT}{_VERSION}",
        "settings": json.dumps(asdict(network.settings), sort_keys=True),
        "info": json.dumps(described, sort_keys=True),
    }
    tensors = network.state_dict()
    if orienter is not None:
        notes["orienter"] = json.dumps(asdict(orienter.network.settings), sort_keys=True)
        tensors |= {f"{_ORIENTER}{name}": tensor for name, tensor in orienter.network.state_dict().items()}
    write_tensors(path, tensors, notes)


def load_weights(weights: str | Path = DEFAULT_WEIGHTS) -> NetworkFeatures:
    """Read a network in evaluation mode from a safetensors file of ours, or from a ``.pth`` of another project.

    Neither can run code: a ``.pth`` is read for its tensors alone. The layouts that are known are those of the paper's
    authors (CVPR 2023, and their later networks on wave kernel signatures) and of DiffusionNet's.

    Args:
        weights: the file, or the name of weights that ship with the package.

    Raises:
        ArgumentError: if ``weights`` is neither.
        WeightsError: if the file is missing, damaged, or not the weights of such a network.

    Examples:
        >>> import homolog
        >>> homolog.load_weights("people").info.licence
        'CC0-1.0'
    """
    check_kind("weights", weights, PathLike, str)
    path = weights_file(weights)
    try:
        settings, info, tensors, of_orienter = (
            (*read_published(path), None) if path.suffix.lower() in (".pth", ".pt") else _read_own(path)
        )
        network = _network(settings, {name: tensors[name] for name in tensors if not name.startswith(_ORIENTER)})
        orienter = None
        if of_orienter is not None:
            named = {name.removeprefix(_ORIENTER): tensors[name] for name in tensors if name.startswith(_ORIENTER)}
            orienter = Orienter(_network(of_orienter, named))
    except WeightsError:
        raise
    except PermissionError as error:
        raise WeightsError(f"{path} cannot be read: {error.strerror}; change its permissions") from None
    except Exception as error:  # on damaged bytes the readers raise nearly anything
        reason = reason_of(error)
        raise WeightsError(f"{path} does not hold weights of this network ({reason}); check the file") from None
    networks = [network] if orienter is None else [network, orienter.network]
    if not all(torch.isfinite(tensor).all() for each in networks for tensor in each.state_dict().values()):
        raise WeightsError(f"{path} holds weights that are not finite; check the file")
    own = path not in pretrained_weights().values()
    return NetworkFeatures(network, info, orienter, file=str(path) if own else "")


def _network(settings: NetworkSettings, tensors: Mapping[str, Tensor]) -> DiffusionNet:
    """The network of these settings, once the tensors are known to be its own, whatever size the settings promise."""
    n_blocks = sum(name.endswith(".times") for name in tensors)
    if settings.blocks != n_blocks:
        raise ValueError(f"its settings say {shown(settings.blocks)} blocks, but it holds {n_blocks}")
    with torch.device("meta"):  # which takes no memory
        network = DiffusionNet(settings)
    for name, expected in network.state_dict().items():
        found = tuple(tensors[name].shape) if name in tensors else "missing"
        if found != tuple(expected.shape):
            raise ValueError(f"its {name} is {found}, but its settings ask for {tuple(expected.shape)}")
    network.load_state_dict({name: tensor.float() for name, tensor in tensors.items()}, assign=True)
    return network.eval()


_Contents = tuple[NetworkSettings, FeatureInfo, dict[str, Tensor], NetworkSettings | None]


def _read_own(path: Path) -> _Contents:
    tensors, described = read_tensors(path)
    if "progress" in described:
        raise WeightsError(f"{path} is a checkpoint, to go on training from; give the weights.safetensors beside it")
    name, version = described.get("format", "").rpartition("-")[::2]
    if f"{name}-" != _FORMAT or not version.isdecimal():
        raise WeightsError(f"{path} is a safetensors file, but not one that homolog wrote")
    if int(version) > _VERSION:
        raise WeightsError(
            f"{path} has version {version} of the weights' format, but this homolog reads up to {_VERSION}; "
            "install a newer homolog"
        )
    header = checked_json(json.dumps(described), _Header)
    settings = _settings(header["settings"])
    orienter = _settings(header["orienter"]) if "orienter" in header else None
    given, known = checked_json(header["info"], FeatureInfo), {f.name for f in fields(FeatureInfo)}
    info = FeatureInfo(**{name: value for name, value in given.items() if name in known} | {"sha256": sha256(path)})
    return settings, info, tensors, orienter


def _settings(text: str) -> NetworkSettings:
    """Settings of a network, none of which can be left out of account, unlike what an info may hold more."""
    given = checked_json(text, NetworkSettings)
    unknown = sorted(given.keys() - {f.name for f in fields(NetworkSettings)})
    if unknown:
        raise ValueError(f"its header has an unknown setting {shown(unknown[0])}; it may need a newer homolog")
    return NetworkSettings(**given)
