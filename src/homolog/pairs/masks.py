"""Masks: how much each point of a shape counts in a match, and which points are left out of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain, islice
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float

from homolog.core.array_files import ArrayFileError, read_npy
from homolog.core.errors import ArgumentError, DataError
from homolog.core.files import expanded
from homolog.core.messages import shorten
from homolog.core.reasons import reason_with_remedy
from homolog.shapes.formats.parsing import UnreadableError
from homolog.shapes.formats.ply import read_ply_colours, read_ply_property
from homolog.shapes.formats.text_lines import number_rows, text_lines
from homolog.shapes.shape import Shape

MASK_SUFFIXES = (".npy", ".ply", ".txt", ".csv")
"""The suffixes of files that masks are read from."""
MASK_PROPERTIES = ("mask", "weight")
"""The properties of a PLY file's vertices that hold a mask."""

_TRUTH_VALUES = {"true": "1", "false": "0"}
# Channels that differ by more than a step of 8 bits are no grey.
_GREY = 1.5 / 255


@dataclass(frozen=True, eq=False, repr=False)
class Mask:
    """How much each point of a shape counts: 0 leaves it out of the match.

    Args:
        weights: truth values, or numbers from 0, one for each point of the shape as given (n,).
        name: what messages call it, such as its file.

    Raises:
        ArgumentError: if it is no list of such numbers, or leaves every point out.

    Examples:
        >>> from homolog.pairs import Mask
        >>> Mask([True, False, True]).weights.tolist()
        [1.0, 0.0, 1.0]
    """

    weights: Float[np.ndarray, " n"]
    name: str = "the mask"

    # Reports that are read are checked against the options, which may hold a mask.
    __pydantic_config__: ClassVar[dict[str, bool]] = {"arbitrary_types_allowed": True}

    def __post_init__(self) -> None:
        given: Any = self.weights
        try:
            values = np.array(given.detach().cpu() if hasattr(given, "detach") else given)
        except (TypeError, ValueError):
            values = np.empty(0, dtype=object)
        if values.dtype.kind not in "biuf" or values.ndim != 1:
            found = f"{shorten(values.dtype)} of shape {shorten(values.shape)}"
            raise ArgumentError(
                f"{self.name} is {found}, but must be truth values or numbers from 0, one for each point"
            )
        values = values.astype(float)
        wrong = values[~(np.isfinite(values) & (values >= 0))]
        if len(wrong):
            raise ArgumentError(
                f"{self.name} holds {wrong[0]:g}, but must hold finite numbers from 0; 0 leaves a point out"
            )
        if not values.any():
            raise ArgumentError(f"{self.name} leaves every point out; give the points to be matched a number above 0")
        values.flags.writeable = False
        object.__setattr__(self, "weights", values)

    def check_fits(self, shape: Shape) -> None:
        """Refuse a mask of another number of points.

        Raises:
            ArgumentError: naming both numbers.
        """
        if len(self.weights) != shape.n_points:
            raise ArgumentError(
                f"{self.name} has {len(self.weights)} numbers, but {shape.name} has {shape.n_points} points; "
                "give one for each point of the file, in its order"
            )

    @property
    def kept(self) -> Bool[np.ndarray, " n"]:
        """Which points take part."""
        return np.asarray(self.weights > 0)

    def applied_to(self, shape: Shape) -> Shape:
        """The shape without what is left out, its points in the same numbering: no face has them, or they are NaN.

        Raises:
            ArgumentError: if it has another number of points.
        """
        self.check_fits(shape)
        if shape.faces is not None:
            return replace(shape, faces=shape.faces[self.kept[shape.faces].all(axis=1)])
        return replace(shape, points=np.where(self.kept[:, None], shape.points, np.nan))

    @property
    def is_graded(self) -> bool:
        """Whether points that take part count differently."""
        taking_part = self.weights[self.kept]
        return bool(taking_part.min() < taking_part.max())

    def __repr__(self) -> str:
        return f"Mask({self.name!r}: {int(self.kept.sum())} of {len(self.weights)} points)"


def read_mask(path: str | Path) -> Mask:
    """Read a mask: one number, or truth value, for each point of a shape's file, in its order.

    - ``.npy``: an array (n,).
    - ``.txt``, ``.csv``: a number a line; a first line that is no number is taken for a heading.
    - ``.ply``: the property ``mask`` or ``weight`` of its vertices; without one, grey colours, of which black leaves a
      point out, and white counts fully.

    Raises:
        ArgumentError: if its numbers are no mask.
        DataError: if it is missing or damaged, or its suffix is none of these.

    Examples:
        >>> import numpy as np
        >>> from homolog.pairs import read_mask
        >>> np.save("mask.npy", np.array([True, True, False]))
        >>> read_mask("mask.npy")
        Mask('mask.npy': 2 of 3 points)
    """
    readers = {".npy": read_npy, ".ply": _read_ply, ".txt": _read_lines, ".csv": _read_lines}
    reader = readers.get(expanded(path).suffix.lower())
    if reader is None:
        raise DataError(
            f"{path} has the suffix {expanded(path).suffix!r}, but a mask must have one of {', '.join(MASK_SUFFIXES)}"
        )
    try:
        values = reader(expanded(path))
    except (OSError, UnicodeDecodeError, ArrayFileError, UnreadableError) as error:
        reason = reason_with_remedy(error, "write the mask again")
        raise DataError(f"{path} cannot be read as a mask: {reason}") from None
    return Mask(values, str(path))


def mask_of(given: Any, name: str) -> Any:
    """A mask from a file's name or an array; None and a mask as they are.

    Args:
        given: what a user gave.
        name: of the argument.
    """
    if given is None or isinstance(given, Mask):
        return given
    return read_mask(Path(given)) if isinstance(given, str | PathLike) else Mask(given, name)


def _read_lines(path: Path) -> np.ndarray:
    """A number, or truth value, a line; what follows a # is a comment."""
    lines = text_lines(path)
    first = list(islice(lines, 1))
    try:
        number_rows(_single(first), (0,))
    except UnreadableError:
        first = []  # a heading
    return number_rows(_single(chain(first, lines)), (0,))[:, 0]


def _single(lines: Iterable[str]) -> Iterator[str]:
    """Lines of one value each, truth values as numbers."""
    for line in lines:
        if (count := len(line.replace(",", " ").replace(";", " ").split())) > 1:
            raise UnreadableError(f"the line {shorten(line, 50)!r} has {count} values, but a mask has one a line")
        yield _TRUTH_VALUES.get(line.lower(), line)


def _read_ply(path: Path) -> np.ndarray:
    for name in MASK_PROPERTIES:
        values = read_ply_property(path, name)
        if values is not None:
            return values
    colours = read_ply_colours(path)
    wanted = f"give its vertices a property {' or '.join(MASK_PROPERTIES)}"
    if colours is None:
        raise UnreadableError(f"it has neither mask nor colours; {wanted}, or paint them black and white")
    if (np.ptp(colours, axis=1) > _GREY).any():
        raise UnreadableError(f"its colours are no greys, from black to leave a point out to white; {wanted}")
    return np.asarray(colours[:, 0])
