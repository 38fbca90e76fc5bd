"""A collection on disk while it is made: one shape after another, and gone on with at any time."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from homolog.core.errors import DataError
from homolog.core.files import expanded, read_json, sha256, write_json
from homolog.core.folders import prepare_folder, remove_if_unused
from homolog.core.versions import versions
from homolog.shape_models.registering import Figures, Registered
from homolog.shape_models.subjects import Subject
from homolog.shapes import Shape, drawable, files_of_shape, read_shape, write_shape

# Changes whenever the same template, shapes and settings come to give other points.
_MAKING = 1
_FOLDERS = ("shapes", "records")


@dataclass(frozen=True)
class Outcome:
    """What became of a shape.

    Args:
        subject: the shape.
        figures: how good its match is; None if it could not be placed.
        warnings: what the user should know of the match, a line each.
        error: why it could not be placed, in a line; empty if it could.
        seconds: that it took.
    """

    subject: Subject
    figures: Figures | None
    warnings: tuple[str, ...] = ()
    error: str = ""
    seconds: float = 0.0


@dataclass(frozen=True)
class CollectionFolder:
    """Where the files of a collection are.

    ``shapes/NAME.ply`` is a shape with the template's points and faces; ``records/NAME.json`` says how it came about,
    from which file, and vouches for it.

    Args:
        root: the folder.
    """

    root: Path

    @classmethod
    def prepare(cls, root: str | Path, making: dict[str, Any]) -> CollectionFolder:
        """Make the folder, or go on with one that was begun in the same way.

        Args:
            root: the folder.
            making: all that the placed points depend on, besides the shapes, for JSON.

        Raises:
            ArgumentError: if it holds other things, or another collection, or cannot be written to.
        """
        folder = cls(expanded(root))
        # As JSON gives it back, so that what is there can be compared.
        whole = json.loads(json.dumps({"way": _MAKING, **making}))
        what = "shapes with the points and faces of one template, made by homolog collection"
        prepare_folder(
            folder.root, {"what": what, "making": whole, "versions": versions()}, _FOLDERS, what="a collection"
        )
        return folder

    @classmethod
    @contextmanager
    def opened(cls, root: str | Path, making: dict[str, Any]) -> Iterator[CollectionFolder]:
        """The same for a while: where it ends with an error before any shape was placed, no new folder is left.

        Args:
            root: the folder.
            making: as ``prepare`` takes it.

        Raises:
            ArgumentError: as ``prepare`` does.
        """
        with remove_if_unused(expanded(root), _FOLDERS):
            yield cls.prepare(root, making)

    def shape_file(self, name: str) -> Path:
        """A shape with the template's points."""
        return self.root / "shapes" / f"{name}.ply"

    def write(self, outcome: Outcome, placed: Registered, template: Shape, digest: str) -> None:
        """Write a shape with the template's points; its record comes last, and without it the shape does not count.

        Args:
            outcome: what became of it.
            placed: the template's points on it.
            template: whose faces are written.
            digest: hash of the shape's file.
        """
        file, subject = self.shape_file(outcome.subject.name), outcome.subject
        write_shape(file, Shape(placed.points, drawable(template).faces))
        record = {"file": str(subject.file), **_stamp(subject.file), "sha256": digest, "placed_sha256": sha256(file)}
        write_json(self._record_file(subject.name), {**record, "outcome": _told(outcome)})

    def forget(self, subject: Subject) -> None:
        """Take away what was made of an earlier file of a shape that cannot be placed any more."""
        self._record_file(subject.name).unlink(missing_ok=True)
        self.shape_file(subject.name).unlink(missing_ok=True)

    def outcome(self, subject: Subject) -> Outcome | None:
        """What became of a shape; None if it was not placed yet, or its file or what was made of it changed since.

        A file of the same size and time of change counts as the same; of another time, its hash tells.

        Raises:
            ShapeError: if its file cannot be used at all.
        """
        record = read_json(self._record_file(subject.name), needs="outcome")
        if record is None or not self._is_current(subject, record):
            return None
        told = record["outcome"]
        try:
            return Outcome(subject, Figures(**told["figures"]), tuple(told["warnings"]), seconds=told["seconds"])
        except (KeyError, TypeError):  # a record of another version, or damaged
            return None

    def points(self, names: Sequence[str]) -> Float[np.ndarray, "s n 3"]:
        """The template's points on shapes that were placed.

        Raises:
            DataError: if files were changed so that they do not fit each other.
            ShapeError: if one cannot be read.
        """
        shapes = [read_shape(self.shape_file(name)).points for name in names]
        for name, points in zip(names, shapes, strict=True):
            if len(points) != len(shapes[0]):
                raise DataError(f"{self.shape_file(name)} has {len(points)} points, not {len(shapes[0])}; remove it")
        return np.stack(shapes)

    def others(self, subjects: Sequence[Subject]) -> list[str]:
        """Names of shapes that were placed before and are not among these."""
        known = {subject.name for subject in subjects}
        # Records tell: without one, what a killed process left among the shapes does not count.
        recorded = {path.stem for path in (self.root / "records").glob("*.json")}
        return sorted(name for name in recorded - known if self.shape_file(name).is_file())

    def _is_current(self, subject: Subject, record: dict[str, Any]) -> bool:
        placed = self.shape_file(subject.name)
        if not placed.is_file() or sha256(placed) != record.get("placed_sha256"):
            return False
        unchanged = all(record.get(key) == value for key, value in _stamp(subject.file).items())
        return unchanged or sha256(*files_of_shape(subject.file)) == record["sha256"]

    def _record_file(self, name: str) -> Path:
        return self.root / "records" / f"{name}.json"


def _stamp(file: Path) -> dict[str, Any]:
    states = [path.stat() for path in files_of_shape(file)]
    return {"bytes": [state.st_size for state in states], "changed_ns": [state.st_mtime_ns for state in states]}


def _told(outcome: Outcome) -> dict[str, Any]:
    assert outcome.figures is not None
    figures, seconds = asdict(outcome.figures), round(outcome.seconds, 2)
    return {"figures": figures, "warnings": list(outcome.warnings), "seconds": seconds}
