"""SimpleITK in a process of its own, because on a damaged header it ends the whole process.

``homolog.core.reader_process`` calls ``read``. This imports nothing of Homolog that loads slowly.
"""

from __future__ import annotations

import gzip
import os
import re
import zlib
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any

import numpy as np
import SimpleITK

from homolog.core.memory import expansion_fault

# Not typed by SimpleITK.
_itk: Any = SimpleITK
# Images that arrays look into.
_KEPT = list[Any]()
# Bytes read at a time.
_CHUNK = 2**22


def read(path: str, kind: str, voxels_size: str) -> dict[str, np.ndarray]:
    """The values (k, j, i) of a volume, its origin, and the steps along i, j and k as columns.

    Args:
        path: the file.
        kind: the library's name of its format.
        voxels_size: the bytes of the files of its voxels, where these are others.

    Raises:
        ValueError: if the file holds no volume, or ends early; the library reads zeros then.
    """
    reader: Any = _itk.ImageFileReader()
    reader.SetFileName(path)
    reader.SetImageIO(kind)
    try:
        with TemporaryDirectory() as folder:
            image = _read(Path(path), reader, int(voxels_size), Path(folder))
    except RuntimeError as error:
        if "allocate" in str(error):
            raise MemoryError from None
        reason = _in_our_words(str(error).strip().splitlines()[-1], kind, has_header=len(reader.GetSize()) > 0)
        raise ValueError(f"it cannot be read as a volume ({reason}); write it again") from None
    steps = np.array(image.GetDirection()).reshape(3, 3) * np.array(image.GetSpacing())
    _KEPT.append(image)
    return {"values": _itk.GetArrayViewFromImage(image), "origin": np.array(image.GetOrigin()), "steps": steps}


# What the library says of a header, and the same in our words, with the entry that is at fault.
_SAID = (
    (r"_nrrdRead: ", "it has no header of NRRD"),
    (r"hit end of header", "its header ends early"),
    (r"_nrrdEncoding\w+_read|_nrrdDataFNCheck", "its voxels end early or are damaged"),
    (r"_nrrdSizeCheck", "its entry 'sizes' is not as NRRD allows"),
    (r"_nrrdSpaceVectorParse", "a vector of its header is not as NRRD allows"),
    (r"_nrrd(?:ReadNrrdParse|FieldCheck)_(?P<entry>\w+)", "its entry {entry!r} is not as NRRD allows"),
    (r"PixelType", "its voxels are of a type that is not known"),
    (r"recognized as a NIFTI", "it has no header of NIfTI"),
)


def _in_our_words(said: str, kind: str, *, has_header: bool) -> str:
    """Why a file cannot be read, by the last line of the library, where the system's error may be another one."""
    for pattern, words in _SAID:
        if found := re.search(pattern, said):
            return words.format(entry=found.groupdict().get("entry", "").replace("_", " "))
    name = kind.removesuffix("IO") if kind == "MetaImageIO" else kind.removesuffix("ImageIO").upper()
    return "its voxels end early or are damaged" if has_header else f"its header is not as {name} has it"


def _read(file: Path, reader: Any, voxels_size: int, folder: Path) -> Any:
    reader.ReadImageInformation()
    size, n_values = reader.GetSize(), reader.GetNumberOfComponents()
    if len(size) != 3 or 1 in size or n_values != 1:
        raise ValueError(f"it holds {' x '.join(map(str, size))} voxels of {n_values} values; give one volume")
    voxel_bytes = _itk.Image(1, 1, reader.GetPixelID()).GetSizeOfPixelComponent()
    needed = int(np.prod([int(length) for length in size], dtype=object)) * voxel_bytes
    if fault := expansion_fault(needed, file.stat().st_size + voxels_size):
        raise ValueError(fault)
    if reader.GetImageIO() == "NiftiImageIO":
        begin, length = int(float(reader.GetMetaData("vox_offset"))), file.stat().st_size
        if file.suffix.lower() == ".gz":
            unpacked = folder / "volume.nii"
            length = _unpack(file, unpacked, begin + needed)
            reader.SetFileName(str(unpacked))
        if length < begin + needed:
            raise ValueError(f"it ends after {length} of {begin + needed} bytes; copy or write it again")
    with TemporaryFile() as printed:
        os.dup2(printed.fileno(), 1)
        os.dup2(printed.fileno(), 2)
        image = reader.Execute()
        printed.seek(0)
        said = printed.read(_CHUNK).decode(errors="replace")
    # What it cannot unpack, the library of MetaImage leaves as it finds the memory, and only prints a line.
    if reader.GetImageIO() == "MetaImageIO" and re.search("fail|not read|error", said, re.IGNORECASE):
        raise ValueError("it ends early, or its voxels are damaged; copy or write it again")
    return image


def _unpack(file: Path, unpacked: Path, most: int) -> int:
    """Unpack hardly more than that many bytes of a gzip file, as far as it is intact; the number of bytes."""
    length = 0
    with suppress(EOFError, zlib.error, gzip.BadGzipFile), gzip.open(file) as content, unpacked.open("wb") as output:
        # One byte more is asked for, so that the checksum behind the last one is read as well.
        while length <= most and (chunk := content.read(min(_CHUNK, most + 1 - length))):
            length += output.write(chunk)
    return length
