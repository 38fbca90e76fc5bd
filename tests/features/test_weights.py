"""Weights on disk: what is written comes back, and nothing else is taken for weights."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from homolog.core.errors import ArgumentError, WeightsError
from homolog.core.files import sha256
from homolog.features import (
    DEFAULT_WEIGHTS,
    DiffusionNet,
    FeatureInfo,
    NetworkSettings,
    load_weights,
    pretrained_weights,
    save_weights,
)

SMALL = NetworkSettings(in_channels=3, out_channels=4, width=6, blocks=2, dropout=0.25)
INFO = FeatureInfo(name="bones", licence="CC0-1.0", upright=False, n_eigenpairs=64, map_eigenpairs=30, temperature=0.05)


def network_of(settings: NetworkSettings = SMALL) -> DiffusionNet:
    torch.manual_seed(0)
    return DiffusionNet(settings)


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    path = tmp_path / "weights.safetensors"
    save_weights(path, network_of(), INFO)
    return path


def as_published(network: DiffusionNet) -> dict[str, torch.Tensor]:
    """The names that the authors' code gives the same weights."""
    theirs = {}
    for name, tensor in network.state_dict().items():
        words = name.split(".")
        if words[0] in ("first", "last"):
            words[0] += "_linear"
        elif words[2] == "times":
            words[2:] = ["diffusion", "diffusion_time"]
        elif words[2] in ("real", "imaginary"):
            words[2:3] = ["gradient_features", "A_re" if words[2] == "real" else "A_im"]
        else:
            words[2:4] = ["mlp", f"miniMLP_linear_00{words[3]}"]
        theirs[".".join(words)] = tensor
    return theirs


def refuses(path: Path, words: str | None = None) -> None:
    """It is an error of one line that names the file."""
    with pytest.raises(WeightsError, match=words) as caught:
        load_weights(path)
    message = str(caught.value)
    assert str(path) in message and "\n" not in message and len(message) < 400 + len(str(path))


def test_weights_settings_and_info_come_back(saved: Path) -> None:
    found = load_weights(saved)
    network, info = found.network, found.info
    assert network.settings == SMALL and info == INFO and info.sha256 == sha256(saved)
    assert not network.training
    expected = network_of().state_dict()
    assert network.state_dict().keys() == expected.keys()
    assert all(torch.equal(tensor, expected[name]) for name, tensor in network.state_dict().items())


def test_the_same_network_and_info_give_the_same_bytes(saved: Path, tmp_path: Path) -> None:
    first = saved.read_bytes()
    for _ in range(8):  # the order of notes would change from one call to the next
        save_weights(saved, network_of(), INFO)
        assert saved.read_bytes() == first
    found = load_weights(saved)
    save_weights(tmp_path / "again.safetensors", found.network, found.info)
    assert (tmp_path / "again.safetensors").read_bytes() == first
    assert int.from_bytes(first[:8], "little") % 8 == 0


def test_optional_keys_of_a_newer_version_are_ignored_and_absent_ones_are_the_defaults(saved: Path) -> None:
    stored = {"name": "bones", "licence": "CC0-1.0", "symmetric": True}
    found = load_weights(rewritten(saved, info=json.dumps(stored)))
    assert found.info == FeatureInfo(name="bones", licence="CC0-1.0") and found.info.temperature == 0.1
    assert found.network.settings == SMALL


def test_saving_again_replaces_the_file_and_leaves_nothing_else(saved: Path) -> None:
    other = DiffusionNet(NetworkSettings(width=3))
    save_weights(saved, other, FeatureInfo())
    assert load_weights(saved).network.settings.width == 3
    assert [path.name for path in saved.parent.iterdir()] == [saved.name]
    with pytest.raises(ArgumentError, match="does not exist"):
        save_weights(saved.parent / "nowhere" / "w.safetensors", other, FeatureInfo())


def test_a_missing_file_or_a_folder_is_refused(tmp_path: Path) -> None:
    refuses(tmp_path / "none.safetensors", "there are no weights")
    refuses(tmp_path, "there are no weights")


@pytest.mark.parametrize("suffix", [".safetensors", ".pth", ".pt", ".bin"])
@pytest.mark.parametrize("size", [0, 1, 7, 300])
def test_garbage_is_refused(suffix: str, size: int, tmp_path: Path) -> None:
    path = tmp_path / f"weights{suffix}"
    path.write_bytes(np.random.default_rng(size).bytes(size))
    refuses(path)


def test_truncated_files_are_refused(saved: Path, tmp_path: Path) -> None:
    published = tmp_path / "w.pth"
    torch.save({"networks": {"feature_extractor": as_published(network_of())}}, published)
    for path in (saved, published):
        whole = path.read_bytes()
        for share in (0.01, 0.3, 0.9, 0.999):
            path.write_bytes(whole[: int(share * len(whole))])
            refuses(path)


@pytest.mark.parametrize("new_format", [True, False])
def test_damaged_checkpoints_are_refused_or_read_but_never_crash(new_format: bool, tmp_path: Path) -> None:
    path = tmp_path / "w.pth"
    torch.save(
        {"networks": {"feature_extractor": as_published(network_of())}},
        path,
        _use_new_zipfile_serialization=new_format,
    )
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(150):
        damaged = bytearray(whole)
        for _ in range(rng.integers(1, 6)):
            damaged[rng.integers(len(damaged))] = rng.integers(256)
        path.write_bytes(damaged[: rng.integers(len(damaged) // 2, len(damaged))])
        try:
            load_weights(path)
        except WeightsError as error:
            refused += 1
            assert "\n" not in str(error)
    assert refused > 100


def test_a_foreign_safetensors_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "theirs.safetensors"
    save_file({"weight": torch.ones(3)}, path)
    refuses(path, "not one that homolog wrote")


def test_a_checkpoint_is_called_so(tmp_path: Path) -> None:
    path = tmp_path / "last.safetensors"
    save_file({"weights.first.weight": torch.ones(3)}, path, metadata={"progress": "{}"})
    refuses(path, "is a checkpoint, to go on training from; give the weights.safetensors beside it")


def rewritten(saved: Path, tensors: dict | None = None, **notes: str) -> Path:
    with safe_open(saved, framework="pt") as file:
        header = {**file.metadata(), **notes}
    save_file(tensors or load_file(saved), saved, metadata=header)
    return saved


def test_headers_that_do_not_fit_are_refused(saved: Path) -> None:
    settings = json.loads(json.dumps(SMALL.__dict__))
    for notes, words in (
        ({"format": "homolog-weights-9"}, "has version 9 of the weights' format, but this homolog reads up to 1"),
        ({"format": "homolog-weights-one"}, "not one that homolog wrote"),
        ({"format": "homolog-checkpoint-1"}, "not one that homolog wrote"),
        ({"settings": "{"}, None),
        ({"settings": "[1, 2]"}, None),
        ({"settings": json.dumps({**settings, "depth": 3})}, "unknown setting 'depth'"),
        ({"settings": json.dumps({**settings, "width": "six"})}, None),
        ({"settings": json.dumps({**settings, "width": 7})}, "its settings ask for"),
        ({"settings": json.dumps({**settings, "blocks": 3})}, "its settings say"),
        ({"settings": json.dumps({**settings, "gradient_product": "none"})}, "gradient_product"),
        ({"settings": json.dumps({**settings, "width": "six"})}, "width"),
        ({"settings": json.dumps({**settings, "width": -1})}, "width"),
        ({"settings": json.dumps({**settings, "a\nb\x1b": 3})}, "unknown setting"),
        ({"settings": "[" * 100_000}, None),
        ({"settings": "9" * 5000}, None),
        ({"orienter": json.dumps({**settings, "blocks": 10**30})}, None),
        ({"orienter": "null"}, None),
        ({"info": "[]"}, None),
        ({"info": '{"upright": 1}'}, "upright is 1"),
        ({"info": '{"temperature": NaN}'}, "NaN"),
        ({"info": '{"temperature": 1e999}'}, None),
        ({"info": '{"input": "xzy"}'}, "input"),
    ):
        save_weights(saved, network_of(), INFO)
        refuses(rewritten(saved, **notes), words)


@pytest.mark.parametrize("name", ["settings", "info"])
def test_headers_that_lack_an_entry_are_refused(name: str, saved: Path) -> None:
    with safe_open(saved, framework="pt") as file:
        header = file.metadata()
    del header[name]
    save_file(load_file(saved), saved, metadata=header)
    refuses(saved, f"has no entry '{name}'")


def test_headers_may_say_more_of_features(saved: Path) -> None:
    """What a newer homolog adds to them is passed over."""
    info = {"name": "mine", "upright": False, "colour": "blue"}
    found = load_weights(rewritten(saved, info=json.dumps(info))).info
    assert (found.name, found.upright, found.sha256) == ("mine", False, sha256(saved))


def test_tensors_that_do_not_fit_are_refused(saved: Path) -> None:
    tensors = load_file(saved)
    first = next(iter(tensors))
    for changed, words in (
        ({**tensors, first: torch.zeros(2, 2)}, "its settings ask for"),
        ({name: tensor for name, tensor in tensors.items() if name != first}, "is missing"),
        ({**tensors, "extra": torch.zeros(2)}, "Unexpected key"),
    ):
        refuses(rewritten(saved, changed), words)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e300])
def test_weights_that_are_not_finite_are_refused(value: float, saved: Path) -> None:
    tensors = load_file(saved)
    tensors["last.bias"] = torch.full((4,), value, dtype=torch.float64)
    refuses(rewritten(saved, tensors), "not finite")


@pytest.mark.parametrize(
    "content",
    [
        None,
        3,
        "text",
        [1, 2],
        torch.zeros(3),
        {"networks": [1]},
        {"networks": {"feature_extractor": [1]}},
        {"networks": {"feature_extractor": {}}},
        {"networks": {"feature_extractor": {"first_linear.weight": 1}}},
        {"networks": {"feature_extractor": {"first_linear.weight": torch.zeros(3), "last_linear.weight": 3}}},
        {"networks": {"feature_extractor": {1: torch.zeros(3)}}},
    ],
    ids=repr,
)
def test_checkpoints_of_other_things_are_refused(content: object, tmp_path: Path) -> None:
    path = tmp_path / "w.pth"
    torch.save(content, path)
    refuses(path)


class Bomb:
    """Leaves a trace when it is unpickled."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self):
        return (open, (str(self.trace), "w"))


@pytest.mark.parametrize("suffix", [".pth", ".pt", ".safetensors"])
@pytest.mark.parametrize("writer", ["torch", "torch, old format", "pickle"])
def test_a_file_that_would_run_code_is_refused_and_does_not(writer: str, suffix: str, tmp_path: Path) -> None:
    path, trace = tmp_path / f"w{suffix}", tmp_path / "trace"
    content = {"networks": {"feature_extractor": {**as_published(network_of()), "last_linear.bias": Bomb(trace)}}}
    if writer == "pickle":
        path.write_bytes(pickle.dumps(content))
    else:
        torch.save(content, path, _use_new_zipfile_serialization=writer == "torch")
    refuses(path)
    assert not trace.exists()
    if writer == "torch":  # the trap is real
        with path.open("rb") as file:  # by its path, torch would read .safetensors as what it says
            torch.load(file, weights_only=False)["networks"]["feature_extractor"]["last_linear.bias"].close()
        assert trace.exists()


# --- what ships


def test_weights_that_ship_load_and_say_their_terms() -> None:
    shipped = pretrained_weights()
    assert DEFAULT_WEIGHTS in shipped
    for name, file in shipped.items():
        info = load_weights(name).info
        assert (info.name, info.licence) == (name, "CC0-1.0")
        assert file.stat().st_size < 5_000_000
        assert file.name in (file.parent / "LICENSE.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("promised", [{"width": 10**9}, {"width": 20_000}, {"blocks": 5000}, {"in_channels": 10**12}])
def test_settings_that_promise_more_than_the_file_holds_take_no_memory(promised: dict[str, int], saved: Path) -> None:
    settings = {**json.loads(json.dumps(SMALL.__dict__)), **promised}
    save_weights(saved, network_of(), INFO)
    path = rewritten(saved, settings=json.dumps(settings))
    resource = pytest.importorskip("resource")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refuses(path, "are too large for any computer|but its settings ask for|but it holds")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000


def test_tensors_that_repeat_one_number_are_weighed_by_all_of_them(tmp_path: Path) -> None:
    large = torch.zeros(1).expand(20_000, 20_000)
    torch.save({"first_linear.weight": large, "last_linear.weight": large}, tmp_path / "zero.pth")
    refuses(tmp_path / "zero.pth", "HOMOLOG_EXPANSION_MB")
