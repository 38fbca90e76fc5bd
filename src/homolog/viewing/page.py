"""One self-contained page of a scene: it opens from disk, and loads nothing."""

from __future__ import annotations

import base64
import html
import json
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from homolog.core.errors import ArgumentError
from homolog.core.files import atomic_path, expanded
from homolog.pairs import SIDES, Side
from homolog.viewing.decimation import Decimated, decimate
from homolog.viewing.guiding import Guide
from homolog.viewing.layers import Layer
from homolog.viewing.scene import Body, Scene, typical_spacing

# Of each shape; browsers draw so many smoothly, and the page stays below some 15 MB.
_MOST_POINTS, _MOST_FACES = 100_000, 220_000
# The program of each kind of page, in the order in which it is read.
_PROGRAMS = {"match": ("renderer.js", "landmarks.js", "match.js"), "modes": ("renderer.js", "modes.js")}
_PARTS = Path(__file__).parent / "page"
# Of a number in the packed arrays, in bytes: where each array begins is a multiple of it.
_ALIGNMENT = 4


def page_of(scene: Scene) -> str:
    """The page as text: shapes, styles and program are in it; its policy forbids the browser to load anything.

    Arrays are packed into one block, compressed, in base64. The maps of a scene share its shapes; the more there are,
    the fewer points of large shapes are shown.
    """
    arrays = PackedArrays()
    maps = (scene, *scene.alternatives)
    most = _MOST_POINTS // len(maps), _MOST_FACES // len(maps)
    shown = {side: decimate(body.points, body.faces, *most) for side, body in scene.bodies.items()}
    described = {
        "bodies": [_body(scene.bodies[side], shown[side], arrays) for side in SIDES],
        "maps": [_map(each, shown, arrays) for each in maps],
        "guide": None if scene.guide is None else _guide(scene, scene.guide),
    }
    return assembled("match", scene.title, described, arrays)


def assembled(kind: str, title: str, described: dict[str, Any], arrays: PackedArrays) -> str:
    """A page of one of the kinds that lie beside this file: its own controls and program, and the common renderer."""
    parts = {
        "title": html.escape(title),
        "style": page_style(),
        "body": _part(f"{kind}.html").replace("@title@", html.escape(title)),
        # Within a script, no text may look like the script's end.
        "scene": json.dumps(described, allow_nan=False).replace("<", "\\u003c"),
        "arrays": arrays.packed(),
        "program": "\n".join(map(_part, _PROGRAMS[kind])),
    }
    # In one pass: what is filled in may hold such a sign by chance.
    page = re.sub(r"@(\w+)@", lambda place: parts[place[1]], _part("frame.html"))
    return page.encode(errors="replace").decode()  # names of files need not be UTF-8


def write_page(path: str | Path, scene: Scene) -> None:
    """Write the page of a scene, whole or not at all; see ``page_of``.

    Raises:
        ArgumentError: as ``atomic_path`` does, and if the file's name does not end in .html or .htm.
    """
    check_page(path)
    with atomic_path(path) as temporary:
        temporary.write_text(page_of(scene), encoding="utf-8")


def check_page(path: str | Path) -> None:
    """Check, before any work is done, that browsers take a file for a page by its name: .html or .htm."""
    if expanded(path).suffix.lower() not in (".html", ".htm"):
        raise ArgumentError(f"{path} must end in .html or .htm, so that browsers open it")


def page_style() -> str:
    """The page's style sheet, for pages that are to look like it."""
    return _part("page.css")


def _part(name: str) -> str:
    return (_PARTS / name).read_text(encoding="utf-8")


class PackedArrays:
    """Arrays in one block of bytes."""

    def __init__(self) -> None:
        self._block = bytearray()

    def add(self, array: Shaped[np.ndarray, ...], kind: str) -> dict[str, int | str]:
        """Put an array in; what is returned says where it is and of what kind, as the page's program reads it."""
        self._block += bytes(-len(self._block) % _ALIGNMENT)
        begin = len(self._block)
        self._block += np.ascontiguousarray(array, dtype=np.dtype(kind).newbyteorder("<")).tobytes()
        return {"begin": begin, "length": int(np.size(array)), "kind": kind}

    def packed(self) -> str:
        """The block, compressed, in base64."""
        return base64.b64encode(zlib.compress(bytes(self._block), 6)).decode("ascii")


def _body(body: Body, shown: Decimated, arrays: PackedArrays) -> dict[str, Any]:
    """What is drawn of a shape; its indices are those of the file."""
    points, index = body.points[shown.index], shown.index
    return {
        "title": body.title,
        "total": len(body.points),
        "spacing": body.spacing if len(index) == len(body.points) else typical_spacing(points),
        "points": arrays.add(points, "float32"),
        "faces": None if shown.faces is None else arrays.add(shown.faces, "uint32"),
        "index": arrays.add(index, "uint32"),
        "rank": arrays.add(np.random.default_rng(0).permutation(len(index)), "uint32"),
        "toFile": body.to_file.tolist(),
    }


def _map(scene: Scene, shown: dict[Side, Decimated], arrays: PackedArrays) -> dict[str, Any]:
    """One of the maps between the shapes."""
    return {
        "name": scene.name,
        "note": scene.note,
        "method": scene.method,
        "sides": [_ends(scene, side, other, shown, arrays) for side, other in zip(SIDES, SIDES[::-1], strict=True)],
        "layers": [_layer(layer, shown, arrays) for layer in scene.layers],
    }


def _ends(scene: Scene, side: Side, other: Side, shown: dict[Side, Decimated], arrays: PackedArrays) -> dict[str, Any]:
    """What a click on each point of a shape tells of a map: indices are those of the files."""
    body, opposite, index = scene.bodies[side], scene.bodies[other], shown[side].index
    counterpart = body.counterpart[index]
    opposite_is_whole = len(shown[other].index) == len(opposite.points)
    return {
        "counterpart": arrays.add(counterpart, "int32"),
        "place": None if opposite_is_whole else arrays.add(opposite.points[counterpart], "float32"),
        "back": arrays.add(opposite.counterpart[counterpart], "int32"),
        "confidence": arrays.add(body.confidence[index], "float32"),
    }


def _guide(scene: Scene, guide: Guide) -> dict[str, Any]:
    """Landmarks to begin with, each end by its index in the file and its place, and how they are saved."""
    bodies = [scene.bodies[side] for side in SIDES]
    known = [
        {
            "name": name,
            "ends": [
                {"index": index, "place": body.points[index].tolist()} for body, index in zip(bodies, ends, strict=True)
            ],
        }
        for name, *ends in guide.known
    ]
    return {"files": guide.files, "systems": guide.systems, "known": known, "command": guide.command}


def _layer(layer: Layer, shown: dict[Side, Decimated], arrays: PackedArrays) -> dict[str, Any]:
    ramp, values = layer.ramp, layer.values
    return {
        "name": layer.name,
        "note": layer.note,
        "ramp": ramp and {"stops": ramp.stops, "low": ramp.low, "high": ramp.high, "unit": ramp.unit},
        "colours": [arrays.add(layer.colours[side][shown[side].index], "uint8") for side in SIDES],
        "values": values and [arrays.add(values[side][shown[side].index], "float32") for side in SIDES],
    }
