"""Headers of volumes that lie: one line, no crash, no memory for what is not there, nothing that waits for a pipe."""

from __future__ import annotations

import gzip
import os
import zlib
from pathlib import Path

import numpy as np
import pytest

from homolog.core.errors import ShapeError
from homolog.volumes import read_mask

sitk = pytest.importorskip("SimpleITK")

META = (
    "ObjectType = Image\nNDims = {dims}\nBinaryData = True\nBinaryDataByteOrderMSB = False\n{more}"
    "TransformMatrix = 1 0 0 0 1 0 0 0 1\nOffset = 0 0 0\nElementSpacing = 1 1 1\nDimSize = {size}\n"
    "ElementType = MET_UCHAR\nElementDataFile = {data}\n"
)
NRRD = (
    "NRRD0004\ntype: unsigned char\ndimension: 3\nspace: left-posterior-superior\nsizes: {size}\n"
    "space directions: (1,0,0) (0,1,0) (0,0,1)\nkinds: domain domain domain\nendian: little\nencoding: {encoding}\n"
    "space origin: (0,0,0)\n{data}\n"
)


def meta(size: str = "9 9 9", data: str = "LOCAL", dims: str = "3", more: str = "") -> bytes:
    return META.format(size=size, data=data, dims=dims, more=more).encode()


def nrrd(size: str = "9 9 9", encoding: str = "raw", data: str = "") -> bytes:
    return NRRD.format(size=size, encoding=encoding, data=data).encode()


def refused(path: Path, content: bytes, *words: str) -> None:
    path.write_bytes(content)
    with pytest.raises(ShapeError) as caught:
        read_mask(path)
    message = str(caught.value)
    assert message.startswith(str(path)) or str(path.parent) in message
    assert message.isprintable()
    for word in words:
        assert word in message, message


@pytest.mark.parametrize("dims", ["4294967295", "-1", "0", "50", "9" * 400, "x"])
def test_numbers_of_dimensions_crash_nothing(tmp_path: Path, dims: str, capfd: pytest.CaptureFixture[str]) -> None:
    refused(tmp_path / "a.mha", meta(dims=dims) + bytes(729), "dimensions, but a volume has 3; give one volume")
    assert capfd.readouterr() == ("", "")


def test_vectors_of_hundreds_of_digits_crash_nothing(tmp_path: Path) -> None:
    for name in ("Offset = 0 0 0", "ElementSpacing = 1 1 1", "TransformMatrix = 1 0 0 0 1 0 0 0 1"):
        changed = meta().replace(name.encode(), name[: name.index("=") + 2].encode() + b"9" * 700)
        (tmp_path / "a.mha").write_bytes(changed + b"\1" * 729)
        try:
            read_mask(tmp_path / "a.mha")
        except ShapeError as error:
            assert str(error).isprintable()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.mha", meta("1500 1500 1500") + b"\1" * 1000),
        ("a.mha", meta("1500 1500 1500", more="CompressedData = True\n") + zlib.compress(bytes(1000))),
        ("a.nrrd", nrrd("1500 1500 1500") + b"\1" * 1000),
        ("a.nrrd", nrrd("1500 1500 1500", "gzip") + gzip.compress(bytes(1000))),
        ("a.mha", meta("100000 100000 100000") + b"\1" * 1000),
    ],
)
def test_promised_volumes_are_weighed_against_the_file(tmp_path: Path, name: str, content: bytes) -> None:
    refused(tmp_path / name, content, f"{name}: its ", "HOMOLOG_EXPANSION_MB")


@pytest.mark.parametrize(
    ("entry", "changed", "told"),
    [
        ("dimension: 3", "dimension: 99", ": its header says 99 dimensions, but a volume has 3; give one volume"),
        ("sizes: 9 9 9", "sizes: 9 9", "(its entry 'sizes' is not as NRRD allows); write it again"),
        ("sizes: 9 9 9", "sizes: 9 0 9", "(its entry 'sizes' is not as NRRD allows); write it again"),
        ("encoding: raw", "encoding: none", "(its entry 'encoding' is not as NRRD allows); write it again"),
        ("(1,0,0)", "(x,0,0)", "(a vector of its header is not as NRRD allows); write it again"),
        ("NRRD0004", "NRRD0099", "(it has no header of NRRD); write it again"),
        ("space origin: (0,0,0)\n\n", "", "(its header ends early); write it again"),
    ],
)
def test_headers_of_nrrd_are_refused_in_our_words(tmp_path: Path, entry: str, changed: str, told: str) -> None:
    content = nrrd().decode()
    assert entry in content
    damaged = content.replace(entry, changed).encode()
    refused(tmp_path / "a.nrrd", damaged + (bytes(729) if changed else b""), told)


@pytest.mark.parametrize(
    ("entry", "changed", "told"),
    [
        ("DimSize = 9 9 9", "DimSize = 9 9", "(its header is not as MetaImage has it); write it again"),
        ("NDims = 3\n", "", "(its header is not as MetaImage has it); write it again"),
        ("MET_UCHAR", "MET_NONE", "(its voxels are of a type that is not known); write it again"),
    ],
)
def test_headers_of_metaimage_are_refused_in_our_words(tmp_path: Path, entry: str, changed: str, told: str) -> None:
    refused(tmp_path / "a.mha", meta().replace(entry.encode(), changed.encode()) + bytes(729), told)


def test_voxels_that_cannot_be_unpacked_are_not_believed(tmp_path: Path) -> None:
    """The library of MetaImage gives memory as it finds it."""
    values = np.zeros((20, 20, 20), dtype=np.uint8)
    values[5:15, 5:15, 5:15] = np.random.default_rng(0).integers(1, 9, (10, 10, 10))
    packed = zlib.compress(values.tobytes())
    more = f"CompressedData = True\nCompressedDataSize = {len(packed)}\n"
    (tmp_path / "a.mha").write_bytes(meta("20 20 20", more=more) + packed)
    assert read_mask(tmp_path / "a.mha").inside.sum() == 1000
    middle = len(packed) // 2
    for content in (packed[:middle], packed[:middle] + bytes(50) + packed[middle + 50 :], b"x" * len(packed)):
        refused(tmp_path / "a.mha", meta("20 20 20", more=more) + content, "damaged")
    refused(tmp_path / "a.mha", meta("20 20 20", more="CompressedData = True\n") + packed[:middle], "damaged")


def test_a_packed_nifti_expands_as_far_as_allowed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.zeros((50, 60, 70), dtype=np.uint8)
    values[10:20, 10:20, 10:20] = 1
    sitk.WriteImage(sitk.GetImageFromArray(values), str(tmp_path / "a.nii.gz"))
    assert read_mask(tmp_path / "a.nii.gz").inside.sum() == 1000
    monkeypatch.setenv("HOMOLOG_EXPANSION_MB", "0.1")
    with pytest.raises(ShapeError, match="HOMOLOG_EXPANSION_MB"):
        read_mask(tmp_path / "a.nii.gz")


@pytest.mark.parametrize("voxels", ["pipe.raw", "/dev/zero", "/dev/null/x", "."])
def test_voxels_come_from_ordinary_files_alone(tmp_path: Path, voxels: str) -> None:
    os.mkfifo(tmp_path / "pipe.raw")
    (tmp_path / "a1.raw").write_bytes(bytes(81))
    for name, content in (
        ("a.mhd", meta(data=voxels)),
        ("b.mhd", meta(data="LIST") + f"{voxels}\n".encode() * 9),
        ("c.mhd", meta(data="LIST 2") + b"a1.raw\n" + f"{voxels}\n".encode() * 8),
        ("a.nhdr", nrrd(data=f"data file: {voxels}\n")),
        ("b.nhdr", nrrd(data=f"datafile: {voxels}\n")),
        ("c.nhdr", nrrd(data="data file: LIST\n" + f"{voxels}\n" * 9)),
    ):
        refused(tmp_path / name, content, "is not there")


def test_numbered_files_are_found_and_their_number_is_bounded(tmp_path: Path) -> None:
    values = np.zeros((4, 9, 9), dtype=np.uint8)
    values[1:3, 3:6, 3:6] = 1
    for number, layer in enumerate(values, 1):
        (tmp_path / f"layer{number:02d}.raw").write_bytes(layer.tobytes())
    (tmp_path / "a.mhd").write_bytes(meta("9 9 4", "layer%02d.raw 1 4 1"))
    assert read_mask(tmp_path / "a.mhd").inside.sum() == 18
    (tmp_path / "layer03.raw").unlink()
    os.mkfifo(tmp_path / "layer03.raw")
    refused(tmp_path / "a.mhd", meta("9 9 4", "layer%02d.raw 1 4 1"), "layer03.raw", "is not there")
    refused(tmp_path / "b.mhd", meta(data="layer%d.raw 1 2000000000 1"), "is not there")
    refused(tmp_path / "c.mhd", meta(data="layer%999999999d.raw 1 9 1"), "is not there")


def test_names_of_voxel_files_in_messages_are_cut(tmp_path: Path) -> None:
    refused(tmp_path / "a.mhd", meta(data="x\x1b" + "y" * 9999), "is not there")
