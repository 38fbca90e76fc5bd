"""Safetensors files whose bytes depend on nothing but what they hold."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from safetensors.torch import save
from torch import Tensor

from homolog.core.files import atomic_path


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
