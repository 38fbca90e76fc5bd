"""The folder of a shape model: registered shapes with their records, so that the work can be resumed at any time."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from typing_extensions import NotRequired, TypedDict

from homolog.core.errors import DataError, bad_choice
from homolog.core.files import expanded, sha256, write_json
from homolog.core.folders import MANIFEST, prepare_folder, remove_if_unused
from homolog.core.records import record, stored_record
from homolog.core.versions import versions
from homolog.matching import RESULT_FILES, Match, write_folder
from homolog.pairs import Candidate
from homolog.shape_models.kept_choice import keep_choice, kept_choice
from homolog.shape_models.registration import Figures, Registered
from homolog.shape_models.subjects import Subject
from homolog.shapes import Shape, drawable, files_of_shape, read_shape, write_shape

# A version, increased whenever the same template, shapes and settings give other points.
_MAKING = 2
_WEIGHTS = "weights.safetensors"
_WHAT = "shapes with the points and faces of one template, made by homolog collection"
_FOLDERS = ("shapes", "records", "matches")
MASK = "mask"
"""The property of PLY files that says how much each template point counts, where the template has a mask."""


class _Outcome(TypedDict):
    figures: Figures
    warnings: list[str]
    seconds: float
    matched_by: str


@record
class _Manifest(TypedDict):
    """What is read of a collection's manifest."""

    what: str
    weights_sha256: NotRequired[str]


@record
class _Record(TypedDict):
    """Of a registered shape."""

    sha256: str
    registered_sha256: str
    outcome: _Outcome


@dataclass(frozen=True)
class Outcome:
    """The result for one shape.

    Args:
        subject: the shape.
        figures: quality of its match; None if it was not registered.
        warnings: for the user, a line each.
        error: why it was not registered, in one line; empty if it was.
        seconds: wall time.
        matched_by: what found its point maps: a method, and the features that it compares.
    """

    subject: Subject
    figures: Figures | None
    warnings: tuple[str, ...] = ()
    error: str = ""
    seconds: float = 0.0
    matched_by: str = ""


@dataclass(frozen=True)
class ShapeModelFolder:
    """The files of a shape model.

    ``shapes/NAME.ply`` is a shape with the template's points and faces, and ``matches/NAME`` the match that led to it;
    ``records/NAME.json`` says from which file it was made, with hashes of both files.

    Args:
        root: the folder.
    """

    root: Path

    @classmethod
    def prepare(cls, root: str | Path, making: dict[str, Any]) -> ShapeModelFolder:
        """Create the folder, or resume one that was begun with the same settings.

        Args:
            root: the folder.
            making: all that registered points depend on besides the shapes, for JSON; see ``settings_record``.

        Raises:
            ArgumentError: if it holds other files, or was begun with other settings, or cannot be written to.
        """
        folder = cls(expanded(root))
        # With JSON's types, so that it can be compared with the file.
        made = json.loads(json.dumps({"way": _MAKING, **making}))
        manifest = {"what": _WHAT, "making": made, "versions": versions()}
        prepare_folder(folder.root, manifest, _FOLDERS, what="a collection")
        return folder

    @classmethod
    def existing(cls, root: str | Path) -> ShapeModelFolder:
        """A folder that ``homolog collection`` wrote, to be looked at.

        Raises:
            DataError: if it is none.
        """
        if not cls.is_one(root):
            raise DataError(f"{root} is no collection; give a folder that homolog collection wrote")
        return cls(expanded(root))

    @staticmethod
    def is_one(root: str | Path) -> bool:
        """Whether a folder is one that ``homolog collection`` wrote."""
        stored = stored_record(expanded(root) / MANIFEST, _Manifest)
        return stored is not None and stored["what"] == _WHAT

    @property
    def names(self) -> list[str]:
        """The names of all shapes that are registered, in the order of the alphabet."""
        # By records: a shape without one was left by a killed process, and does not count.
        recorded = (path.stem for path in (self.root / "records").glob("*.json"))
        return sorted(name for name in recorded if self.shape_file(name).is_file())

    @classmethod
    @contextmanager
    def opened(cls, root: str | Path, making: dict[str, Any]) -> Iterator[ShapeModelFolder]:
        """``prepare`` as a context: a new folder is removed if an error occurs before any shape is registered.

        Args:
            root: the folder.
            making: as for ``prepare``.

        Raises:
            ArgumentError: as ``prepare`` does.
        """
        with remove_if_unused(expanded(root), _FOLDERS):
            yield cls.prepare(root, making)

    def choice(self) -> tuple[Candidate, ...] | None:
        """The choice of features that was made for all shapes, empty where there was none; None where it is to come."""
        return kept_choice(self.root / MANIFEST)

    def keep_choice(self, choice: Sequence[Candidate]) -> None:
        """Keep the choice that was made for all shapes, so that those that come later are matched alike."""
        keep_choice(self.root / MANIFEST, choice)

    def weights(self) -> Path | None:
        """The weights that were adapted to all shapes; None where there are none yet, or they are damaged."""
        stored, file = stored_record(self.root / MANIFEST, _Manifest), self.root / _WEIGHTS
        known = stored is not None and file.is_file() and sha256(file) == stored.get("weights_sha256")
        return file if known else None

    def keep_weights(self, write: Callable[[Path], None]) -> Path:
        """Keep weights that were adapted to all shapes, so that those that come later are matched alike."""
        file, manifest = self.root / _WEIGHTS, stored_record(self.root / MANIFEST, _Manifest)
        assert manifest is not None
        write(file)
        write_json(self.root / MANIFEST, {**manifest, "weights_sha256": sha256(file)})
        return file

    def match_folder(self, name: str) -> Path:
        """The folder of the match of the template with a shape, as ``homolog match`` writes it."""
        return self.root / "matches" / name

    def match(self, name: str) -> Match:
        """The match of the template with a shape that is registered.

        Raises:
            ArgumentError: if there is no such shape.
            DataError: if its match is missing or damaged.
        """
        if name not in self.names:
            raise bad_choice("shape", name, self.names)
        return Match.load(self.match_folder(name))

    def shape_file(self, name: str) -> Path:
        """The file of a registered shape."""
        return self.root / "shapes" / f"{name}.ply"

    def write(
        self,
        outcome: Outcome,
        registered: Registered,
        template: Shape,
        digest: str,
        weights: Float[np.ndarray, " n"] | None = None,
    ) -> None:
        """Write a registered shape; its record comes last, and without it the shape does not count.

        Args:
            outcome: with figures.
            registered: the template's points on the shape.
            template: whose faces are written.
            digest: hash of the shape's file.
            weights: how much the template's points count, where it has a mask; 0 marks those that follow the others.
        """
        subject, figures = outcome.subject, outcome.figures
        assert figures is not None
        file = self.shape_file(subject.name)
        if registered.match is not None:
            write_folder(self.match_folder(subject.name), registered.match)
        numbers = {} if weights is None else {MASK: weights}
        write_shape(file, Shape(registered.points, drawable(template).faces), numbers=numbers)
        made = {
            "file": str(subject.file),
            **_stamp(subject.file),
            "sha256": digest,
            "mask_sha256": _mask_hash(subject),
            "registered_sha256": sha256(file),
            "outcome": {
                "figures": asdict(figures),
                "warnings": list(outcome.warnings),
                "seconds": round(outcome.seconds, 2),
                "matched_by": outcome.matched_by,
            },
        }
        write_json(self._record_file(subject.name), made)

    def forget(self, subject: Subject) -> None:
        """Delete what was made of an earlier version of a shape's file."""
        self._record_file(subject.name).unlink(missing_ok=True)
        self.shape_file(subject.name).unlink(missing_ok=True)
        for name in RESULT_FILES:
            (self.match_folder(subject.name) / name).unlink(missing_ok=True)
        with suppress(OSError):  # it does not exist, or somebody else's file is in it
            self.match_folder(subject.name).rmdir()

    def outcome(self, subject: Subject) -> Outcome | None:
        """The stored result for a shape; None if there is none, or its file or the registered shape has changed.

        A file with the same size and modification time counts as unchanged; otherwise its hash decides.

        Raises:
            ShapeError: if the shape's file cannot be used at all.
        """
        stored = stored_record(self._record_file(subject.name), _Record)
        if stored is None or not self._is_current(subject, stored):  # it may be of another version, or damaged
            return None
        told = stored["outcome"]
        known = {field.name: told["figures"][field.name] for field in fields(Figures) if field.name in told["figures"]}
        return Outcome(subject, Figures(**known), tuple(told["warnings"]), "", told["seconds"], told["matched_by"])

    def points(self, names: Sequence[str], count: int) -> Float[np.ndarray, "s n 3"]:
        """The template's points on registered shapes, at least one, all in memory; see ``each_points``."""
        return np.stack(list(self.each_points(names, count)))

    def each_points(self, names: Sequence[str], count: int) -> Iterator[Float[np.ndarray, "n 3"]]:
        """The template's points on one registered shape after the other.

        Args:
            names: of the shapes.
            count: the template's number of points.

        Raises:
            DataError: if a file has another number of points.
            ShapeError: if a file cannot be read.
        """
        for name in names:
            points = read_shape(self.shape_file(name)).points
            if len(points) != count:
                file = self.shape_file(name)
                raise DataError(f"{file} has {len(points)} points, but the template has {count}; remove it")
            yield points

    def others(self, subjects: Sequence[Subject]) -> list[str]:
        """Names of shapes that were registered before and are not among these."""
        known = {subject.name for subject in subjects}
        return [name for name in self.names if name not in known]

    def _is_current(self, subject: Subject, stored: dict[str, Any]) -> bool:
        registered = self.shape_file(subject.name)
        if not registered.is_file() or sha256(registered) != stored["registered_sha256"]:
            return False
        if stored.get("mask_sha256", "") != _mask_hash(subject):
            return False
        unchanged = all(stored.get(key) == value for key, value in _stamp(subject.file).items())
        return unchanged or sha256(*files_of_shape(subject.file)) == stored["sha256"]

    def _record_file(self, name: str) -> Path:
        return self.root / "records" / f"{name}.json"


def _mask_hash(subject: Subject) -> str:
    """Of the file of a shape's mask; empty where it has none, or none that can be read."""
    with suppress(OSError):
        return "" if subject.mask_file is None else sha256(subject.mask_file)
    return ""


def _stamp(file: Path) -> dict[str, Any]:
    """Sizes and modification times of a shape's files."""
    states = [path.stat() for path in files_of_shape(file)]
    return {"bytes": [state.st_size for state in states], "changed_ns": [state.st_mtime_ns for state in states]}
