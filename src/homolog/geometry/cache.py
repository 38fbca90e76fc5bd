"""Operators on disk, found by content."""

from __future__ import annotations

import hashlib
import json
import logging
import os
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from safetensors import SafetensorError
from safetensors.torch import save_file
from torch import Tensor

from homolog.core.arguments import check_choice, check_kind, given_or_default
from homolog.core.caches import CacheFolder
from homolog.core.errors import ArgumentError
from homolog.core.files import atomic_path
from homolog.core.tensors import read_tensors
from homolog.geometry.operators import Operators, OperatorSettings, compressed_rows, compute_operators
from homolog.shapes import Shape

_log = logging.getLogger(__name__)

# Part of every key: raise it when operators of the same shape and settings change.
_VERSION = 4
_DENSE = ("points", "mass", "eigenvalues", "eigenvectors", "centre")

EigenvectorPrecision = Literal["float32", "float16"]


@dataclass(frozen=True)
class OperatorCache(CacheFolder):
    """Cache of operators on disk: a folder with an entry per shape and settings, safe to share between processes.

    An entry's name is the hash of the shape's points and faces and of the settings: no index is needed. Entries are
    safetensors files, which cannot run code. They are written atomically and carry a checksum of name and contents: one
    that is damaged, or has another's name, is computed anew. When the folder outgrows ``max_bytes``, the least recently
    used entries are deleted.

    Args:
        folder: where to keep entries; made on first use. ``OperatorCache.default()`` takes ``cache_folder()``.
        max_bytes: bound on the folder's size; 10 GiB by default. A shape of 5,000 points takes about 5 MB.
        eigenvectors: ``"float32"``, or ``"float16"``, which nearly halves an entry at a relative error of 5e-4.

    Examples:
        >>> import tempfile, trimesh
        >>> from homolog import OperatorCache, Shape
        >>> mesh = trimesh.creation.icosphere(subdivisions=3)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     cache = OperatorCache(folder)
        ...     first = cache.operators(Shape(mesh.vertices, mesh.faces))
        ...     again = cache.operators(Shape(mesh.vertices, mesh.faces))  # read, not computed
        ...     cache.size()[0], bool((first.eigenvectors == again.eigenvectors).all())
        (1, True)

    See Also:
        ``compute_operators`` computes without a cache.
    """

    eigenvectors: EigenvectorPrecision = "float32"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("eigenvectors", self.eigenvectors, get_args(EigenvectorPrecision))

    def operators(
        self, shape: Shape, *, settings: OperatorSettings | None = None, scale: float | None = None
    ) -> Operators:
        """The operators of a clean shape, from the cache if they are there; see ``compute_operators``.

        Args:
            shape: as ``homolog.repair`` leaves it.
            settings: what to compute.
            scale: the length of one normalised unit in the file's units.
        """
        check_kind("shape", shape, Shape)
        settings = given_or_default("settings", settings, OperatorSettings)
        path = self.entry(self._key(shape, settings, scale))
        cached = _read(path)
        if cached is not None:
            return cached
        operators = compute_operators(shape, settings=settings, scale=scale)
        self._keep(path, operators)
        if self.eigenvectors == "float16":  # as the next call will read them
            operators = replace(operators, eigenvectors=operators.eigenvectors.half().float())
        return operators

    def _key(self, shape: Shape, settings: OperatorSettings, scale: float | None) -> str:
        described = {"version": _VERSION, "scale": scale, "precision": self.eigenvectors, **asdict(settings)}
        digest = hashlib.sha256(json.dumps(described, sort_keys=True).encode())
        digest.update(shape.points.tobytes())
        digest.update(b"cloud" if shape.faces is None else shape.faces.tobytes())
        return digest.hexdigest()[:40]

    def _keep(self, path: Path, operators: Operators) -> None:
        tensors = _tensors(operators)
        if self.eigenvectors == "float16":
            tensors["eigenvectors"] = tensors["eigenvectors"].half()
        notes = {"length": operators.scale.hex(), "method": operators.method}
        notes["checksum"] = _checksum(path.stem, tensors, notes)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_path(path) as temporary:
                save_file(tensors, temporary, metadata=notes)
            self.make_room_for(path)
        except (OSError, ArgumentError, SafetensorError) as error:
            # A full, read-only or forbidden disk costs time on the next call, no more.
            _log.warning("operators are not cached: %s", error)


def _read(path: Path) -> Operators | None:
    before = _identity(path)
    try:
        tensors, notes = read_tensors(path)
        if notes.pop("checksum", None) != _checksum(path.stem, tensors, notes):
            raise ValueError("its checksum is not that of its name and contents")
        operators = _operators(tensors, scale=float.fromhex(notes["length"]), method=notes["method"])
    except (OSError, SafetensorError, ValueError, KeyError, TypeError, RuntimeError) as error:
        # Another process may have deleted or replaced it during the reading.
        if before is None or before != _identity(path):
            return None
        _log.warning("the cached operators %s are damaged (%s) and are computed anew", path, error)
        return None
    with suppress(OSError):
        os.utime(path)  # marks the entry as used
    return operators


def _identity(path: Path) -> tuple[int, int] | None:
    """Tells a file from the one that replaces it; None if there is none."""
    with suppress(OSError):
        status = path.stat()
        return status.st_ino, status.st_mtime_ns
    return None


def _tensors(operators: Operators) -> dict[str, Tensor]:
    tensors = {name: getattr(operators, name).cpu().contiguous() for name in _DENSE}
    for name, matrix in (("laplacian", operators.laplacian), ("gradient", operators.gradient_x)):
        tensors[f"{name}.rows"] = matrix.crow_indices()
        tensors[f"{name}.columns"] = matrix.col_indices()
    for name in ("laplacian", "gradient_x", "gradient_y"):
        tensors[f"{name}.values"] = getattr(operators, name).values()
    if operators.scatter is not None:
        tensors["scatter"] = operators.scatter.cpu().contiguous()
    return tensors


def _operators(tensors: dict[str, Tensor], *, scale: float, method: str) -> Operators:
    def matrix(pattern: str, values: str) -> Tensor:
        return compressed_rows(tensors[f"{pattern}.rows"], tensors[f"{pattern}.columns"], tensors[f"{values}.values"])

    dense = {name: tensors[name] for name in _DENSE}
    dense["eigenvectors"] = dense["eigenvectors"].float()
    return Operators(
        **dense,
        laplacian=matrix("laplacian", "laplacian"),
        gradient_x=matrix("gradient", "gradient_x"),
        gradient_y=matrix("gradient", "gradient_y"),
        scale=scale,
        method=method,
        scatter=tensors.get("scatter"),
    )


def _checksum(key: str, tensors: dict[str, Tensor], notes: dict[str, str]) -> str:
    """Of an entry: its name too, so that one under another's name is not believed."""
    digest = hashlib.blake2b(json.dumps([key, notes], sort_keys=True).encode(), digest_size=16)
    for name in sorted(tensors):
        array: np.ndarray = tensors[name].numpy()
        digest.update(f"{name} {array.dtype} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
