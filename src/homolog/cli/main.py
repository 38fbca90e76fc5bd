"""The ``homolog`` command: its subcommands, and how it ends."""

from __future__ import annotations

import logging
import signal
import sys
import warnings
from types import FrameType

import typer

from homolog.cli.demo import demo
from homolog.cli.doctor import doctor
from homolog.cli.evaluate import evaluate
from homolog.cli.info import info
from homolog.cli.match import match
from homolog.errors import HomologError

app = typer.Typer(
    name="homolog",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Find dense correspondences between non-rigid 3D shapes: meshes and point clouds, whole or partial.",
)
for command in (match, evaluate, info, doctor, demo):
    app.command()(command)


class _Interrupted(BaseException):
    """Ctrl-C or a polite kill; not an ``Exception``, so that nothing on the way takes it for a failure."""


def main() -> None:
    """Run the command line; a user's mistake is one line on stderr and exit code 2, Ctrl-C is exit code 130."""
    logging.basicConfig(format="%(message)s", level=logging.WARNING)
    if not sys.warnoptions:
        # What libraries tell programmers is noise to users; `python -W default -m homolog` shows it.
        warnings.simplefilter("ignore")
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    try:
        app()
    except HomologError as error:
        _end(f"Error: {error}", 2)
    except _Interrupted:
        _end("Interrupted; nothing was left half-written.", 130)
    except MemoryError:
        _end("Error: not enough memory; use smaller shapes, or close other programs", 2)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise _Interrupted


def _end(message: str, code: int) -> None:
    sys.stdout.flush()
    print(message, file=sys.stderr)
    sys.exit(code)


if __name__ == "__main__":
    main()
