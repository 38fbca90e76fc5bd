"""Checking a dataset against its description: files, counts, sizes, splits, pairs and ground truth."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import get_args

from homolog.core.choices import Split
from homolog.core.errors import DataError, HomologError
from homolog.core.files import expanded, read_text, sha256
from homolog.core.progress import Progress, ignore
from homolog.datasets.description import DatasetDescription
from homolog.datasets.folder import Pair, ShapeFolder, class_of, names_at, partner, path_of
from homolog.shapes import Shape


@dataclass
class DatasetReport:
    """The result of checking a dataset.

    Args:
        root: the folder.
        findings: what is wrong, each a line that says what to do.
        n_shapes: number of shapes, partial shapes or volumes.
        n_full: number of full shapes, where these are separate files.
        n_points: least and largest number of points of a shape.
        n_truth: least and largest number of points with ground truth, of a shape or pair.
        splits: number of shapes of each split that has any.
        pairs: number of pairs of each.
        sha256: hash of the output of ``sha256sum`` for all files of shapes and truth, sorted by path.
    """

    root: Path
    findings: list[str] = field(default_factory=list)
    n_shapes: int = 0
    n_full: int = 0
    n_points: tuple[int, int] | None = None
    n_truth: tuple[int, int] | None = None
    splits: dict[str, int] = field(default_factory=dict)
    pairs: dict[str, int] = field(default_factory=dict)
    sha256: str = ""


def check_dataset(
    root: str | Path, description: DatasetDescription, *, progress: Progress | None = None
) -> DatasetReport:
    """Read every file of a dataset and compare it with its description.

    Args:
        root: the folder.
        description: of the dataset.
        progress: called with the number of files that were read, their total and the current file.

    Examples:
        >>> check_dataset("FAUST_r", read_description("faust_r")).findings  # doctest: +SKIP
        []
    """
    check = _Check(expanded(root), description, progress or ignore)
    check.run()
    return check.report


class _Check:
    def __init__(self, root: Path, description: DatasetDescription, progress: Progress) -> None:
        self.root, self.description, self.progress = root, description, progress
        self.report = DatasetReport(root)

    def run(self) -> None:
        if not self.root.is_dir():
            origin = self.description.source or "its owner"
            self._say(f"there is no folder {self.root}; put the dataset there; get it from {origin}")
            return
        self._names()
        self._lists()
        if self.description.holds == "volumes":
            self._volumes()
        elif self.report.n_shapes and bool(self.description.full) == bool(self.report.n_full):
            with self._errors_as_findings():
                self._shapes(ShapeFolder.without_truth(self.root, self.description))
        self._checksum()

    def _say(self, finding: str) -> None:
        if finding not in self.report.findings:
            self.report.findings.append(finding)

    def _say_missing(self, file: Path) -> None:
        self._say(f"put {file.name} at {file}")

    @contextmanager
    def _errors_as_findings(self, *, unless: bool = False) -> Iterator[None]:
        """Turn an error of this block into a finding; ``unless`` the description does not promise what it is about."""
        try:
            yield
        except HomologError as error:
            if not unless:
                self._say(str(error))

    # ---- existing files

    def _names(self) -> None:
        described = self.description
        names, full = names_at(self.root, described.shapes), names_at(self.root, described.full)
        self.report.n_shapes, self.report.n_full = len(names), len(full)
        self._expect(names, described.expected_names, described.shapes, described.n_shapes)
        if described.full:
            self._expect(full, described.expected_full_names, described.full, 0)

    def _expect(self, names: Sequence[str], expected: Sequence[str], pattern: str, count: int) -> None:
        """Report missing and superfluous files, by name where the names are known."""
        for name in (name for name in expected if name not in names):
            self._say_missing(path_of(self.root, pattern, name))
        for name in (name for name in names if expected and name not in expected):
            self._say(f"take {path_of(self.root, pattern, name)} away; the dataset has no such shape")
        if not expected:
            self._count(len(names), count, path_of(self.root, pattern, "NAME"))

    def _count(self, found: int, expected: int, files: Path) -> None:
        if expected and found > expected:
            self._say(f"take {found - expected} of the {found} shapes at {files} away; the dataset has {expected}")
        elif not found or found < expected:
            missing = f"the {expected - found} missing of {expected} shapes" if expected else "the shapes"
            self._say(f"put {missing} at {files}")

    def _lists(self) -> None:
        described = self.description
        lists = ["train.txt", "test.txt"] if described.split == "listed" else []
        lists += [described.pairs_file] if described.pairs == "listed" else []
        for name in lists:
            if not (self.root / name).is_file():
                self._say_missing(self.root / name)

    # ---- their contents

    def _shapes(self, folder: ShapeFolder) -> None:
        for file in folder.missing_truth().values():
            self._say_missing(file)
        with self._errors_as_findings():
            for finding in folder.missing_shapes():
                self._say(finding)
        reader = _Reader(folder)
        steps = reader.steps()
        for done, (what, read) in enumerate(steps):
            self.progress(done, len(steps), what)
            with self._errors_as_findings():
                read()
        self.report.n_points, self.report.n_truth = _range(reader.n_points), _range(reader.n_truth)
        self._within("points", self.report.n_points, self.description.n_points)
        n_truth = self.description.n_truth
        self._within("points of ground truth", self.report.n_truth, (n_truth, n_truth) if n_truth else None)
        self._splits(folder)

    def _within(self, what: str, found: tuple[int, int] | None, expected: tuple[int, int] | None) -> None:
        if found and expected and (found[0] < expected[0] or found[1] > expected[1]):
            self._say(
                f"{self.root}: shapes have {counted(found)} {what}, but those of the dataset have {counted(expected)}; "
                "get the ones that differ again"
            )

    def _splits(self, folder: ShapeFolder) -> None:
        expected: dict[str, int] = {"train": self.description.n_train, "test": self.description.n_test}
        for split in get_args(Split):
            with self._errors_as_findings(unless=not expected.get(split)):
                found = len(folder.split(split))
                self.report.splits[split] = found
                self._same(split, "shapes", found, expected.get(split, 0))
            if split in self.report.splits:
                self._pairs(folder, split)

    def _pairs(self, folder: ShapeFolder, split: Split) -> None:
        with self._errors_as_findings(unless=split != "test"):
            found = len(folder.pairs(split))
            self.report.pairs[split] = found
            self._same(split, "pairs", found, self.description.n_pairs if split == "test" else 0)

    def _same(self, split: Split, what: str, found: int, expected: int) -> None:
        if expected and found != expected:
            self._say(f"{self.root}: split {split!r} has {found} {what}, but that of the dataset has {expected}")

    def _volumes(self) -> None:
        headers = sorted(self.root.glob(self.description.shapes))
        for done, header in enumerate(headers):
            self.progress(done, len(headers), header.name)
            data = _data_file(header)
            if data is None:
                self._say(f"{header} is no MetaImage header that names its ElementDataFile; get it again")
            elif not data.is_file():
                self._say_missing(data)

    def _checksum(self) -> None:
        self.report.sha256 = checksum(self.root, self.description)
        if self.description.sha256 not in ("", self.report.sha256):
            self._say(
                f"{self.root}: the checksum is {self.report.sha256}, but the dataset's is {self.description.sha256}"
            )


def checksum(root: Path, description: DatasetDescription) -> str:
    """The hash of the output of ``sha256sum`` for all files of a dataset's shapes and truth, sorted by path."""
    truth = description.truth_files if description.truth not in ("none", "same-numbering") else ""
    patterns = filter(None, (description.shapes, description.full, truth))
    files = {file for pattern in patterns for file in root.glob(pattern) if not file.name.startswith(".")}
    lines = (f"{sha256(file)}  {file.relative_to(root).as_posix()}\n" for file in sorted(files))
    return hashlib.sha256("".join(lines).encode(errors="surrogateescape")).hexdigest()


class _Reader:
    """Reads the shapes of a dataset one by one, and their ground truth in the same way as an evaluation.

    Only the shapes that the ground truth of later ones needs stay in memory.
    """

    def __init__(self, folder: ShapeFolder) -> None:
        self.folder, self.description = folder, folder.description
        self.n_points: list[int] = []
        self.n_truth: list[int] = []
        self._shapes: dict[str, Shape] = {}
        self._truth = folder.ground_truth(self._shapes.__getitem__)
        self._first: dict[str, str] = {}
        self._missing = folder.missing_truth()

    def steps(self) -> list[tuple[str, Callable[[], None]]]:
        """The names of what is to be read, and functions that read it."""
        steps = [(name, partial(self._read, name)) for name in (*self.folder.full, *self.folder.names)]
        pairs = self._pairs()
        maps = pairs if self.description.pairs == "maps" else ()
        steps += [(f"map of {pair[0]} - {pair[1]}", partial(self._compare, *pair)) for pair in maps]
        clouds = [name for name in self.folder.names if self.folder.has_cloud(name)]
        partners = {target: source for source, target in pairs}
        return [*steps, *((f"cloud of {name}", partial(self._read_cloud, partners.get(name), name)) for name in clouds)]

    def _pairs(self) -> tuple[Pair, ...]:
        """All pairs, if the check needs them; none if their list is not valid."""
        if self.description.pairs != "maps" and not self.description.clouds:
            return ()
        try:
            return self.folder.pairs("all")
        except DataError:
            return ()

    def _read(self, name: str) -> None:
        shape = self.folder.shape(name)
        self.n_points.append(shape.n_points)
        if shape.faces is None and self.description.holds == "meshes":
            raise DataError(f"{self.folder.file(name)} has no faces, but the dataset is of meshes; get it again")
        self._shapes[name] = shape
        if name not in self.folder.full and self.description.truth != "pair-maps":
            self._read_truth(name)

    def _read_truth(self, name: str) -> None:
        """Compare with the full shape, or with the first shape of the class whose ground truth is valid."""
        kind = class_of(name) if self.description.pairs == "same-class" else ""
        try:
            if self.description.truth != "none" and name not in self._missing:
                full = self.folder.full
                self._compare(partner(name, full) if full else self._first.get(kind, name), name)
                self._first.setdefault(kind, name)
        finally:
            if name not in self._first.values():
                del self._shapes[name]

    def _read_cloud(self, source: str | None, name: str) -> None:
        """Read a cloud with its own points, and its ground truth if it is in a pair."""
        cloud = self.folder.cloud(name)
        if source is not None:
            if source not in self._shapes:
                self._shapes.clear()
                self._shapes[source] = self.folder.shape(source)
            self._truth.of_cloud(source, name, cloud)

    def _compare(self, source: str, target: str) -> None:
        self.n_truth.append(len(self._truth.between(source, target).target))


def _data_file(header: Path) -> Path | None:
    """The voxel file that a MetaImage header names; None if it names none."""
    for line in read_text(header, errors="replace").splitlines():
        key, _, value = line.partition("=")
        if key.strip() == "ElementDataFile":
            return header.parent / value.strip()
    return None


def _range(counts: Sequence[int]) -> tuple[int, int] | None:
    return (min(counts), max(counts)) if counts else None


def counted(counts: tuple[int, int] | None) -> str:
    """Format a range of counts; empty if there is none.

    Examples:
        >>> counted((1000, 5000)), counted((20, 20))
        ('1,000 to 5,000', '20')
    """
    if counts is None:
        return ""
    return f"{counts[0]:,}" if counts[0] == counts[1] else f"{counts[0]:,} to {counts[1]:,}"
