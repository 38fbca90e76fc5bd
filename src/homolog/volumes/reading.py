"""Reading segmentation masks: MetaImage, NIfTI and NRRD."""

from __future__ import annotations

import re
from importlib.util import find_spec
from math import prod
from pathlib import Path

import numpy as np

from homolog.core.errors import MissingExtraError, ShapeError
from homolog.core.files import expanded, is_there, opened
from homolog.core.messages import shorten
from homolog.core.reader_process import ReaderProcessError, read_in_process
from homolog.shapes import VOLUMES
from homolog.volumes.mask import Mask

# The library's reader by suffix.
_KINDS = {".mh": "MetaImageIO", ".nii": "NiftiImageIO", ".nrrd": "NrrdImageIO", ".nhdr": "NrrdImageIO"}

# A volume with more values than this is an image and not a mask.
_MOST_LABELS = 256
_LABELS_SHOWN = 12
_PROCESS = Path(__file__).with_name("itk_process.py")
# Names of files with a number in them, and the first number, the last and the step.
_PATTERN = re.compile(r"([^%]*%0?\d?\d?d[^%\s]*)\s+(\d{1,6})\s+(\d{1,6})\s+(\d{1,6})(?:\s+\d)?")
# No name of a file is longer, and no header.
_LONGEST_NAME = 4096
_CHUNK = 2**22
# What separates names from values in headers, the names of the entry that tells where the voxels are, and the bytes of
# a voxel by its type.
_SIGNS = {".mhd": "=", ".mha": "=", ".nrrd": ":", ".nhdr": ":"}
_VOXELS = ("elementdatafile", "data file", "datafile")
_VOXEL_BYTES = {"MET_CHAR": 1, "MET_UCHAR": 1, "MET_SHORT": 2, "MET_USHORT": 2, "MET_INT": 4, "MET_UINT": 4}
_VOXEL_BYTES |= {
    "MET_LONG": 4,
    "MET_ULONG": 4,
    "MET_LONG_LONG": 8,
    "MET_ULONG_LONG": 8,
    "MET_FLOAT": 4,
    "MET_DOUBLE": 8,
}


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
    found = _read(file)
    values = found["values"].T
    if label is None:
        _check_values(path, values)
        inside = values != 0
    else:
        inside = values == label
        if not inside.any():
            labels = np.unique(values)
            shown = ", ".join(f"{value:g}" for value in labels[:_LABELS_SHOWN])
            more = f" and {len(labels) - _LABELS_SHOWN} more" if len(labels) > _LABELS_SHOWN else ""
            raise ShapeError(f"{path}: no voxel has label {label}; those there are {shown}{more}")
    del values, found["values"]
    return Mask(inside, found["origin"], found["steps"], name=file.name)


def _read(file: Path) -> dict[str, np.ndarray]:
    """What ``itk_process`` reads, once the files of the voxels are known to be there."""
    if find_spec("SimpleITK") is None:
        raise MissingExtraError("reading volumes", "SimpleITK", "volumes")
    kind = next(kind for suffix, kind in _KINDS.items() if suffix in file.name.lower())
    try:
        head = _head(file)
        _check_dimension(file, head)
        voxels = _voxel_files(file, head)
        for one in voxels:
            if not (is_there(one) and one.is_file()):
                raise ShapeError(
                    f"{file}: its voxels are to be in the file {shorten(one, 200)}, which is not there; put it there"
                )
        if len(voxels) == 1 and head.get("compresseddata", "f").lower()[0] not in "t1":
            _check_length(voxels[0], head)
        size = sum(one.stat().st_size for one in voxels)
        return read_in_process(_PROCESS, file, kind, str(size), library="SimpleITK")
    except OSError as error:
        raise ShapeError(f"{file} cannot be read as a volume ({error.strerror}); write it again") from None
    except ReaderProcessError as error:
        said = shorten(error, 200)
        told = f"{file} {said.removeprefix('it ')}" if said.startswith("it ") else f"{file}: {said}"
        raise ShapeError(told if "; " in said else f"{told}; write it again") from None


def _head(file: Path) -> dict[str, str]:
    """The entries of a MetaImage's or NRRD's header by their names in lower case; what follows a list is part of it."""
    if not file.name.lower().endswith((".mhd", ".mha", ".nrrd", ".nhdr")):
        return {}
    with opened(file) as stream:
        lines = stream.read(_CHUNK).decode("latin-1").splitlines()
    entries = dict[str, str]()
    for number, line in enumerate(lines):
        name, sign, value = (part.strip() for part in line.partition(_SIGNS[file.suffix.lower()]))
        if not line.strip():
            break
        entries[name.lower()] = value
        if sign and name.lower() in _VOXELS:
            if value.split()[:1] == ["LIST"]:
                entries[name.lower()] = "\n".join(["LIST", *lines[number + 1 :]])
            if file.suffix.lower()[:3] == ".mh":
                break  # the voxels follow
    return entries


def _voxel_files(file: Path, head: dict[str, str]) -> list[Path]:
    """The other files that a header takes its voxels from."""
    given = next((head[name] for name in _VOXELS if name in head), "LOCAL")
    first, *listed = given.splitlines() or [""]
    pattern = _PATTERN.fullmatch(first[:_LONGEST_NAME])
    if pattern is not None:
        numbers = range(int(pattern[2]), int(pattern[3]) + 1, int(pattern[4]) or 1)
        names = [pattern[1] % number for number in numbers]
    elif first.split()[:1] == ["LIST"]:
        names = [line.strip() for line in listed if line.strip()]
    else:
        names = [] if first.upper() in ("LOCAL", "") else [first]
    return [file.parent / name for name in names]


def _check_dimension(file: Path, head: dict[str, str]) -> None:
    """Refuse numbers of dimensions that no volume has, some of which end the library's process."""
    given = head.get("ndims", head.get("dimension", "3"))
    # In NRRD the values of a voxel may be a dimension as well.
    if given not in ("3", "4"):
        raise ShapeError(
            f"{file}: its header says {shorten(given, 40)} dimensions, but a volume has 3; give one volume"
        )


def _check_length(voxels: Path, head: dict[str, str]) -> None:
    """Refuse a MetaImage's file of voxels that ends early, of which the library gives a reason that names no file."""
    sizes, kind = head.get("dimsize", "").split(), head.get("elementtype", "")
    if kind in _VOXEL_BYTES and all(size.isdecimal() and len(size) < 10 for size in sizes):
        needed, length = prod(map(int, sizes)) * _VOXEL_BYTES[kind], voxels.stat().st_size
        if length < needed:
            raise ShapeError(f"{voxels} ends after {length} of {needed} bytes; copy or write it again")


def _check_values(path: str | Path, values: np.ndarray) -> None:
    labels = np.zeros(0, dtype=values.dtype)
    for layer in values.T:  # one by one, as each check takes memory of its own
        if not np.isfinite(layer).all():
            raise ShapeError(f"{path} has voxels that are no numbers; write the mask again")
        if values.dtype.kind == "f" and not np.array_equal(layer, layer.round()):
            raise ShapeError(f"{path} has fractions for values and is no mask of labels; write it with whole numbers")
        labels = np.union1d(labels, layer)
        if len(labels) > _MOST_LABELS:
            break
    if len(labels) > _MOST_LABELS:
        raise ShapeError(f"{path} has more than {_MOST_LABELS} values and looks like an image; give a mask, or a label")
