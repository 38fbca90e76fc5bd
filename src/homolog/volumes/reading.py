"""Reading segmentation masks: MetaImage, NIfTI and NRRD."""

from __future__ import annotations

import gzip
import zlib
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from homolog.core.errors import ShapeError, needs_extra
from homolog.core.files import expanded
from homolog.shapes import VOLUMES
from homolog.volumes.mask import Mask

# The library's reader by suffix.
_KINDS = {".mh": "MetaImageIO", ".nii": "NiftiImageIO", ".nrrd": "NrrdImageIO", ".nhdr": "NrrdImageIO"}

# A volume with more values than this is an image and not a mask.
_MOST_LABELS = 256
_LABELS_SHOWN = 12
# Bytes read at a time.
_CHUNK = 2**22


def read_mask(path: str | Path, *, label: int | None = None) -> Mask:
    """Read a segmentation mask (MetaImage, NIfTI or NRRD); the suffix tells the format, in any case.

    Positions are in LPS coordinates, whatever the orientation of the voxels: millimetres, x to the patient's left, y to
    the back and z to the head.

    Args:
        path: a file with one of the suffixes in ``VOLUMES``; ``.mhd`` and ``.nhdr`` have their voxels in another file.
        label: the value of the object's voxels; by default all values but 0.

    Raises:
        ShapeError: if the file cannot be read, holds no volume or no mask, or no voxel has that label.
        MissingExtraError: if SimpleITK is not installed.

    Examples:
        >>> mask = read_mask("lungs.mhd", label=3)  # doctest: +SKIP
        >>> surface = mask_surface(mask, points=5000)  # doctest: +SKIP
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
        n_voxels = int(np.prod(reader.GetSize(), dtype=np.int64))
        if kind == "NiftiImageIO":
            bits, begin = int(reader.GetMetaData("bitpix")), int(float(reader.GetMetaData("vox_offset")))
            return _read_nifti(file, reader, begin + bits // 8 * n_voxels)
        if voxels is not None:
            voxel_bytes = _simple_itk().Image(1, 1, reader.GetPixelID()).GetSizeOfPixelComponent()
            _check_length(voxels, voxels.stat().st_size, voxel_bytes * n_voxels)
        return reader.Execute()
    except (OSError, RuntimeError) as error:
        reason = str(error).strip().splitlines()[-1].strip()
        raise ShapeError(f"{file} cannot be read as a volume ({reason[:200]}); write it again") from None


def _read_nifti(file: Path, reader: Any, needed: int) -> Any:
    """Read a NIfTI file whose header promises a length; compressed files are unpacked once, to that length."""
    if file.suffix.lower() != ".gz":
        _check_length(file, file.stat().st_size, needed)
        return reader.Execute()
    with TemporaryDirectory() as folder:
        unpacked = Path(folder) / "volume.nii"
        _check_length(file, _unpack(file, unpacked, needed), needed)
        reader.SetFileName(str(unpacked))
        return reader.Execute()


def _unpack(file: Path, unpacked: Path, most: int) -> int:
    """Unpack hardly more than that many bytes of a gzip file, as far as it is intact; the number of bytes."""
    length = 0
    with suppress(EOFError, zlib.error, gzip.BadGzipFile), gzip.open(file) as content, unpacked.open("wb") as output:
        # One byte more is asked for, so that the checksum behind the last one is read as well.
        while length <= most and (chunk := content.read(min(_CHUNK, most + 1 - length))):
            length += output.write(chunk)
    return length


def _voxels_file(file: Path) -> Path | None:
    """The file of a MetaImage's voxels, if it is a separate one whose length is known.

    If it is missing or too short, the library would print a message of its own that names no file.
    """
    with file.open("rb") as header:
        lines = (line.partition(b"=") for line in header.read(_CHUNK).splitlines())
    entries = {key.strip(): value.strip().decode(errors="replace") for key, _, value in lines}
    name = entries.get(b"ElementDataFile", "LOCAL")
    if name.split(" ")[0] in ("LOCAL", "LIST") or "%" in name:
        return None
    if not (file.parent / name).is_file():
        raise ShapeError(f"{file}: its voxels are to be in {file.parent / name}, which is not there; put it there")
    return None if entries.get(b"CompressedData", "").upper()[:1] in ("T", "1") else file.parent / name


def _check_length(file: Path, length: int, needed: int) -> None:
    """Refuse files that end early: the library reads zeros (NIfTI), or prints a message of its own (MetaImage)."""
    if length < needed:
        raise ShapeError(f"{file} ends after {length} of {needed} bytes; copy or write it again")


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
