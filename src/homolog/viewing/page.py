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

from homolog.core.files import atomic_path
from homolog.viewing.layers import Layer
from homolog.viewing.scene import SIDES, Body, Scene

_PARTS = Path(__file__).parent / "page"
# Of a number in the packed arrays, in bytes: where each array begins is a multiple of it.
_ALIGNMENT = 4


def page_of(scene: Scene) -> str:
    """The page as text: shapes, styles and program are in it; its policy forbids the browser to load anything.

    Arrays are packed into one block, compressed, in base64.
    """
    arrays = PackedArrays()
    described = {
        "route": scene.route,
        "bodies": [_body(scene.bodies[side], arrays) for side in SIDES],
        "layers": [_layer(layer, arrays) for layer in scene.layers],
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
        "renderer": _part("renderer.js"),
        "program": _part(f"{kind}.js"),
    }
    # In one pass: what is filled in may hold such a sign by chance.
    return re.sub(r"@(\w+)@", lambda place: parts[place[1]], _part("frame.html"))


def write_page(path: str | Path, scene: Scene) -> None:
    """Write the page of a scene, whole or not at all; see ``page_of``.

    Raises:
        ArgumentError: as ``atomic_path`` does.
    """
    with atomic_path(path) as temporary:
        temporary.write_text(page_of(scene), encoding="utf-8")


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


def _body(body: Body, arrays: PackedArrays) -> dict[str, Any]:
    return {
        "title": body.title,
        "spacing": body.spacing,
        "points": arrays.add(body.points, "float32"),
        "faces": None if body.faces is None else arrays.add(body.faces, "uint32"),
        "counterpart": arrays.add(body.counterpart, "int32"),
        "confidence": arrays.add(body.confidence, "float32"),
        "rank": arrays.add(body.rank, "uint32"),
    }


def _layer(layer: Layer, arrays: PackedArrays) -> dict[str, Any]:
    ramp, values = layer.ramp, layer.values
    return {
        "name": layer.name,
        "note": layer.note,
        "ramp": ramp and {"stops": ramp.stops, "low": ramp.low, "high": ramp.high, "unit": ramp.unit},
        "colours": [arrays.add(layer.colours[side], "uint8") for side in SIDES],
        "values": values and [arrays.add(values[side], "float32") for side in SIDES],
    }
