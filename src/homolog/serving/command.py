"""The command that makes a match: its arguments, its environment, and the messages that it writes."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from homolog.core.errors import ArgumentError, bad_choice
from homolog.pairs import SIDES, LandmarkPairs, Side
from homolog.shapes import Up

PAGE = "view.html"
"""The page of a result, in its folder."""

# Absolute folders before the name of a file in them: users need not know those of this machine. Relative paths and
# URLs, such as '../a/b' and 'https://a/b', come from an uploaded file, and stay.
_ABSOLUTE_FOLDERS = re.compile(r"(?<![\w<.\\/])(?:[A-Za-z]:)?(?:[\\/][^\\/\s:;,'\"()]+)+[\\/](?=[^\\/\s])")
# They would have a program think that it writes to a terminal.
_TERMINAL_VARIABLES = ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE")
_TEMPORARY_VARIABLES = ("TMPDIR", "TEMP", "TMP")
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")

# No shape has so many.
_MOST_POINTS = 2**31

PartialSide = Literal["none", "source", "target"]
Alternatives = Literal["1", "2", "3"]
_LANDMARKS = "landmarks"


@dataclass(frozen=True)
class MatchRequest:
    """What a page says of the two shapes that it uploads.

    Args:
        source_up: the axis that points up in the source.
        target_up: likewise.
        partial: the one that is partial, if one is.
        alternatives: how many maps of other ways round are wanted, the likeliest among them.
        landmarks: points that are known to correspond, by their indices.
    """

    source_up: Up = "y"
    target_up: Up = "y"
    partial: PartialSide = "none"
    alternatives: Alternatives = "1"
    landmarks: LandmarkPairs | None = None

    @classmethod
    def of(cls, given: Any) -> MatchRequest:
        """Read it from the JSON that a page sent.

        Raises:
            ArgumentError: if it is anything else.
        """
        allowed = {
            "source_up": get_args(Up),
            "target_up": get_args(Up),
            "partial": get_args(PartialSide),
            "alternatives": get_args(Alternatives),
        }
        if not isinstance(given, dict) or not given.keys() <= {*allowed, _LANDMARKS}:
            raise ArgumentError(f"a match is asked for by {', '.join([*allowed, _LANDMARKS])} alone")
        words = {name: value for name, value in given.items() if name in allowed}
        for name, value in words.items():
            if value not in allowed[name]:
                raise bad_choice(name, str(value)[:40], allowed[name])
        return cls(**words, landmarks=_landmarks_of(given.get(_LANDMARKS)))

    def options(self) -> list[str]:
        """The options of the command."""
        words = {"source_up": self.source_up, "target_up": self.target_up, "partial": self.partial}
        options = [f"--{name.replace('_', '-')}={value}" for name, value in words.items() if value != "none"]
        options += [f"--alternatives={self.alternatives}"] * (self.alternatives != "1")
        return options + (["--landmarks", *map(_landmark_file, SIDES)] if self.landmarks else [])

    def write_landmarks(self, folder: Path) -> None:
        """Write the files that the options name into the folder that the command runs in; none without landmarks."""
        if self.landmarks is None:
            return
        for side in SIDES:
            file = folder / _landmark_file(side)
            file.parent.mkdir(exist_ok=True)
            file.write_text("".join(f"{place}\n" for place in self.landmarks.on(side)), encoding="ascii")


def _landmark_file(side: Side) -> str:
    return str(Path(_LANDMARKS, f"{side}.txt"))


def _landmarks_of(given: Any) -> LandmarkPairs | None:
    """Landmarks from the JSON that a page sent.

    Raises:
        ArgumentError: if they are no indices, or too many.
    """
    if given is None:
        return None
    whole = (
        isinstance(given, dict)
        and given.keys() == {*SIDES}
        and all(
            isinstance(indices, list) and all(type(index) is int and 0 <= index < _MOST_POINTS for index in indices)
            for indices in given.values()
        )
    )
    if not whole or len({len(indices) for indices in given.values()}) > 1:
        raise ArgumentError("landmarks must be two lists, source and target, of as many indices of points")
    return LandmarkPairs(**given)


@dataclass(frozen=True)
class MatchCommand:
    """``homolog match``, run in a folder with ``source/NAME`` and ``target/NAME``; the result goes to ``result/``.

    Args:
        options: of the command, the same for every match.
        program: what is run, before ``match``.
    """

    options: tuple[str, ...] = ()
    program: tuple[str, ...] = (sys.executable, "-m", "homolog")

    def line(self, names: Mapping[Side, str], request: MatchRequest) -> list[str]:
        """The command and its arguments."""
        files = [str(Path(side, name)) for side, name in names.items()]
        written = ["--output=result", f"--html={Path('result', PAGE)}"]
        # Operators are not cached: they would lie outside the server's folder, and tell of shapes of others.
        always = ["--progress=json", "--quiet", "--no-cache"]
        return [*self.program, "match", *written, *always, *self.options, *request.options(), "--", *files]

    def environment(self, temporary: Path, threads: int) -> dict[str, str]:
        """The variables that it runs with, so that it writes nothing elsewhere and finds this very package."""
        kept = {name: value for name, value in os.environ.items() if name not in _TERMINAL_VARIABLES}
        path = os.pathsep.join(str(Path(place).resolve()) for place in sys.path)
        own = {"PYTHONPATH": path, "PYTHONSAFEPATH": "1", "PYTHONDONTWRITEBYTECODE": "1", "PYTHONIOENCODING": "utf-8"}
        return (
            kept
            | own
            | dict.fromkeys(_TEMPORARY_VARIABLES, str(temporary))
            | dict.fromkeys(_THREAD_VARIABLES, str(threads))
        )


def read_message(line: str) -> dict[str, Any]:
    """The JSON object in a line of the command, ``{"step": ...}`` or ``{"error": ...}``; empty for any other line.

    ``homolog.cli.progress`` says what it holds.
    """
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return message if isinstance(message, dict) else {}


def public_error(error: str, folder: Path, names: Mapping[Side, str], side: Side | None = None) -> str:
    """An error of the command as the page shows it: without folders of this machine.

    Args:
        error: what the command wrote.
        folder: where it ran.
        names: of the files that it was given.
        side: the shape that it was at work on; it is named if both files have one name.
    """
    for which in names:
        # At the beginning it is the file; further on, what is called like it may be text of the file.
        error = error.replace(f"{folder.resolve() / which}{os.sep}", "").removeprefix(f"{which}{os.sep}")
    if side is not None and len(set(names.values())) < len(names) and error.startswith(names[side]):
        error = f"the {side} {error}"
    return _ABSOLUTE_FOLDERS.sub("", error.replace(f"{folder.resolve()}{os.sep}", ""))
