"""Textures that are made to fill the memory, or lie in what is no file."""

import os
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from homolog.core.errors import DataError
from homolog.transfer.appearance import read_image


def black(path, side):
    """An image of one bit per pixel, written by hand: to make one takes as much memory as to read it."""
    packer = zlib.compressobj(9)
    row = bytes(side // 8 + 2)
    data = b"".join(packer.compress(row) for _ in range(side)) + packer.flush()
    header = struct.pack(">IIBBBBB", side, side, 1, 0, 0, 0, 0)
    chunks = [
        struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        for kind, content in ((b"IHDR", header), (b"IDAT", data), (b"IEND", b""))
    ]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunks))
    return path


@pytest.mark.parametrize("side", [9_000, 13_000, 20_000])
def test_an_image_is_weighed_against_its_file(tmp_path, side, recwarn):
    with pytest.raises(DataError, match=r"HOMOLOG_EXPANSION_MB|more than an image may have; make it smaller") as caught:
        read_image(black(tmp_path / "a.png", side))
    assert str(caught.value).isprintable()
    assert not recwarn.list


def test_an_image_within_the_bound_is_read(tmp_path, monkeypatch):
    path = black(tmp_path / "a.png", 1000)
    assert read_image(path).shape == (1000, 1000, 3)
    monkeypatch.setenv("HOMOLOG_EXPANSION_MB", "1")
    with pytest.raises(DataError, match="HOMOLOG_EXPANSION_MB"):
        read_image(path)


def test_pipes_and_devices_are_no_images(tmp_path):
    os.mkfifo(tmp_path / "pipe.png")
    for path in (tmp_path / "pipe.png", "/dev/zero", tmp_path):
        with pytest.raises(DataError, match="cannot be read as an image"):
            read_image(path)


@pytest.mark.parametrize(
    ("kept", "told"),
    [
        (33, "it is no image that Pillow knows, or it is cut off"),
        (5, "it is no image"),
        (-300, "it is damaged, or cut off"),
    ],
)
def test_images_that_are_cut_off(tmp_path, kept, told):
    """A header without pixels, less than a header, and pixels that end early."""
    path = tmp_path / "a.png"
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (40, 40, 3), np.uint8)).save(path)
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(DataError) as caught:
        read_image(path)
    assert f"a.png, a texture, cannot be read as an image: {told}" in str(caught.value)
    assert str(caught.value).endswith("; export it again") and "0x" not in str(caught.value)
