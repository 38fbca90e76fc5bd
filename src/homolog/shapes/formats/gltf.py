"""glTF 2.0, text and binary: the active scene as viewers show it, and a binary file that is put together.

Specification: Khronos, "glTF 2.0", 2021. What it says of accessors (sparse, normalised, without a view) is done in one
place, ``Gltf.accessor``; what it says of nodes, skins and morph targets in ``parts``.
"""

from __future__ import annotations

import base64
import json
import re
import struct
from collections.abc import Iterable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from jaxtyping import Float, Int
from typing_extensions import TypedDict

from homolog.core.arguments import is_count, is_number
from homolog.core.files import parse_json, read_bytes
from homolog.core.memory import expansion_fault
from homolog.core.messages import shorten, shown
from homolog.core.records import check_record, record
from homolog.shapes.finding import Finding
from homolog.shapes.formats.parsing import CUT_OFF, Arrays, UnreadableError, check_claim, left_out
from homolog.shapes.polygons import fans, strips
from homolog.shapes.shape import Shape

K = TypeVar("K")
V = TypeVar("V")

Pose = Literal["posed", "rest"]
"""Skinned meshes as their joints pose them in the file, as viewers show them, or as they were bound."""

_DRACO = "KHR_draco_mesh_compression"
_MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
_INSTANCES = "EXT_mesh_gpu_instancing"
# Extensions that are read, or refused by name where they matter.
_READ = (_DRACO, *_MESHOPT, _INSTANCES, "KHR_mesh_quantization", "KHR_node_visibility")
# Extensions of looks, lights, sounds, movements and descriptions, which say nothing of where points and triangles are.
_HARMLESS = re.compile(
    r"\w+?_(?:(?:materials?|textures?|lights?|audio|animation|xmp|techniques|image|collision|physics)(?:_\w+)?)"
)
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_CODES = {np.dtype(name): code for code, name in _COMPONENTS.items()}
_TYPES = {width: name for name, width in _WIDTHS.items()}
_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963
# The modes of primitives.
_POINTS, _TRIANGLES, _STRIP, _FAN = 0, 4, 5, 6
# The kinds of a binary file's chunks.
_JSON, _BIN = 0x4E4F534A, 0x004E4942
# Bytes before the first chunk, and those of a chunk before its content: its length and its kind.
_GLB_START, _CHUNK_START = 12, 8
# Of a coordinate or an index of a shape, and as often as reading holds it at a time.
_NUMBER_BYTES = 40
# To place a mesh takes as long as to read so many numbers.
_PLACING = 100
_MOST_JOINTS_PER_POINT = 16
# Bytes of a vector with its index, and without.
_SPARSE_ROW, _FULL_ROW = 16, 12


class _Primitive(TypedDict, total=False):
    attributes: dict[str, int]
    indices: int
    mode: int
    targets: list[dict[str, int]]


class _Mesh(TypedDict, total=False):
    primitives: list[_Primitive]
    weights: list[float]


class _Node(TypedDict, total=False):
    """Its transform is checked where it is used (``local_transform``)."""

    children: list[int]
    mesh: int
    skin: int
    weights: list[float]
    extensions: dict[str, Any]


class _Skin(TypedDict, total=False):
    joints: list[int]
    inverseBindMatrices: int


class _Stored(TypedDict, total=False):
    bufferView: int
    byteOffset: int
    componentType: int


class _Sparse(TypedDict, total=False):
    count: int
    indices: _Stored
    values: _Stored


class _Accessor(TypedDict, total=False):
    bufferView: int
    byteOffset: int
    componentType: int
    count: int
    type: str
    sparse: _Sparse


class _View(TypedDict, total=False):
    buffer: int
    byteOffset: float
    byteLength: float
    byteStride: int


class _Buffer(TypedDict, total=False):
    uri: str
    byteLength: float


class _Scene(TypedDict, total=False):
    nodes: list[int]


@record
class _Header(TypedDict, total=False):
    """The kinds of the entries that shapes are read from."""

    accessors: list[_Accessor]
    buffers: list[_Buffer]
    bufferViews: list[_View]
    meshes: list[_Mesh]
    nodes: list[_Node]
    scene: int
    scenes: list[_Scene]
    skins: list[_Skin]


class _Entries(list[Any]):
    """The objects of one of the header's lists, by their numbers, of which none is negative.

    Args:
        name: of the list, such as ``nodes``.
        entries: its objects.
    """

    def __init__(self, name: str, entries: Iterable[Any] = ()) -> None:
        super().__init__(entries)
        self._name = name

    def __getitem__(self, number: Any) -> Any:
        if not is_count(number, least=0) or number >= len(self):
            found = f"it refers to number {shown(number)} of its {self._name}, but has {len(self)}"
            raise UnreadableError(f"{found}; {CUT_OFF}")
        return super().__getitem__(number)


class Gltf:
    """A GLB or glTF file: its header, and what its accessors hold.

    Args:
        path: the file; its buffers are inside it, or in files beside it.

    Raises:
        UnreadableError: if it is damaged, of version 1, or refers to a file that is not beside it.
    """

    def __init__(self, path: Path) -> None:
        content, self.folder = read_bytes(path), path.parent
        self.header, binary, self.n_bytes_over = _opened(path, content)
        self.files = _files_beside(path.parent, self.header)
        entries = self.header.get("buffers", [])
        available = len(content) + sum(file.stat().st_size for file in self.files.values())
        # Compressed files have buffers without content, which what they hold is unpacked to.
        held = [entry for number, entry in enumerate(entries) if "uri" in entry or (binary is not None and number == 0)]
        check_claim(sum(int(entry["byteLength"]) for entry in held), "bytes of buffers", 1, available)
        for accessor in self.header.get("accessors", []):
            check_claim(int(accessor["count"]), "elements", 1, available)
        self._entries, self._binary, self.size = entries, binary, available
        self._worlds = dict[int, np.ndarray]()

    @cached_property
    def buffers(self) -> list[bytes | None]:
        """The content of each buffer; None where the file has none, as compressed files have them."""
        return [self._buffer(number, entry) for number, entry in enumerate(self._entries)]

    def _buffer(self, number: int, entry: dict[str, Any]) -> bytes | None:
        name = entry.get("uri")
        if name is None:
            return self._binary if number == 0 else None
        return _embedded(name) if name.startswith("data:") else read_bytes(self.files[name])

    def view(self, number: int) -> bytes:
        """The bytes of a buffer view."""
        view = self.header["bufferViews"][number]
        content: bytes | None = _Entries("buffers", self.buffers)[view["buffer"]]
        if content is None:
            told = self.header.get("extensionsUsed", [])
            extension = _used(view, *_MESHOPT) or next((name for name in _MESHOPT if name in told), None)
            nothing = UnreadableError(f"its buffer {view['buffer']} holds nothing; {CUT_OFF}")
            raise self._compressed(extension) if extension else nothing
        start = int(view.get("byteOffset", 0))
        end = start + int(view["byteLength"])
        if not 0 <= start <= end <= len(content):
            raise UnreadableError(f"a buffer ends after {len(content)} bytes, too early; {CUT_OFF}")
        return content[start:end]

    def accessor(self, number: int, *types: str) -> np.ndarray:
        """The rows (count, width) of an accessor: sparse ones filled in, normalised whole numbers as shares of one.

        Args:
            number: of the accessor.
            types: what it may hold, such as ``VEC3``.
        """
        accessor = self.header["accessors"][number]
        if types and accessor["type"] not in types:
            needed = " or ".join(types)
            raise UnreadableError(f"it holds {shown(accessor['type'])} where {needed} is needed; {CUT_OFF}")
        dtype, width = (
            np.dtype(_known(_COMPONENTS, accessor, "componentType", number)),
            _known(_WIDTHS, accessor, "type", number),
        )
        rows = self._rows(accessor, dtype, width, accessor["count"], number)
        if sparse := accessor.get("sparse"):
            index_type = np.dtype(_known(_COMPONENTS, sparse["indices"], "componentType", number))
            which = _from_zero(self._rows(sparse["indices"], index_type, 1, sparse["count"], number)[:, 0])
            if len(which) and which.max() >= len(rows):
                raise UnreadableError(
                    f"its sparse accessor {number} replaces row {which.max()}, but has {len(rows)} rows; {CUT_OFF}"
                )
            rows = rows.copy()
            rows[which] = self._rows(sparse["values"], dtype, width, sparse["count"], number)
        if accessor.get("normalized") and dtype.kind != "f":
            return np.maximum(rows / np.iinfo(dtype).max, -1.0)
        return rows

    def _rows(self, entry: dict[str, Any], dtype: np.dtype[Any], width: int, count: int, number: int) -> np.ndarray:
        """Rows of a buffer view, for an accessor of some number; zeros without one."""
        if "bufferView" not in entry:
            return np.zeros((count, width), dtype)
        content, start = self.view(entry["bufferView"]), entry.get("byteOffset", 0)
        row = dtype.itemsize * width
        stride = self.header["bufferViews"][entry["bufferView"]].get("byteStride", 0) or row
        if 0 < stride < row:
            raise UnreadableError(
                f"the rows of accessor {number} take {row} bytes, but begin every {stride}; {CUT_OFF}"
            )
        if start < 0 or stride < 0 or count < 0 or (count and start + (count - 1) * stride + row > len(content)):
            raise UnreadableError(f"accessor {number} leaves its {len(content)} bytes; {CUT_OFF}")
        return np.ndarray((count, width), dtype, content, start, (stride, dtype.itemsize))

    def image(self, number: int) -> bytes | Path:
        """The content of an image, or the file that holds it, which must lie in the file's own folder or below it."""
        entry = self.header["images"][number]
        if "uri" not in entry:
            return self.view(entry["bufferView"])
        name = str(entry["uri"])
        return _embedded(name) if name.startswith("data:") else _file_beside(self.folder, name)

    def _compressed(self, extension: str) -> UnreadableError:
        return UnreadableError(f"it is compressed with {extension}; export it without compression")

    @cached_property
    def nodes(self) -> list[dict[str, Any]]:
        """All nodes, as the file has them."""
        return _Entries("nodes", self.header.get("nodes", []))

    @cached_property
    def parents(self) -> dict[int, int]:
        """For each node that has one, the node above it."""
        return {child: number for number, node in enumerate(self.nodes) for child in node.get("children", [])}

    def world(self, node: int) -> Float[np.ndarray, "4 4"]:
        """The transform from a node's own coordinates to the scene's."""
        above, seen = list[int](), set[int]()
        step: int | None = node
        while step is not None and step not in self._worlds:
            if step in seen or not 0 <= step < len(self.nodes):
                raise UnreadableError("its nodes make no tree; export it again")
            above.append(step)
            seen.add(step)
            step = self.parents.get(step)
        transform = np.eye(4) if step is None else self._worlds[step]
        for number in reversed(above):
            transform = self._worlds[number] = transform @ local_transform(self.nodes[number], f"node {number}")
        return transform

    def shown(self) -> list[int]:
        """The nodes of the scene that viewers show, depth first; all nodes of a file without scenes."""
        if scenes := self.header.get("scenes"):
            roots = scenes[self.header.get("scene", 0)].get("nodes", [])
        else:
            roots = [number for number in range(len(self.nodes)) if number not in self.parents]
        found, waiting = list[int](), list(reversed(roots))
        while waiting:
            if _is_hidden(self.nodes[waiting[-1]]):
                waiting.pop()
                continue
            found.append(waiting.pop())
            if len(found) > len(self.nodes):
                raise UnreadableError("its nodes make no tree; export it again")
            waiting += reversed(self.nodes[found[-1]].get("children", []))
        return found

    def check_compression(self) -> None:
        """Refuse a file whose numbers, or some of them, exist in compressed form alone."""
        required = self.header.get("extensionsRequired", [])
        for extension in (_DRACO, *_MESHOPT):
            if extension in required:
                raise self._compressed(extension)
        accessors = self.header.get("accessors", [])
        for primitive in (entry for mesh in self.header.get("meshes", []) for entry in mesh["primitives"]):
            numbers = [primitive["attributes"].get("POSITION"), primitive.get("indices")]
            held = all("bufferView" in accessors[number] for number in numbers if number is not None)
            if not held and _used(primitive, _DRACO):
                raise self._compressed(_DRACO)


def _known(kinds: dict[K, V], entry: dict[str, Any], name: str, number: int) -> V:
    """What stands for one of an accessor's kinds."""
    if entry[name] not in kinds:
        allowed = ", ".join(map(str, kinds))
        raise UnreadableError(
            f"accessor {number} has the {name} {shown(entry[name])}, but must have one of {allowed}; {CUT_OFF}"
        )
    return kinds[entry[name]]


def _from_zero(indices: Int[np.ndarray, ...]) -> Int[np.ndarray, ...]:
    """Indices that are whole numbers, and not negative."""
    if indices.dtype.kind == "f" or (indices < 0).any():
        raise UnreadableError(f"its indices are not whole numbers from 0; {CUT_OFF}")
    return indices


def _used(entry: dict[str, Any], *extensions: str) -> str | None:
    """The first of some extensions that an object has."""
    return next((name for name in extensions if name in entry.get("extensions", {})), None)


def _is_hidden(node: dict[str, Any]) -> bool:
    """Whether viewers show neither a node nor what is below it."""
    return not node.get("extensions", {}).get("KHR_node_visibility", {}).get("visible", True)


def _embedded(uri: str) -> bytes:
    """The content of a URI that begins with ``data:``."""
    kind, _, content = uri.partition(",")
    plain = unquote_to_bytes(content)
    return base64.b64decode(plain) if kind.endswith(";base64") else plain


def _opened(path: Path, content: bytes) -> tuple[dict[str, Any], bytes | None, int]:
    """The header, the binary chunk of a GLB, and the number of bytes that follow its end."""
    if content.startswith(b"glTF") or (path.suffix.lower() == ".glb" and not content.lstrip().startswith(b"{")):
        return _glb_chunks(content)
    return _checked_header(content), None, 0


def _glb_chunks(content: bytes) -> tuple[dict[str, Any], bytes | None, int]:
    if content[:4] != b"glTF":
        raise UnreadableError("it does not start with glTF")
    if len(content) < _GLB_START + _CHUNK_START:
        raise UnreadableError(f"it has only {len(content)} bytes; {CUT_OFF}")
    version, length = struct.unpack("<II", content[4:_GLB_START])
    if version != 2:
        raise _other_version(str(version))
    if length > len(content):
        raise UnreadableError(f"the header announces {length} bytes, but the file has {len(content)}; {CUT_OFF}")
    kind, header, end = _chunk(content, _GLB_START)
    if kind != _JSON:
        raise UnreadableError(f"its first chunk is not JSON; {CUT_OFF}")
    binary: bytes | None = None
    # Chunks of other kinds may lie before the binary one; behind the end that the header announces are none.
    while binary is None and end + _CHUNK_START <= len(content) and (end < length or _kind(content, end) == _BIN):
        kind, found, end = _chunk(content, end)
        binary = found if kind == _BIN else None
    # Some programs fill the text up with zeros.
    return _checked_header(header.rstrip(b"\0")), binary, len(content) - max(length, end)


def _kind(content: bytes, start: int) -> int:
    """The kind of the chunk that starts somewhere, behind its length."""
    return int.from_bytes(content[start + 4 : start + _CHUNK_START], "little")


def _chunk(content: bytes, start: int) -> tuple[int, bytes, int]:
    """The kind and the bytes of a chunk, and where it ends."""
    length, first = int.from_bytes(content[start : start + 4], "little"), start + _CHUNK_START
    if length > len(content) - first:
        raise UnreadableError(f"a chunk announces {length} bytes, but {len(content) - first} follow; {CUT_OFF}")
    return _kind(content, start), content[first : first + length], first + length


def _other_version(found: str) -> UnreadableError:
    return UnreadableError(
        f"it is glTF {shorten(found, 10)}, but glTF 2 is needed; convert it, for example with Blender"
    )


def _checked_header(content: bytes) -> dict[str, Any]:
    try:
        header = parse_json(content)
    except ValueError:
        raise UnreadableError(f"it holds no valid JSON; {CUT_OFF}") from None
    if not isinstance(header, dict):
        raise UnreadableError("its JSON is not an object")
    _check_version(header)
    try:
        check_record(header, _Header)
    except ValueError as error:
        raise UnreadableError(f"{error}; {CUT_OFF}") from None
    header.setdefault("accessors", [])
    header |= {name: _Entries(name, entry) for name, entry in header.items() if isinstance(entry, list)}
    required = header.get("extensionsRequired", [])
    unknown = [str(name) for name in required if not _HARMLESS.fullmatch(str(name)) and name not in _READ]
    if unknown:
        raise UnreadableError(
            f"it needs the extension {shorten(', '.join(unknown), 100)}, which is not read; export it without"
        )
    return header


def _check_version(header: dict[str, Any]) -> None:
    """Refuse a file that is none of glTF 2, says no version, or asks for a later one than 2.0."""
    asset = header.get("asset")
    told = asset if isinstance(asset, dict) else {}
    version, least = str(told.get("version", "")), str(told.get("minVersion", "2.0"))
    if version.startswith("1.") or isinstance(header.get("meshes"), dict):
        raise _other_version(version if version.startswith("1.") else "1")
    if not version:
        raise UnreadableError(f"it does not say its version of glTF, asset.version; {CUT_OFF}")
    if not version.startswith("2.") and version != "2":
        raise _other_version(version)
    if least != "2.0":
        raise UnreadableError(
            f"it needs at least glTF {shorten(least, 10)} (asset.minVersion), but 2.0 is read; export it as glTF 2.0"
        )


def buffer_files(path: Path) -> tuple[Path, ...]:
    """The files beside a GLB or glTF that hold its buffers, in the order of the buffers."""
    header, _, _ = _opened(path, read_bytes(path))
    return tuple(_files_beside(path.parent, header).values())


def _files_beside(folder: Path, header: dict[str, Any]) -> dict[str, Path]:
    """The files that hold a glTF's buffers, which must lie in its own folder, by the names that it has for them."""
    files = {}
    for name in [str(b["uri"]) for b in header.get("buffers", []) if "uri" in b]:
        if name.startswith("data:"):
            continue
        file = _file_beside(folder, name)
        if not file.is_file():
            mend = "put that file there, or export as GLB, one file for all"
            raise UnreadableError(f"it refers to {shorten(name)!r}, which is not beside it; {mend}")
        files[name] = file
    return files


def _file_beside(folder: Path, name: str) -> Path:
    """The file of a URI, which must lie in the glTF's own folder or below it; some programs do not quote its name."""
    for spelling in (unquote(name), name):
        file = (folder / spelling).resolve()
        if "://" in name or not file.is_relative_to(folder.resolve()):
            raise UnreadableError(f"it refers to {shorten(name)!r} outside its own folder; put that file beside it")
        if file.is_file():
            return file
    return (folder / unquote(name)).resolve()


class Part(NamedTuple):
    """What one primitive of a placed mesh adds to the shape.

    Args:
        node: the number of the node that places it.
        primitive: as the file has it.
        points: where its points lie in the scene; shape (0, 3) if an earlier primitive has brought them.
        first: the index of its first point among those of the shape.
        faces: triangles as indices from its first point.
        placed: the transform from its own coordinates to the scene's, where no joints move it.
    """

    node: int
    primitive: dict[str, Any]
    points: Float[np.ndarray, "n 3"]
    first: int
    faces: Int[np.ndarray, "m 3"]
    placed: Float[np.ndarray, "4 4"]


def parts(file: Gltf, *, pose: Pose = "posed") -> Iterator[Part]:
    """All that the scene shows, primitive by primitive, in the order of the shape's points and faces.

    Primitives of one mesh that share their points, as those of several materials often do, share them in the shape.

    Args:
        file: the file.
        pose: whether joints move skinned meshes. In either case the transform of the mesh's own node is ignored, as the
            specification asks for.
    """
    n_points = 0
    for node in file.shown():
        if "mesh" not in file.nodes[node]:
            continue
        mesh = file.header["meshes"][file.nodes[node]["mesh"]]
        weights = default_weights(file, node)
        for placed in _placements(file, node):
            known = dict[str, int]()
            for primitive in mesh["primitives"]:
                mode = _mode(primitive)
                if (mode != _POINTS and mode < _TRIANGLES) or not _positions(primitive):
                    continue
                key = _key(primitive)
                points = np.zeros((0, 3))
                if key not in known:
                    known[key] = n_points
                    points = _placed(file, node, placed, primitive, weights, pose)
                count = file.header["accessors"][primitive["attributes"]["POSITION"]]["count"]
                faces = _faces(file, primitive, mode, count)
                # By the specification a transform that mirrors turns the triangles round as well.
                mirrored = np.linalg.det(placed[:3, :3]) < 0 and "skin" not in file.nodes[node]
                yield Part(node, primitive, points, known[key], faces[:, [0, 2, 1]] if mirrored else faces, placed)
                n_points += len(points)


def default_weights(file: Gltf, node: int) -> list[float]:
    """The weights of the morph targets of a node's mesh, as the file shows them; none where it does not say."""
    mesh = file.header["meshes"][file.nodes[node]["mesh"]]
    found: list[float] = file.nodes[node].get("weights", mesh.get("weights", []))
    return found


def morph_offsets(file: Gltf, part: Part) -> Iterator[Float[np.ndarray, "n 3"]]:
    """What each morph target adds to a part's points at the weight one, turned as its joints or its node turn them."""
    node, attributes = file.nodes[part.node], part.primitive["attributes"]
    for target in part.primitive.get("targets", []):
        if "POSITION" not in target:
            yield np.zeros_like(part.points)
            continue
        added = _as_many(file.accessor(target["POSITION"], "VEC3"), part.points, "a morph target").astype(np.float64)
        if "skin" in node and "JOINTS_0" in attributes:
            yield _posed(file, node["skin"], attributes, added, vectors=True)
        else:
            yield added @ part.placed[:3, :3].T


def _mode(primitive: dict[str, Any]) -> int:
    """What a primitive is made of: points, lines or triangles."""
    mode: int = primitive.get("mode", _TRIANGLES)
    if mode not in range(_FAN + 1):
        raise UnreadableError(f"primitive mode {mode} does not exist (0 to {_FAN}); {CUT_OFF}")
    return mode


def _key(primitive: dict[str, Any]) -> str:
    """What two primitives of a mesh have in common whose points are the same."""
    movers = ("POSITION", "JOINTS_", "WEIGHTS_")
    attributes = {name: number for name, number in primitive["attributes"].items() if name.startswith(movers)}
    return json.dumps([attributes, primitive.get("targets")], sort_keys=True)


def _placements(file: Gltf, node: int) -> list[Float[np.ndarray, "4 4"]]:
    """Where a node's mesh is shown: once, or at each of its instances."""
    world = file.world(node)
    instances = file.nodes[node].get("extensions", {}).get(_INSTANCES)
    if instances is None:
        return [world]
    rows = {name.lower(): file.accessor(number) for name, number in instances["attributes"].items()}
    own = [
        {name: row.tolist() for name, row in zip(rows, values, strict=True)}
        for values in zip(*rows.values(), strict=True)
    ]
    return [world @ local_transform(entry, f"an instance of node {node}") for entry in own]


def _placed(
    file: Gltf,
    node: int,
    world: Float[np.ndarray, "4 4"],
    primitive: dict[str, Any],
    weights: list[float],
    pose: Pose,
) -> Float[np.ndarray, "n 3"]:
    """The points of a primitive in the scene: moved by morph targets, and then by joints or by the node."""
    points: np.ndarray = file.accessor(primitive["attributes"]["POSITION"], "VEC3").astype(np.float64)
    for weight, target in zip(weights, primitive.get("targets", []), strict=False):
        if weight and "POSITION" in target:
            points = points + weight * _as_many(file.accessor(target["POSITION"], "VEC3"), points, "a morph target")
    if "skin" not in file.nodes[node] or "JOINTS_0" not in primitive["attributes"]:
        return np.asarray(points @ world[:3, :3].T + world[:3, 3])
    return _posed(file, file.nodes[node]["skin"], primitive["attributes"], points) if pose == "posed" else points


def _as_many(rows: np.ndarray, points: Float[np.ndarray, "n 3"], what: str) -> np.ndarray:
    """Rows of numbers, of which there must be one for each point."""
    if len(rows) != len(points):
        raise UnreadableError(f"{what} has {len(rows)} rows for {len(points)} points; {CUT_OFF}")
    return rows


def _posed(
    file: Gltf, skin: int, attributes: dict[str, int], points: Float[np.ndarray, "n 3"], *, vectors: bool = False
) -> Float[np.ndarray, "n 3"]:
    """Where joints carry the points of a skinned mesh, or vectors at them: linear blend skinning."""
    joints = file.header["skins"][skin]["joints"]
    carried = np.stack([file.world(joint) for joint in joints]) @ _inverse_binds(file, skin)
    posed, total = np.zeros_like(points), np.zeros((len(points), 1))
    for joint, share in influences(file, attributes):
        _as_many(joint, points, "a skin"), _as_many(share, points, "a skin")
        if len(joint) and joint.max() >= len(joints):
            found = f"a mesh refers to joint {joint.max()} of its skin {skin}, which has {len(joints)}"
            raise UnreadableError(f"{found}; {CUT_OFF}")
        matrices = carried[joint]
        shifts = 0.0 if vectors else matrices[:, :3, 3]
        posed += share[:, None] * (np.einsum("nij,nj->ni", matrices[:, :3, :3], points) + shifts)
        total += share[:, None]
    return np.where(total > 0, posed / np.where(total > 0, total, 1.0), points)


def influences(
    file: Gltf, attributes: dict[str, int]
) -> Iterator[tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]]:
    """The joints that move the points of a primitive, one for each point, and their shares; a joint may come twice."""
    for layer in range(_MOST_JOINTS_PER_POINT // 4):
        if f"JOINTS_{layer}" not in attributes:
            return
        joints = _from_zero(file.accessor(attributes[f"JOINTS_{layer}"], "VEC4")).astype(np.int64)
        shares = file.accessor(attributes[f"WEIGHTS_{layer}"], "VEC4").astype(np.float64)
        yield from zip(joints.T, shares.T, strict=True)


def _inverse_binds(file: Gltf, skin: int) -> Float[np.ndarray, "j 4 4"]:
    """The matrices that take the points of a mesh to the coordinates of each of a skin's joints, as it was bound."""
    entry = file.header["skins"][skin]
    if "inverseBindMatrices" not in entry:
        return np.tile(np.eye(4), (len(entry["joints"]), 1, 1))
    matrices = (
        file.accessor(entry["inverseBindMatrices"], "MAT4").astype(np.float64).reshape(-1, 4, 4).transpose(0, 2, 1)
    )
    if len(matrices) < len(entry["joints"]):
        raise UnreadableError(f"a skin has {len(entry['joints'])} joints, but {len(matrices)} matrices; {CUT_OFF}")
    return matrices[: len(entry["joints"])]


def _faces(file: Gltf, primitive: dict[str, Any], mode: int, n_points: int) -> Int[np.ndarray, "m 3"]:
    if mode == _POINTS:
        return np.zeros((0, 3), dtype=np.int64)
    corners: np.ndarray = np.arange(n_points)
    if "indices" in primitive:
        corners = _from_zero(file.accessor(primitive["indices"], "SCALAR"))[:, 0].astype(np.int64)
    if mode == _TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    triangles = {_STRIP: strips, _FAN: fans}[mode](np.array([len(corners)]))
    return np.asarray(corners[triangles])


def read(path: Path, *, pose: Pose = "posed") -> Arrays:
    """Read all meshes and points that the scene shows, one after the other.

    Args:
        path: the file.
        pose: skinned meshes as their joints pose them in the file, which viewers show, or at rest, as they were bound.
    """
    file = Gltf(path)
    file.check_compression()
    _check_size(file)
    found = list(parts(file, pose=pose))
    if not found:
        raise UnreadableError("its scene holds no mesh and no points")
    points = np.concatenate([part.points for part in found])
    faces = [part.first + part.faces for part in found if _mode(part.primitive) != _POINTS]
    return Arrays(points, np.concatenate(faces) if faces else None, tuple(_notes(file, pose)))


def read_rest(path: Path) -> Arrays:
    """Read a file as ``read`` does, with skinned meshes at rest."""
    return read(path, pose="rest")


def _check_size(file: Gltf) -> None:
    """Refuse small meshes placed so often that the scene would not fit."""
    accessors = file.header.get("accessors", [])
    sizes = list[tuple[int, int]]()
    for primitives in (mesh["primitives"] for mesh in file.header.get("meshes", [])):
        n_points = sum(int(accessors[number]["count"]) for each in primitives for number in _positions(each))
        sizes.append(
            (n_points, n_points + sum(int(accessors[p["indices"]]["count"]) for p in primitives if "indices" in p))
        )
    sizes, total, n_numbers = _Entries("meshes", sizes), 0, 0
    for node in file.nodes:
        instances = node.get("extensions", {}).get(_INSTANCES, {}).get("attributes", {})
        often = max([int(accessors[number]["count"]) for number in instances.values()], default=1)
        if "mesh" in node:
            n_points, n_corners = sizes[node["mesh"]]
            total, n_numbers = total + often * n_points, n_numbers + often * (3 * n_points + n_corners + _PLACING)
    # Whatever is placed once is in the file.
    once = sum(3 * n_points + n_corners + _PLACING for n_points, n_corners in sizes)
    if n_numbers > once and (fault := expansion_fault(_NUMBER_BYTES * n_numbers, file.size)):
        raise UnreadableError(f"its scene has {total} points; export one object alone; {fault}")


def _positions(primitive: dict[str, Any]) -> tuple[int, ...]:
    """The accessor of a primitive's points; none of one without points, which is not drawn."""
    return (primitive["attributes"]["POSITION"],) if "POSITION" in primitive["attributes"] else ()


def _notes(file: Gltf, pose: Pose) -> Iterator[Finding]:
    """What viewers show that a shape has not, and what of the file the scene leaves out."""
    if file.n_bytes_over > 0:
        yield left_out("bytes after its end", file.n_bytes_over, "the header announces no more")
    shown = set(file.shown())
    meshes = [file.header["meshes"][file.nodes[node]["mesh"]] for node in shown if "mesh" in file.nodes[node]]
    n_lines = sum(0 < _mode(p) < _TRIANGLES for mesh in meshes for p in mesh["primitives"])
    if n_lines:
        yield left_out("primitives of lines", n_lines, "a shape has points and triangles")
    if n_empty := sum(not _positions(p) for mesh in meshes for p in mesh["primitives"]):
        yield left_out("primitives without points", n_empty, "viewers do not show them either")
    if hidden := sum("mesh" in node for number, node in enumerate(file.nodes) if number not in shown):
        yield left_out("meshes outside the scene or hidden", hidden, "viewers do not show them either")
    if skinned := sum("skin" in file.nodes[node] and "mesh" in file.nodes[node] for node in shown):
        how = "posed by their joints, as viewers show them" if pose == "posed" else "at rest, as they were bound"
        yield Finding("skinned meshes", skinned, "note", how)


def local_transform(node: dict[str, Any], called: str) -> Float[np.ndarray, "4 4"]:
    """A node's transform relative to the one above it; ``called`` is what messages call the node."""
    if "matrix" in node:
        return np.array(_numbers(node, called, "matrix", np.eye(4).ravel().tolist())).reshape(4, 4).T
    x, y, z, w = _numbers(node, called, "rotation", [0.0, 0.0, 0.0, 1.0])
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    transform = np.eye(4)
    transform[:3, :3] = rotation * np.array(_numbers(node, called, "scale", [1.0, 1.0, 1.0]))
    transform[:3, 3] = _numbers(node, called, "translation", [0.0, 0.0, 0.0])
    return transform


def _numbers(node: dict[str, Any], called: str, name: str, otherwise: list[float]) -> list[float]:
    """The numbers of one of a node's entries, as many as those that stand for it where it is missing."""
    given = node.get(name, otherwise)
    if not isinstance(given, list) or not all(map(is_number, given)):
        raise UnreadableError(
            f"{called} has the {name} {shown(given)}, but must have {len(otherwise)} numbers; {CUT_OFF}"
        )
    if len(given) != len(otherwise):
        found = f"{called} has a {name} of {len(given)} numbers"
        raise UnreadableError(f"{found}, but must have {len(otherwise)}; {CUT_OFF}")
    return [float(number) for number in given]


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

    def sparse(self, rows: Float[np.ndarray, "n 3"]) -> int:
        """Add vectors of vertices of which many may be zero; its number. Only the others are written."""
        rows = rows.astype("<f4")
        (which,) = np.nonzero(rows.any(axis=1))
        if len(which) * _SPARSE_ROW >= len(rows) * _FULL_ROW:
            return self.accessor(rows, bounds=True)
        which = which if len(which) else np.zeros(1, dtype=np.int64)  # glTF demands one at least
        return self.add(
            "accessors",
            {
                "componentType": _CODES[rows.dtype],
                "count": len(rows),
                "type": _TYPES[3],
                "min": rows.min(axis=0).tolist(),
                "max": rows.max(axis=0).tolist(),
                "sparse": {
                    "count": len(which),
                    "indices": {
                        "bufferView": self.view(which.astype("<u4").tobytes()),
                        "componentType": _CODES[np.dtype("<u4")],
                    },
                    "values": {"bufferView": self.view(rows[which].tobytes())},
                },
            },
        )

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
        chunks = struct.pack("<II", len(header), _JSON) + header + struct.pack("<II", len(body), _BIN) + body
        return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def write_glb(path: Path, shape: Shape) -> None:
    """Write a mesh or a cloud as a binary glTF of one node, in single precision."""
    glb = GlbWriter()
    primitive: dict[str, Any] = {"attributes": {"POSITION": glb.accessor(shape.points.astype("<f4"), bounds=True)}}
    if shape.faces is None:
        primitive["mode"] = _POINTS
    else:
        primitive["indices"] = glb.accessor(shape.faces.ravel().astype("<u4"), indices=True)
    glb.add("meshes", {"primitives": [primitive]})
    glb.add("nodes", {"mesh": 0, "name": shape.name})
    glb.header |= {"scenes": [{"nodes": [0]}], "scene": 0}
    path.write_bytes(glb.content())
