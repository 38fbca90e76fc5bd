"""What is given to be matched: shapes, files, and options in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, fields, replace
from os import PathLike, fspath
from typing import Any

import numpy as np
from torch import Tensor

from homolog.core.arguments import check_kind
from homolog.core.errors import ArgumentError, bad_choice
from homolog.core.progress import Timings
from homolog.matching.result import Match
from homolog.pairs import SIDES, PairOptions, Side
from homolog.shapes import Shape, as_shape, read_hashed_shape


def options_of(options: PairOptions | None, words: dict[str, Any]) -> PairOptions:
    """Options as given, or from their words.

    Raises:
        ArgumentError: if both are given, or a word is not allowed.
    """
    if options is not None and words:
        raise ArgumentError(f"options are given twice, as options and as {next(iter(words))}; give one of them")
    if options is not None:
        check_kind("options", options, PairOptions)
        return options
    known = [field.name for field in fields(PairOptions)]
    for name in words:
        if name not in known:
            raise bad_choice("an option", name, known)
    return PairOptions(**words)


def check_two_arrays(features: Any) -> None:
    """Refuse features that are not one array for each shape; the arrays themselves are checked with the shapes."""
    if isinstance(features, str | PathLike):
        name = fspath(features)
        raise ArgumentError(f"features is {name!r}, but must be arrays, a function or a network; give weights={name!r}")
    if isinstance(features, list | tuple) and any(map(callable, features)):
        raise ArgumentError(
            "features given with a pair are several networks or functions, but must be two arrays, (of_source, "
            "of_target); those to choose from are given to homolog.Matcher([...])"
        )
    several = isinstance(features, Sequence | np.ndarray | Tensor)
    if not several or len(features) != 2:
        found = f"{len(features)} of them" if several else f"a {type(features).__name__}"
        raise ArgumentError(
            f"features given with a pair are {found}, but must be two arrays, (of_source, of_target); "
            "a function or a network is given to homolog.match or Matcher"
        )
    for side, given in zip(SIDES, features, strict=True):
        if given is None:
            raise ArgumentError(f"features of the {side} are None, but must be an array (n, d); give those of both")


def read_inputs(source: Any, target: Any, timings: Timings) -> tuple[tuple[Shape, Shape], dict[Side, dict[str, str]]]:
    """Both shapes, read where they are paths, and which files they came from."""
    shapes: list[Shape] = []
    files: dict[Side, dict[str, str]] = {"source": {}, "target": {}}
    given: dict[Side, Any] = {"source": source, "target": target}
    for side, shape in given.items():
        if isinstance(shape, str | PathLike):
            with timings.measure(f"read {side}"):
                shape, digest = read_hashed_shape(fspath(shape))
            files[side] = {"file": str(given[side]), "sha256": digest}
        shapes.append(_shape(side, shape))
    return (shapes[0], shapes[1]), files


def _shape(side: Side, given: Any) -> Shape:
    """A shape, which messages call by its side where it has no name of its own."""
    named = isinstance(given, Shape) and given.name != Shape.name
    try:
        return as_shape(given, name=None if named else side)
    except ArgumentError as error:
        raise ArgumentError(f"{side}: {error}") from None


def with_inputs(match: Match, files: dict[Side, dict[str, str]], timings: Timings, *, adapt: int = 0) -> Match:
    """The match with the files that its shapes came from, and the seconds of its steps, in its report."""
    known = match.report["inputs"]
    inputs = {side: {**files[side], **known[side]} for side in files}
    timed = [asdict(step) for step in timings.finished]
    return replace(match, report={**match.report, "inputs": inputs, "adapt": adapt, "timings": timed})
