"""The shapes of a shape model and their names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from homolog.core.errors import ArgumentError
from homolog.core.files import expanded, read_text


@dataclass(frozen=True)
class Subject:
    """A shape that the template is registered to.

    Args:
        name: its file's name without the suffix.
        file: its path; a missing file fails as any other bad shape does, and does not stop the others.
    """

    name: str
    file: Path


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


def subjects_of(files: Sequence[str | Path]) -> list[Subject]:
    """Name shapes by their files.

    Raises:
        ArgumentError: if there are none, or two would have the same name.

    Examples:
        >>> [subject.name for subject in subjects_of(["scans/anna.ply", "scans/ben.ply"])]
        ['anna', 'ben']
    """
    if not files:
        raise ArgumentError("no shapes are given; give at least one file beside the template")
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
    return subjects
