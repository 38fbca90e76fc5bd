"""What a transfer reads beside the match: the original file of the source, and arrays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Int, Num

from homolog.core.array_files import ArrayFileError, read_npy
from homolog.core.errors import DataError
from homolog.core.files import expanded, is_there, sha256
from homolog.core.messages import shorten
from homolog.core.reasons import reason_with_remedy
from homolog.matching import Match
from homolog.pairs import Side
from homolog.shapes import Shape, files_of_shape, read_shape
from homolog.transfer.appearance import Appearance, files_of_look, read_appearance
from homolog.transfer.blend_shapes import BlendShapes, read_blend_shapes
from homolog.transfer.skin import Skin, read_skin


@dataclass(frozen=True, eq=False)
class Original:
    """A file that was matched, which may hold more than points and faces.

    Args:
        path: where it is.
        shape: what ``read_shape`` reads from it.
    """

    path: Path
    shape: Shape

    @cached_property
    def appearance(self) -> Appearance:
        """Its texture and colours; see ``read_appearance``."""
        return read_appearance(self.path, self.shape)

    @cached_property
    def skin(self) -> Skin | None:
        """Its skeleton and weights; see ``read_skin``."""
        return read_skin(self.path, self.shape)

    @cached_property
    def blend_shapes(self) -> BlendShapes | None:
        """Its morph targets; see ``read_blend_shapes``."""
        return read_blend_shapes(self.path, self.shape)

    @property
    def files(self) -> tuple[Path, ...]:
        """All the files that its shape and its look are read from."""
        return (*files_of_shape(self.path), *files_of_look(self.path))


def read_original(result: Match, side: Side, path: Path | None = None) -> Original:
    """Read one of the files that a match was made of.

    Args:
        result: the match.
        side: which of its two files.
        path: where it is now, if it was moved since.

    Raises:
        DataError: if it is not there, or is not what it was.
        ShapeError: if it cannot be read.
    """
    recorded = result.report.get("inputs", {}).get(side, {})
    if path is None and "file" not in recorded:
        raise DataError(f"the report of this match does not name its {side}; give the file with --from")
    file = expanded(recorded["file"] if path is None else path)
    if not (is_there(file) and file.is_file()):
        raise DataError(f"{file}, the {side} of this match, is not there; say with --from FILE where it is now")
    shape = read_shape(file)
    digest, drawn = sha256(*files_of_shape(file)), getattr(result, side)
    finite = np.isfinite(shape.points).all(axis=1)  # points that are no numbers are replaced in a result
    same = shape.n_points == drawn.n_points and np.array_equal(shape.points[finite], drawn.points[finite])
    if recorded.get("sha256", digest) != digest or not same:
        raise DataError(f"{file} is not the file that was matched, or was changed since; match it again")
    return Original(file, shape)


def read_array(path: Path, shape: Shape) -> Num[np.ndarray, "n ..."]:
    """Read an NPY file with one row of real numbers per point of a shape.

    Raises:
        DataError: if it is missing, damaged, holds something else, or has another number of rows.
    """
    try:
        array = read_npy(expanded(path))
    except (OSError, ArrayFileError) as error:
        reason = reason_with_remedy(error, "write it anew with numpy.save, from an array of numbers")
        raise DataError(f"{path} cannot be read as an NPY array: {reason}") from None
    if array.dtype.kind not in "biuf":
        raise DataError(f"{path} holds {shorten(array.dtype)}, but must be one array of numbers")
    if array.ndim < 1 or len(array) != shape.n_points:
        raise DataError(
            f"{path} has shape {shorten(array.shape)}, but must have one row for each of the {shape.n_points} points "
            f"of {shape.name}"
        )
    return array


def read_labels(path: Path, shape: Shape) -> Int[np.ndarray, " n"]:
    """Read an NPY file with one whole number per point of a shape, as ``read_array`` does.

    Raises:
        DataError: as ``read_array`` does, or if its numbers are not whole, or too large.
    """
    array = read_array(path, shape)
    if array.ndim > 1:
        raise DataError(f"{path} has shape {shorten(array.shape)}, but labels must have shape ({shape.n_points},)")
    with np.errstate(invalid="ignore"):
        labels = array.astype(np.int64)
    if not np.array_equal(labels, array):
        raise DataError(f"{path} holds numbers that are not whole, but labels must be; transfer them with --array")
    return labels
