"""Safetensors files: those that are read are ordinary ones, and the bytes written depend on nothing but the content."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from safetensors import safe_open
from safetensors.torch import save
from torch import Tensor

from homolog.core.files import atomic_path, ordinary


def read_tensors(path: str | Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """The tensors of a safetensors file, and the notes about them; the library checks that the file is so long.

    Raises:
        OSError: if it cannot be read.
        SafetensorError: if it is damaged.
    """
    with safe_open(ordinary(path), framework="pt") as file:
        return {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}  # noqa: SIM118


def write_tensors(path: str | Path, tensors: Mapping[str, Tensor], notes: Mapping[str, str]) -> None:
    """Write tensors and notes about them as a safetensors file, whole or not at all.

    The notes are sorted: ``safetensors`` itself writes them in an order that changes from call to call.

    Raises:
        ArgumentError: if the file cannot be written.
    """
    content = memoryview(save({name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}))
    start = 8 + int.from_bytes(content[:8], "little")
    header = {"__metadata__": dict(sorted(notes.items())), **json.loads(bytes(content[8:start]))}
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)  # tensors begin at a multiple of eight bytes
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.writelines((len(text).to_bytes(8, "little"), text, content[start:]))
