"""The command that a match is made with, and what it says."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from homolog.core.errors import ArgumentError, bad_choice
from homolog.pairs import Side
from homolog.shapes import Up

VIEW = "view.html"
"""The page of a result, in its folder."""

_STEP = re.compile(r"([a-z][a-z ]*) \.\.\.")
_ERROR = "Error: "
# Folders of this machine, before the name of a file in them; they are nobody's business. What begins with no root, as
# '../a/b' and 'https://a/b' do, is of no machine, but what a file says.
_FOLDERS = re.compile(r"(?<![\w<.\\/])(?:[A-Za-z]:)?(?:[\\/][^\\/\s:;,'\"()]+)+[\\/](?=[^\\/\s])")
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


def side_of(step: str) -> Side | None:
    """The shape that a step is about, if it is about one."""
    sides: tuple[Side, ...] = get_args(Side)
    return next((side for side in sides if step.endswith(f" {side}")), None)


def complaint_of(line: str, folder: Path, names: Mapping[Side, str], about: Side | None = None) -> str | None:
    """The error that a line of the command tells of, with files called as their owner calls them.

    Args:
        line: what it wrote.
        folder: where it ran.
        names: of the files that it was given.
        about: the shape that it was at work on, told from the other if their files are called alike.
    """
    if not line.startswith(_ERROR):
        return None
    said = line.removeprefix(_ERROR)
    for side in names:
        # Where it begins it is the file; further on, what is called like it may be text of the file.
        said = said.replace(f"{folder.resolve() / side}{os.sep}", "").removeprefix(f"{side}{os.sep}")
    alike = len(set(names.values())) < len(names)
    which = f"the {about} " if about and alike and said.startswith(names[about]) else ""
    return which + _FOLDERS.sub("", said.replace(f"{folder.resolve()}{os.sep}", ""))
