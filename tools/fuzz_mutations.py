"""Damage to files: what ``tools/fuzz.py`` does to its seeds.

Every mutation takes the content of a file and a source of random numbers, and gives other content. Most files get one
that knows their format, and all of them get some that know nothing of it: bytes, numbers, words, lines.
"""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
from collections.abc import Callable
from random import Random
from typing import Any

Mutation = Callable[[bytes, Random], bytes]

_LARGEST = 2_000_000
_NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_]+")
_INTEGERS = [0, 1, -1, 2, 3, 127, 255, 256, 65535, 2**31 - 1, 2**31, 2**32 - 1, -(2**31), 10**9, 2**63 - 1]
_REALS = [float("nan"), float("inf"), -float("inf"), 1e308, 1e-310, 0.0, -0.0, 1e20]
_NUMERALS = ["0", "-1", "1", "3", "255", "65536", "4294967295", "-2147483648", "9223372036854775807", "1e9", "1e400"]
_NUMERALS += [
    "-1e308",
    "nan",
    "inf",
    "-Infinity",
    "1_000",
    "0x10",
    "1e",
    "",
    "--1",
    "١٢",
    "9" * 400,
    "1" * 5000,
    "true",
]
_TEXTS = ["../../x", "/etc/hostname", "file:///etc/hostname", "http://127.0.0.1:9/x", "data:,", "data:;base64,!!!!"]
_TEXTS += ["a" * 5000, "a\nb", "\u202ex", "\x1b[31m", "\x00", "", "é", "/dev/zero", ".", "~x"]
_VALUES: list[Any] = [None, True, 0, -1, 3, 10**9, -(10**9), 2**64, 10**30, 1e308, -1.5, 0.5, "MAT4", "SCALAR", [], {}]
_VALUES += [[[]], [0], [1, 2, 3], {"a": 1}, 5120, 5126, 99999, *_TEXTS]


def mutate(content: bytes, suffix: str, random: Random) -> bytes:
    """Damage the content of a file with this suffix in one to four places."""
    knows = _STRUCTURED.get(suffix)
    if knows is not None and random.random() < 0.6:
        content = knows(content, random)
        if random.random() < 0.8:
            return content[:_LARGEST]
    is_text = b"\0" not in content[:4000]
    mutations = [*_BYTES, _header_number, _header_word, *(_TEXT * 2 if is_text else [_binary_number] * 3)]
    for _ in range(random.choice((1, 1, 1, 2, 3, 4))):
        content = random.choice(mutations)(content, random)
    return content[:_LARGEST]


# ---- bytes


def _flip(content: bytes, random: Random) -> bytes:
    changed = bytearray(content)
    for _ in range(random.choice((1, 1, 2, 8, 64)) if content else 0):
        changed[random.randrange(len(changed))] ^= 1 << random.randrange(8)
    return bytes(changed)


def _cut_end(content: bytes, random: Random) -> bytes:
    return content[: random.randrange(len(content) + 1)]


def _cut_start(content: bytes, random: Random) -> bytes:
    return content[random.randrange(min(len(content), 64) + 1) :]


def _repeat_or_remove(content: bytes, random: Random) -> bytes:
    start = random.randrange(len(content) + 1)
    end = start + random.choice((1, 2, 4, 16, 100, 1000))
    return content[:start] + content[start:end] * random.choice((0, 0, 2, 4, 50)) + content[end:]


def _insert(content: bytes, random: Random) -> bytes:
    at = random.randrange(len(content) + 1)
    return content[:at] + random.randbytes(random.choice((1, 3, 16, 200))) + content[at:]


def _append(content: bytes, random: Random) -> bytes:
    return content + random.choice((b"\n", bytes(100), random.randbytes(50), content, b" " * 1000, b"\x1a"))


def _binary_number(content: bytes, random: Random) -> bytes:
    changed, order = bytearray(content), random.choice("<>")
    for _ in range(random.choice((1, 1, 2, 5)) if len(content) > 16 else 0):
        if random.random() < 0.7:
            kind = random.choice("BHIQ")
            value = struct.pack(order + kind, random.choice(_INTEGERS) % 2 ** (8 * struct.calcsize(kind)))
        else:
            value = struct.pack(f"{order}d", random.choice(_REALS))
        reach = random.choice((min(400, len(changed)), len(changed)))
        at = random.randrange(max(1, reach - len(value)))
        at -= at % random.choice((1, 2, 4, 4))
        changed[at : at + len(value)] = value
    return bytes(changed)


_BYTES: list[Mutation] = [_flip, _cut_end, _cut_start, _repeat_or_remove, _insert, _append, _binary_number]


# ---- text


def _number(content: bytes, random: Random, reach: int | None = None) -> bytes:
    places = list(_NUMBER.finditer(content, 0, reach or len(content)))
    for place in sorted(random.sample(places, min(len(places), random.choice((1, 1, 2, 5)))), key=lambda m: -m.start()):
        content = content[: place.start()] + random.choice(_NUMERALS).encode() + content[place.end() :]
    return content


def _header_number(content: bytes, random: Random) -> bytes:
    return _number(content, random, random.choice((60, 200, 600)))


def _header_word(content: bytes, random: Random) -> bytes:
    words = list(_WORD.finditer(content[:800]))
    if not words:
        return content
    place, other = random.choice(words), random.choice((random.choice(words)[0], _text(random), b"uint64", b"list"))
    return content[: place.start()] + other + content[place.end() :]


def _text(random: Random) -> bytes:
    return random.choice(_TEXTS).encode()


def _insert_text(content: bytes, random: Random) -> bytes:
    at = random.randrange(len(content) + 1)
    return content[:at] + _text(random) + content[at:]


def _lines(content: bytes, random: Random) -> bytes:
    lines = content.splitlines(keepends=True)
    for _ in range(random.choice((1, 1, 3)) if lines else 0):
        one, other = random.randrange(len(lines)), random.randrange(len(lines))
        changed = [[], [lines[other]], [lines[one], lines[other]], [lines[one].rstrip() * 2 + b"\n"]]
        changed += [[b" ".join(reversed(lines[one].split())) + b"\n"]]
        lines[one : one + 1] = random.choice(changed)
        lines = lines or [b""]
    return b"".join(lines)


def _line_ends(content: bytes, random: Random) -> bytes:
    ends = (b"\r\n", b"\r", b"\n\n", b" \n", b"\\\n", b" ", b"\xe2\x80\xa8", b"\n" * 50)
    return content.replace(b"\r\n", b"\n").replace(b"\n", random.choice(ends), random.choice((1, 10, -1)))


def _encoding(content: bytes, random: Random) -> bytes:
    if random.random() < 0.5:
        return random.choice((b"\xef\xbb\xbf", b"\xff\xfe", b"\n\n", b"#", b" ")) + content
    return content.decode("latin-1").encode(random.choice(("utf-16", "utf-16-le", "utf-32", "utf-7")))


def _blanks(content: bytes, random: Random) -> bytes:
    at = random.choice([match.start() for match in re.finditer(rb"\s", content)] or [0])
    return content[:at] + random.choice((b" ", b"\n", b"\t", b"/", b"x [")) * 50_000 + content[at:]


_TEXT: list[Mutation] = [_number, _number, _insert_text, _lines, _line_ends, _encoding, _blanks]


# ---- JSON, and what has JSON inside


def _json(content: bytes, random: Random) -> bytes:
    if random.random() < 0.05:
        depth = random.choice((500, 100_000))
        return random.choice((b"[" * depth + b"]" * depth, b'{"a":' * depth + b"1" + b"}" * depth))
    return json.dumps(_changed(json.loads(content), random)).encode()


def _changed(tree: Any, random: Random) -> Any:
    """Other values, fewer or more entries, parts in other places."""
    for _ in range(random.choice((1, 1, 2, 3, 6))):
        places = _places(tree)
        if not places:
            return tree
        holder, key = random.choice(places)
        action = random.random()
        if action < 0.6:
            holder[key] = random.choice(_VALUES)
        elif action < 0.75:
            del holder[key]
        elif action < 0.85 and isinstance(holder, list):
            holder.extend([holder[key]] * random.choice((1, 3, 200)))
        else:
            other_holder, other = random.choice(places)
            holder[key] = json.loads(json.dumps(other_holder[other]))
    return tree


def _places(tree: Any) -> list[tuple[Any, Any]]:
    """Every list or object with each of its keys."""
    found, waiting = list[tuple[Any, Any]](), [tree]
    while waiting:
        holder = waiting.pop()
        keys = list(holder) if isinstance(holder, dict) else range(len(holder)) if isinstance(holder, list) else []
        found += [(holder, key) for key in keys]
        waiting += [holder[key] for key in keys]
    return found


def _glb(content: bytes, random: Random) -> bytes:
    length = struct.unpack("<I", content[12:16])[0]
    header = _json(content[20 : 20 + length], random)
    header += b" " * (-len(header) % 4)
    rest = content[20 + length :] * random.choice((1, 1, 1, 1, 0, 2))
    total = 20 + len(header) + len(rest) if random.random() < 0.9 else random.choice(_INTEGERS) % 2**32
    return b"glTF" + struct.pack("<IIII", 2, total, len(header), 0x4E4F534A) + header + rest


def _safetensors(content: bytes, random: Random) -> bytes:
    length = struct.unpack("<Q", content[:8])[0]
    header = json.loads(content[8 : 8 + length])
    notes = header.get("__metadata__", {})
    inner = [name for name, note in notes.items() if note.startswith("{")]
    if inner and random.random() < 0.6:
        name = random.choice(inner)
        notes[name] = json.dumps(_changed(json.loads(notes[name]), random))
    else:
        header = _changed(header, random)
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    size = len(text) if random.random() < 0.95 else random.choice(_INTEGERS) % 2**64
    return struct.pack("<Q", size) + text + content[8 + length :]


# ---- arrays and archives


def _npy(content: bytes, random: Random) -> bytes:
    end = content.index(b"\n") + 1
    header = content[10:end].decode("latin-1")
    shapes = ["(1000000000, 3)", "(99999999999999, 3)", "(-1, 3)", "(0, 3)", "(42, 1000000)", "(3,)", "()", "(True, 3)"]
    shapes += [f"({'1,' * 70})", "(1e3, 3)", "(2**63, 3)", "(4294967296, 4294967296)"]
    types = ["'|O'", "'<f2'", "'<c16'", "'<U4'", "'<M8[s]'", "[('a', '<f4'), ('b', '<f4')]", "'|b1'", "'<V99999999999'"]
    kinds = [
        re.sub(r"\([^()]*\)", random.choice(shapes), header, count=1),
        re.sub(r"'[<>|][^']*'", random.choice(types), header, count=1),
        header.replace("False", random.choice(("True", "None", "0", "__import__('os')"))),
        random.choice(("", "{}", "[" * 1000, "1", "{'shape': (2, 3)}", header * 2)),
    ]
    text = random.choice(kinds).encode("latin-1") + b"\n"
    version = random.choice((b"\1\0", b"\1\0", b"\1\0", b"\2\0", b"\3\0", b"\x09\0"))
    length = struct.pack("<H", len(text) % 65536) if version == b"\1\0" else struct.pack("<I", len(text))
    return b"\x93NUMPY" + version + length + text + content[end:]


def _archive(content: bytes, random: Random) -> bytes:
    with zipfile.ZipFile(io.BytesIO(content)) as stored:
        members = {info.filename: stored.read(info) for info in stored.infolist()}
    name, action = random.choice(list(members)), random.random()
    if action < 0.4 and name.endswith(".npy"):
        members[name] = _npy(members[name], random)
    elif action < 0.55:
        members[name] = mutate(members[name], "", random)
    elif action < 0.65:
        members[random.choice(("../x.npy", "points", "a" * 300, "a\nb.npy"))] = members.pop(name)
    elif action < 0.72:
        del members[name]
    elif action < 0.78:
        members[name] += bytes(300_000_000)
    out = io.BytesIO()
    method = random.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2))
    with zipfile.ZipFile(out, "w", method if action < 0.72 else zipfile.ZIP_DEFLATED) as stored:
        for key, value in members.items():
            stored.writestr(key, value)
    return _directory(out.getvalue(), random) if random.random() < 0.35 else out.getvalue()


def _directory(content: bytes, random: Random) -> bytes:
    """An archive whose directory says other sizes, methods, flags or offsets."""
    changed = bytearray(content)
    for mark, offsets in ((b"PK\1\2", (8, 10, 16, 20, 24, 28, 42)), (b"PK\3\4", (6, 8, 14, 18, 22, 26))):
        starts = [match.start() for match in re.finditer(re.escape(mark), content)]
        if starts and random.random() < 0.7:
            at = random.choice(starts) + random.choice(offsets)
            changed[at : at + 2] = struct.pack("<H", random.choice((0, 1, 8, 12, 14, 99, 65535)))
    return bytes(changed)


# ---- TOML


def _toml(content: bytes, random: Random) -> bytes:
    lines = content.decode().splitlines()
    values = [*_NUMERALS, '"x"', "[[", "[[1]]", "[]", "{}", "1979-05-27", "'''a", '"\\u0000"', "0.0", "-0.0", "1e30"]
    values += [
        "[" * 5000 + "]" * 5000,
        "{a=" * 2000 + "1" + "}" * 2000,
        '["../x", "/etc"]',
        '"a\\nb\\u001b[31m"',
        '"*"',
    ]
    tables = ("[a]", "[[a]]", "a.b.c = 1", "[network]", "x = 1", "\ufeff", "seed = -1", "[data]\nworkers = 99999999999")
    for _ in range(random.choice((1, 1, 2, 3))):
        number = random.randrange(len(lines))
        key, sign, _ = lines[number].partition("=")
        if sign and random.random() < 0.6:
            lines[number] = f"{key}= {random.choice(values)}"
        else:
            lines.insert(number, random.choice((*tables, random.choice(lines))))
    return "\n".join(lines).encode()


_STRUCTURED: dict[str, Mutation] = {
    **{".gltf": _json, ".json": _json, ".glb": _glb, ".safetensors": _safetensors, ".toml": _toml},
    **{".npy": _npy, ".npz": _archive, ".pth": _archive},
}
