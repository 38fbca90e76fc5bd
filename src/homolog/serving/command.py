"""The command that a match is made with, and what it says."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from homolog.errors import ArgumentError, bad_choice
from homolog.matching import Side
from homolog.shapes import Up

VIEW = "view.html"
"""The page of a result, in its folder."""

_STEP = re.compile(r"([a-z][a-z ]*) \.\.\.")
_ERROR = "Error: "
# Folders of this machine, before the name of a file in them; they are nobody's business.
_FOLDERS = re.compile(r"(?<![\w<])(?:[A-Za-z]:)?(?:[\\/][^\\/\s:;,'\"()]+)+[\\/](?=[^\\/\s])")
# What would have a program think that it writes to a terminal.
_OF_TERMINALS = ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE")
_TEMPORARY = ("TMPDIR", "TEMP", "TMP")
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")

Part = Literal["none", "source", "target"]


@dataclass(frozen=True)
class Wishes:
    """What whoever uploads two shapes says of them.

    Args:
        source_up: the axis that points up in the source.
        target_up: likewise.
        partial: which of both is a part of one like the other.
    """

    source_up: Up = "y"
    target_up: Up = "y"
    partial: Part = "none"

    @classmethod
    def of(cls, given: Any) -> Wishes:
        """Read them from what a page sent.

        Raises:
            ArgumentError: if it is anything else.
        """
        allowed = {"source_up": get_args(Up), "target_up": get_args(Up), "partial": get_args(Part)}
        if not isinstance(given, dict) or not given.keys() <= allowed.keys():
            raise ArgumentError(f"a match is asked for by {', '.join(allowed)} alone")
        for name, value in given.items():
            if value not in allowed[name]:
                raise bad_choice(name, str(value)[:40], allowed[name])
        return cls(**given)

    def options(self) -> list[str]:
        """As options of the command."""
        return [f"--{name.replace('_', '-')}={value}" for name, value in asdict(self).items() if value != "none"]


@dataclass(frozen=True)
class MatchCommand:
    """``homolog match``, run in a folder with ``source/NAME`` and ``target/NAME``; the result goes to ``result/``.

    Args:
        options: of the command, the same for every match.
        n_steps: how many steps it announces.
        program: what is run, before ``match``.
    """

    options: tuple[str, ...] = ()
    n_steps: int = 11
    program: tuple[str, ...] = (sys.executable, "-m", "homolog")

    def line(self, names: Mapping[Side, str], wishes: Wishes) -> list[str]:
        """The command and its arguments."""
        files = [str(Path(side, name)) for side, name in names.items()]
        written = ["--output=result", f"--html={Path('result', VIEW)}"]
        # Operators are not kept: they would lie outside the server's folder, and tell of shapes of others.
        always = ["--verbose", "--no-cache"]
        return [*self.program, "match", *written, *always, *self.options, *wishes.options(), "--", *files]

    def environment(self, temporary: Path, threads: int) -> dict[str, str]:
        """The variables that it runs with, so that it writes nothing elsewhere and finds this very package."""
        kept = {name: value for name, value in os.environ.items() if name not in _OF_TERMINALS}
        path = os.pathsep.join(str(Path(place).resolve()) for place in sys.path)
        own = {"PYTHONPATH": path, "PYTHONSAFEPATH": "1", "PYTHONDONTWRITEBYTECODE": "1", "PYTHONIOENCODING": "utf-8"}
        return kept | own | dict.fromkeys(_TEMPORARY, str(temporary)) | dict.fromkeys(_THREADS, str(threads))


def step_of(line: str) -> str | None:
    """The step that a line of the command announces."""
    found = _STEP.fullmatch(line)
    return found and found[1]


def complaint_of(line: str, folder: Path, names: Mapping[Side, str]) -> str | None:
    """The error that a line of the command tells of, with files called as their owner calls them.

    Args:
        line: what it wrote.
        folder: where it ran.
        names: of the files that it was given.
    """
    if not line.startswith(_ERROR):
        return None
    said = line.removeprefix(_ERROR).replace(f"{folder.resolve()}{os.sep}", "")
    alike = len(set(names.values())) < len(names)
    for side, name in names.items():
        said = said.replace(str(Path(side, name)), f"the {side} {name}" if alike else name)
    return _FOLDERS.sub("", said)
