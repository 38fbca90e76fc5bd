"""Safetensors files of ours against what the package itself reads."""

import pytest
import torch
from safetensors import safe_open

from homolog.core.errors import ArgumentError
from homolog.core.tensors import write_tensors

TENSORS = {
    "b": torch.arange(6.0).reshape(2, 3).T,  # not contiguous
    "a": torch.tensor([True, False, True]),
    "c": torch.ones(3, dtype=torch.float64).requires_grad_(),
    "none": torch.zeros(0, 4),
}
NOTES = {"z": "1", "y": '{"ä": "\\n"}', "x": "", "w": "4"}


def test_the_package_reads_what_is_written_and_the_bytes_are_always_the_same(tmp_path):
    path = tmp_path / "t.safetensors"
    found = set()
    for names in (list(NOTES), sorted(NOTES)) * 4:
        write_tensors(path, TENSORS, {name: NOTES[name] for name in names})
        found.add(path.read_bytes())
    assert len(found) == 1
    with safe_open(path, framework="pt") as file:
        assert file.metadata() == NOTES
        assert set(file.keys()) == set(TENSORS)
        for name, tensor in TENSORS.items():
            assert torch.equal(file.get_tensor(name), tensor) and file.get_tensor(name).dtype == tensor.dtype
    assert [entry.name for entry in tmp_path.iterdir()] == ["t.safetensors"]


def test_a_place_that_cannot_be_written(tmp_path):
    with pytest.raises(ArgumentError, match="does not exist"):
        write_tensors(tmp_path / "gone" / "t.safetensors", TENSORS, NOTES)
