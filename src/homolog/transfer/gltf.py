"""glTF by its parts: accessors and nodes of a file that is read, and a binary file that is put together."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from homolog.core.errors import DataError
from homolog.shapes.gltf_format import gltf_content
from homolog.shapes.parsing import UnreadableError

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_CODES = {np.dtype(name): code for code, name in _COMPONENTS.items()}
_TYPES = {width: name for name, width in _WIDTHS.items()}
_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963


class GltfReader:
    """The parts of a GLB or glTF file.

    Args:
        path: the file; its buffers may be inside or beside it.

    Raises:
        DataError: if it is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self.header, files = gltf_content(path)
            self._buffers = [_buffer(entry, files) for entry in self.header.get("buffers", [])]
        except (UnreadableError, OSError, ValueError, KeyError, TypeError) as error:
            raise DataError(f"{path} cannot be read as glTF ({error}); export it again") from None

    @property
    def nodes(self) -> list[dict[str, Any]]:
        """The scene's nodes, as the file has them."""
        return list(self.header.get("nodes", []))

    def accessor(self, number: int) -> np.ndarray:
        """The rows (count, width) of an accessor; whole numbers that stand for shares become such.

        Raises:
            DataError: if the file does not hold them.
        """
        try:
            return self._accessor(self.header["accessors"][number])
        except (KeyError, IndexError, ValueError, TypeError) as error:
            raise DataError(f"{self.path} has a damaged accessor {number} ({error}); export it again") from None

    def _accessor(self, accessor: dict[str, Any]) -> np.ndarray:
        dtype, width = np.dtype(_COMPONENTS[accessor["componentType"]]), _WIDTHS[accessor["type"]]
        if "sparse" in accessor or "bufferView" not in accessor:
            raise ValueError("sparse accessors are not supported")
        view = self.header["bufferViews"][accessor["bufferView"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        stride = view.get("byteStride", dtype.itemsize * width)
        rows = np.ndarray(
            (accessor["count"], width),
            dtype,
            self._buffers[view["buffer"]],
            offset=start,
            strides=(stride, dtype.itemsize),
        )
        return rows / np.iinfo(dtype).max if accessor.get("normalized") and dtype.kind != "f" else rows.copy()

    def parents(self) -> dict[int, int]:
        """For each node that has one, the node above it."""
        return {child: number for number, node in enumerate(self.nodes) for child in node.get("children", [])}

    def world(self, node: int) -> Float[np.ndarray, "4 4"]:
        """Where a node's own coordinates lie in the scene's.

        Raises:
            DataError: if nodes are above one another in a circle.
        """
        parents, transform, seen = self.parents(), np.eye(4), set[int]()
        step: int | None = node
        while step is not None:
            if step in seen or not 0 <= step < len(self.nodes):
                raise DataError(f"{self.path} has nodes that make no tree; export it again")
            seen.add(step)
            transform, step = local_transform(self.nodes[step]) @ transform, parents.get(step)
        return transform


def _buffer(entry: dict[str, Any], files: dict[str | None, bytes]) -> bytes:
    name = entry.get("uri")
    if name is not None and name.startswith("data:"):
        return base64.b64decode(name.partition(",")[2])
    return files[name]


def local_transform(node: dict[str, Any]) -> Float[np.ndarray, "4 4"]:
    """A node's transform relative to the one above it."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    transform = np.eye(4)
    transform[:3, :3] = rotation * np.array(node.get("scale", (1.0, 1.0, 1.0)))
    transform[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return transform


class GlbWriter:
    """A binary glTF that is put together part by part."""

    def __init__(self) -> None:
        self.header: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "homolog"},
            "accessors": [],
            "bufferViews": [],
        }
        self._chunks: list[bytes] = []
        self._size = 0

    def accessor(self, rows: np.ndarray, *, bounds: bool = False, indices: bool = False, vertices: bool = True) -> int:
        """Add an array (count,) or (count, width) of a type that glTF knows; its number.

        Args:
            rows: little-endian numbers.
            bounds: whether to state the least and largest values, as positions need.
            indices: whether these are a mesh's triangles.
            vertices: whether a row belongs to a vertex.
        """
        rows = np.ascontiguousarray(rows)
        width = 1 if rows.ndim == 1 else rows.shape[1]
        target = _ELEMENT_ARRAY_BUFFER if indices else _ARRAY_BUFFER if vertices else None
        entry = {
            "bufferView": self.view(rows.tobytes(), target),
            "componentType": _CODES[rows.dtype],
            "count": len(rows),
            "type": _TYPES[width],
        }
        if bounds:
            entry |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        return self.add("accessors", entry)

    def view(self, content: bytes, target: int | None = None) -> int:
        """Add bytes to the buffer; the number of their view."""
        entry = {"buffer": 0, "byteOffset": self._size, "byteLength": len(content)}
        padded = content + bytes(-len(content) % 4)
        self._chunks.append(padded)
        self._size += len(padded)
        return self.add("bufferViews", entry if target is None else entry | {"target": target})

    def add(self, kind: str, entry: dict[str, Any]) -> int:
        """Add an object to one of the header's lists, such as ``nodes``; its number."""
        entries = self.header.setdefault(kind, [])
        entries.append(entry)
        return len(entries) - 1

    def content(self) -> bytes:
        """The whole file."""
        header = json.dumps(self.header | {"buffers": [{"byteLength": self._size}]}, allow_nan=False).encode()
        header += b" " * (-len(header) % 4)
        body = b"".join(self._chunks)
        chunks = struct.pack("<II", len(header), 0x4E4F534A) + header + struct.pack("<II", len(body), 0x004E4942) + body
        return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks
