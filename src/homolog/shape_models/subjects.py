"""The shapes of a collection and what they are called."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from homolog.core.errors import ArgumentError
from homolog.core.files import expanded


@dataclass(frozen=True)
class Subject:
    """A shape to match to the template.

    Args:
        name: what it is called in the collection, as its file without the suffix.
        file: where it is, or should be: one that is not there fails as any other bad shape does, and stops no other.
    """

    name: str
    file: Path


def subjects_of(files: Sequence[str | Path]) -> list[Subject]:
    """Name shapes by their files.

    Raises:
        ArgumentError: if there are none, or two would have one name.
    """
    if not files:
        raise ArgumentError("no shapes are given; give at least one file beside the template")
    subjects = [Subject(Path(file).stem, expanded(file)) for file in files]
    known: dict[str, Subject] = {}
    for subject in subjects:
        # Some file systems do not tell large letters from small ones.
        other = known.setdefault(subject.name.casefold(), subject)
        if other is not subject:
            raise ArgumentError(
                f"{other.file} and {subject.file} would both be called {subject.name!r}; rename one of them, "
                "or give each once"
            )
    return subjects
