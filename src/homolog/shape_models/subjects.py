"""The shapes of a shape model and their names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from homolog.core.errors import ArgumentError
from homolog.core.files import expanded, read_text
from homolog.pairs import MASK_SUFFIXES, Mask, read_mask
from homolog.shapes import Shape, read_shape


@dataclass(frozen=True)
class Subject:
    """A shape that the template is registered to.

    Args:
        name: its file's name without the suffix.
        file: its path; a missing file fails as any other bad shape does, and does not stop the others.
        mask_file: that says how much its points count; None where all count alike.
    """

    name: str
    file: Path
    mask_file: Path | None = None

    def mask(self) -> Mask | None:
        """How much its points count; None where all count alike.

        Raises:
            ArgumentError: if the numbers are no mask.
            DataError: if the file cannot be read.
        """
        return None if self.mask_file is None else read_mask(self.mask_file)

    def surface(self) -> Shape:
        """The shape, without what its mask leaves out, in the file's numbering.

        Raises:
            ArgumentError: if the mask is none of this shape.
            DataError: if the mask cannot be read.
            ShapeError: if the shape cannot be read.
        """
        shape, mask = read_shape(self.file), self.mask()
        return shape if mask is None else mask.applied_to(shape)


def listed_files(path: str | Path | None) -> list[Path]:
    """The files that a text file lists, one a line, as seen from its own folder; none without a file.

    Raises:
        ArgumentError: if it cannot be read, or lists nothing.
    """
    if path is None:
        return []
    file = expanded(path)
    try:
        lines = [line.strip() for line in read_text(file, errors="surrogateescape").split("\n")]
    except OSError as error:
        raise ArgumentError(f"{path} cannot be read: {error.strerror or error}") from None
    found = [file.parent / line for line in lines if line]
    if not found:
        raise ArgumentError(f"{path} lists no shapes; write the path of one on each line")
    return found


def subjects_of(files: Sequence[str | Path], masks: str | Path | None = None) -> list[Subject]:
    """Name shapes by their files.

    Args:
        files: of the shapes.
        masks: a folder with masks of some of them, files of the same names with a suffix of masks.

    Raises:
        ArgumentError: if there are none, two would have the same name, one has two masks, or none has any.

    Examples:
        >>> [subject.name for subject in subjects_of(["scans/anna.ply", "scans/ben.ply"])]
        ['anna', 'ben']
    """
    if not files:
        raise ArgumentError("no shapes are given; give at least one file beside the template, or --list FILE")
    subjects = [Subject(expanded(file).stem, expanded(file)) for file in files]
    known: dict[str, Subject] = {}
    for subject in subjects:
        # Some file systems do not distinguish upper from lower case.
        other = known.setdefault(subject.name.casefold(), subject)
        if other is not subject:
            raise ArgumentError(
                f"{other.file} and {subject.file} would both be called {subject.name!r}; rename one of them, "
                "or give each once"
            )
    return subjects if masks is None else _with_masks(subjects, masks)


def _with_masks(subjects: Sequence[Subject], folder: str | Path) -> list[Subject]:
    root = expanded(folder)
    if not root.is_dir():
        raise ArgumentError(f"{folder} is no folder; give one with a mask for each shape that needs one")
    masked: list[Subject] = []
    for subject in subjects:
        found = [file for suffix in MASK_SUFFIXES if (file := root / f"{subject.name}{suffix}").is_file()]
        if len(found) > 1:
            raise ArgumentError(f"{found[0]} and {found[1]} are both masks of {subject.name!r}; remove one of them")
        masked.append(replace(subject, mask_file=next(iter(found), None)))
    if all(subject.mask_file is None for subject in masked):
        raise ArgumentError(
            f"{folder} has no mask of any of the shapes; name each as its shape, such as {subjects[0].name}.npy"
        )
    return masked
