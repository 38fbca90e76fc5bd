"""Reading GLB and glTF: all meshes of the scene with their nodes' transforms applied, one after the other."""

from __future__ import annotations

import json
import logging
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import trimesh

from homolog.shapes.parsing import CUT_OFF, Arrays, UnreadableError, check_claim, shorten

_COMPRESSIONS = {"KHR_draco_mesh_compression", "EXT_meshopt_compression"}
_MOST_POINTS = 200_000_000


def read_glb(path: Path) -> Arrays:
    """Read a binary glTF file."""
    content = path.read_bytes()
    return _read(path, content, "glb", _glb_header(content))


def read_gltf(path: Path) -> Arrays:
    """Read a glTF file; its buffers are inside it or in files beside it."""
    content = path.read_bytes()
    return _read(path, content, "gltf", _json_object(content))


def buffer_files(path: Path) -> tuple[Path, ...]:
    """The files beside a GLB or glTF that hold its buffers, in the order of the buffers."""
    content = path.read_bytes()
    header = _glb_header(content) if path.suffix.lower() == ".glb" else _json_object(content)
    return tuple(_files_beside(path.parent, header).values())


def gltf_content(path: Path) -> tuple[dict[str, Any], dict[str | None, bytes]]:
    """The header of a GLB or glTF, and its buffers by their names; under None the one inside a GLB.

    Raises:
        UnreadableError: if it is damaged, or refers to a file that is not beside it.
    """
    content = path.read_bytes()
    binary = path.suffix.lower() == ".glb"
    header = _glb_header(content) if binary else _json_object(content)
    files: dict[str | None, bytes] = {
        name: file.read_bytes() for name, file in _files_beside(path.parent, header).items()
    }
    if binary:
        # Behind the header come the length and the kind of the second chunk, and then its bytes.
        files[None] = content[28 + struct.unpack("<I", content[12:16])[0] :]
    return header, files


def _glb_header(content: bytes) -> dict[str, Any]:
    if len(content) < 20 or content[:4] != b"glTF":
        raise UnreadableError("it does not start with glTF")
    length, chunk = struct.unpack("<II", content[8:16])
    if length > len(content) or chunk > len(content) - 20:
        raise UnreadableError(f"the header announces {length} bytes, but the file has {len(content)}; {CUT_OFF}")
    return _json_object(content[20 : 20 + chunk])


def _json_object(content: bytes) -> dict[str, Any]:
    try:
        header = json.loads(content)
    except ValueError:
        raise UnreadableError(f"it holds no valid JSON; {CUT_OFF}") from None
    if not isinstance(header, dict):
        raise UnreadableError("its JSON is not an object")
    return header


def _read(path: Path, content: bytes, kind: str, header: dict[str, Any]) -> Arrays:
    if used := _COMPRESSIONS.intersection(header.get("extensionsRequired", [])):
        raise UnreadableError(f"it is compressed with {', '.join(used)}; export it without compression")
    files = {name: file.read_bytes() for name, file in _files_beside(path.parent, header).items()}
    available = len(content) + sum(map(len, files.values()))
    check_claim(sum(int(b["byteLength"]) for b in header.get("buffers", [])), "bytes of buffers", 1, available)
    _check_accessors(header, available)
    with quiet_trimesh():
        scene = trimesh.load_scene(BytesIO(content), file_type=kind, resolver=files, skip_materials=True)
    return _merged(scene)


def _files_beside(folder: Path, header: dict[str, Any]) -> dict[str, Path]:
    """The files that hold a glTF's buffers, which must lie in its own folder, by the names that it has for them."""
    files = {}
    for name in [str(b["uri"]) for b in header.get("buffers", []) if "uri" in b]:
        if name.startswith("data:"):
            continue
        file = (folder / unquote(name)).resolve()
        if "://" in name or file.parent != folder.resolve():
            raise UnreadableError(f"it refers to {shorten(name)!r} outside its own folder; put that file beside it")
        if not file.is_file():
            mend = "put that file there, or export as GLB, one file for all"
            raise UnreadableError(f"it refers to {shorten(name)!r}, which is not beside it; {mend}")
        files[name] = file
    return files


def _check_accessors(header: dict[str, Any], available: int) -> None:
    """Refuse counts beyond the file's size, and small meshes placed so often that the scene would not fit."""
    accessors = header.get("accessors", [])
    for accessor in accessors:
        check_claim(int(accessor["count"]), "elements", 1, available)
    meshes = header.get("meshes", [])
    sizes = [sum(int(accessors[p["attributes"]["POSITION"]]["count"]) for p in m["primitives"]) for m in meshes]
    total = sum(sizes[node["mesh"]] for node in header.get("nodes", []) if "mesh" in node)
    if total > _MOST_POINTS:
        raise UnreadableError(f"its scene has {total} points, more than {_MOST_POINTS}; export one object alone")


@contextmanager
def quiet_trimesh() -> Iterator[None]:
    """Within a ``with`` block, keep what trimesh logs from the user."""
    logger = logging.getLogger("trimesh")
    before = logger.disabled
    logger.disabled = True
    try:
        yield
    finally:
        logger.disabled = before


def _merged(scene: trimesh.Scene) -> Arrays:
    points, faces, n_points = list[np.ndarray](), list[np.ndarray](), 0
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        geometry = scene.geometry[name]
        points.append(trimesh.transform_points(geometry.vertices, transform))
        if isinstance(geometry, trimesh.Trimesh):
            faces.append(np.asarray(geometry.faces, dtype=np.int64) + n_points)
        n_points += len(points[-1])
    if not points:
        raise UnreadableError("its scene holds no mesh and no points")
    return Arrays(np.concatenate(points), np.concatenate(faces) if faces else None)
