"""Reading segmentation masks: MetaImage, NIfTI and NRRD."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from homolog.core.errors import ShapeError, needs_extra
from homolog.core.files import expanded
from homolog.shapes import VOLUMES
from homolog.volumes.mask import Mask

# What reads a file with such a suffix.
_KINDS = {".mh": "MetaImageIO", ".nii": "NiftiImageIO", ".nrrd": "NrrdImageIO", ".nhdr": "NrrdImageIO"}

# A mask has few values. What has more is an image that a mask might be of.
_MOST_LABELS = 256
_LABELS_SHOWN = 12
# Bytes that are looked at at once.
_CHUNK = 2**22


def read_mask(path: str | Path, *, label: int | None = None) -> Mask:
    """Read a segmentation mask; the suffix says which format, whatever its case.

    Positions are in the frame of medical images, whichever way the voxels run: millimetres, x to the left, y to the
    back and z to the head of the patient.

    Args:
        path: a file with one of the suffixes in ``VOLUMES``; the voxels of ``.mhd`` and ``.nhdr`` lie in a file beside
            it.
        label: the value of the voxels that are meant; by default all that are not 0.

    Raises:
        ShapeError: if the file cannot be read, holds no volume or no mask, or no voxel has that label.
        MissingExtraError: if SimpleITK is not installed.
    """
    file = expanded(path)
    if not file.name.lower().endswith(VOLUMES):
        raise ShapeError(f"{path} is no volume; its suffix must be one of {', '.join(VOLUMES)}")
    if not file.is_file():
        raise ShapeError(f"{path}: there is no such file; give a segmentation mask")
    image = _read(file)
    values = _simple_itk().GetArrayViewFromImage(image).T
    inside = values != 0 if label is None else values == label
    if label is None:
        _check_values(path, values)
    elif not inside.any():
        raise ShapeError(f"{path}: no voxel has label {label}; those there are {_labels(values)}")
    steps = np.array(image.GetDirection()).reshape(3, 3) * np.array(image.GetSpacing())
    return Mask(inside, np.array(image.GetOrigin()), steps, name=file.name)


def _read(file: Path) -> Any:
    reader = _simple_itk().ImageFileReader()
    reader.SetFileName(str(file))
    kind = next(kind for suffix, kind in _KINDS.items() if suffix in file.name.lower())
    reader.SetImageIO(kind)
    try:
        voxels = _voxels_file(file) if kind == "MetaImageIO" else None
        reader.ReadImageInformation()
        size = tuple(length for length in reader.GetSize() if length != 1)
        if len(size) != 3 or len(reader.GetSize()) != 3 or reader.GetNumberOfComponents() != 1:
            found = " x ".join(map(str, reader.GetSize()))
            raise ShapeError(f"{file} holds {found} voxels of {reader.GetNumberOfComponents()} values; give one volume")
        if kind == "NiftiImageIO":
            bits, begin = int(reader.GetMetaData("bitpix")), int(float(reader.GetMetaData("vox_offset")))
            _check_length(file, reader, bits // 8, begin)
        elif voxels is not None:
            _check_length(voxels, reader, _simple_itk().Image(1, 1, reader.GetPixelID()).GetSizeOfPixelComponent(), 0)
        return reader.Execute()
    except (OSError, RuntimeError) as error:
        reason = str(error).strip().splitlines()[-1].strip()
        raise ShapeError(f"{file} cannot be read as a volume ({reason[:200]}); write it again") from None


def _voxels_file(file: Path) -> Path | None:
    """The file of a MetaImage's voxels, if it is another one, of which the length can be told.

    Of one that is missing or too short the library would print of its own, and name no file.
    """
    with file.open("rb") as header:
        lines = (line.partition(b"=") for line in header.read(_CHUNK).splitlines())
    told = {key.strip(): value.strip().decode(errors="replace") for key, _, value in lines}
    name = told.get(b"ElementDataFile", "LOCAL")
    if name.split(" ")[0] in ("LOCAL", "LIST") or "%" in name:
        return None
    if not (file.parent / name).is_file():
        raise ShapeError(f"{file}: its voxels are to be in {file.parent / name}, which is not there; put it there")
    return None if told.get(b"CompressedData", "").upper()[:1] in ("T", "1") else file.parent / name


def _check_length(file: Path, reader: Any, voxel_bytes: int, begin: int) -> None:
    """Of files that end early the library takes the rest for zeros (NIfTI), or prints of its own (MetaImage)."""
    needed = begin + voxel_bytes * int(np.prod(reader.GetSize(), dtype=np.int64))
    there = _length(file)
    if there < needed:
        raise ShapeError(f"{file} ends after {there} of {needed} bytes; copy or write it again")


def _length(file: Path) -> int:
    """In bytes, unpacked, as far as it can be."""
    if file.suffix.lower() != ".gz":
        return file.stat().st_size
    length = 0
    try:
        with gzip.open(file) as unpacked:
            while chunk := unpacked.read(_CHUNK):
                length += len(chunk)
    except (EOFError, OSError, zlib.error):
        pass
    return length


def _check_values(path: str | Path, values: np.ndarray) -> None:
    if not np.isfinite(values).all():
        raise ShapeError(f"{path} has voxels that are no numbers; write the mask again")
    if values.dtype.kind == "f" and not np.array_equal(values, values.round()):
        raise ShapeError(f"{path} has fractions for values and is no mask of labels; write it with whole numbers")
    if len(np.unique(values)) > _MOST_LABELS:
        raise ShapeError(f"{path} has more than {_MOST_LABELS} values and looks like an image; give a mask, or a label")


def _labels(values: np.ndarray) -> str:
    found = np.unique(values)
    shown = ", ".join(f"{value:g}" for value in found[:_LABELS_SHOWN])
    return f"{shown} and {len(found) - _LABELS_SHOWN} more" if len(found) > _LABELS_SHOWN else shown


def _simple_itk() -> Any:
    with needs_extra("reading volumes", "volumes"):
        import SimpleITK
    return SimpleITK
