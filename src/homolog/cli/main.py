"""How the ``homolog`` command begins and ends."""

from __future__ import annotations

import codecs
import io
import json
import logging
import os
import re
import signal
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from types import FrameType
from typing import NoReturn

from homolog.cli.wording import in_options
from homolog.core.ends import bound_end
from homolog.core.errors import HomologError
from homolog.core.messages import one_line
from homolog.core.threads import tune_threads

# What PyTorch says, in a plain RuntimeError, where there is not enough memory for an array.
_OUT_OF_MEMORY = re.compile("out of memory|not enough memory|can't allocate memory")
_INTERRUPTED = "Interrupted; nothing was left half-written."
# For a command to end by itself after Ctrl-C or a polite kill, its workers included.
_PATIENCE_SECONDS = 5.0


class _Interrupted(BaseException):
    """Ctrl-C or a polite kill; not an ``Exception``, so that nothing on the way takes it for a failure."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.exit_code = 128 + number  # as shells have it: 130 for SIGINT, 143 for SIGTERM


class _Log(logging.Handler):
    """Prints what the library logs, above the progress bar."""

    def emit(self, record: logging.LogRecord) -> None:
        from homolog.cli.progress import say  # loaded with the commands anyway, but not before Ctrl-C works

        say(self.format(record))


def main() -> None:
    """Run the command line; a user's mistake is one line on stderr and exit code 2, a signal 128 and its number."""
    logging.basicConfig(format="%(message)s", level=logging.WARNING, handlers=[_Log()])
    if not sys.warnoptions:
        # What libraries tell programmers is noise to users; `python -W default -m homolog` shows it.
        warnings.simplefilter("ignore")
    _hear(_leave)
    call_off = bound_end(_PATIENCE_SECONDS, _leave)
    tune_threads()
    _print_any_name()
    try:
        _run()
    finally:
        call_off()


def _run() -> NoReturn:
    """Run the command, and exit."""
    try:
        # Only now, as Ctrl-C must work while the commands are loaded, too.
        from homolog.cli.app import app

        _hear(_interrupt)
        status = app(prog_name="homolog", standalone_mode=False)
    except BrokenPipeError:
        # Whoever read the output, such as `head`, has seen enough; nothing more can be written, not even at the exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except (Exception, SystemExit, _Interrupted) as error:
        if interrupt := _interrupt_behind(error):
            _end(_INTERRUPTED, interrupt.exit_code)
        complaint = _complaint(error)
        if complaint is None:
            raise
        _fail(complaint)
    sys.exit(status if isinstance(status, int) else 0)


def _interrupt_behind(error: BaseException | None) -> _Interrupted | None:
    """The interrupt that an error came after: a library that is put away meanwhile may fail in its own way."""
    while error is not None and not isinstance(error, _Interrupted):
        error = error.__context__
    return error


def _complaint(error: BaseException) -> str | None:
    """What to say in a line about an error; None if it is a mistake of Homolog's own."""
    if isinstance(error, HomologError):
        return in_options(str(error))
    # Mistakes in options are exceptions of the command-line library, which keeps their class to itself.
    if hasattr(error, "format_message"):
        said = " ".join(error.format_message().replace("Value error, ", "").split()).rstrip(".")
        said = said or "a command is missing"
        context = getattr(error, "ctx", None)
        return f"{said}; see {context.command_path if context else 'homolog'} --help"
    said = " ".join(str(error).split())
    if isinstance(error, MemoryError) or (isinstance(error, RuntimeError) and _OUT_OF_MEMORY.search(said)):
        way_out = "use --device cpu, smaller shapes" if "CUDA" in said else "use smaller shapes"
        return f"not enough memory; {way_out}, or close other programs"
    # The errors of NumPy and of PyTorch have but their name in common, and SciPy's has none of its own.
    if type(error).__name__.lstrip("_") == "LinAlgError" or "exactly singular" in said:
        return f"a linear system has no solution ({said[:160]}); look at the shapes with homolog info, or remesh them"
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return None


def _print_any_name() -> None:
    """Let names of files be printed that the stream's encoding cannot hold; where it is UTF-8, with their own bytes."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            is_utf_8 = codecs.lookup(stream.encoding).name == "utf-8"
            with suppress(OSError):  # of a stream that another one has taken the place of
                stream.reconfigure(errors="surrogateescape" if is_utf_8 else "backslashreplace")


def _hear(handler: Callable[[int, FrameType | None], None]) -> None:
    """Have Ctrl-C and polite kills handled so."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handler)


def _leave(number: int, frame: FrameType | None = None) -> NoReturn:
    """End at once: what is raised while libraries are loaded, some of them take for a failure of their own."""
    bar_ends = "\x1b[?25h\n" if os.isatty(2) else ""  # a progress bar hides the cursor
    os.write(2, f"{bar_ends}{_INTERRUPTED}\n".encode())
    os._exit(_Interrupted(number).exit_code)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise _Interrupted(number)


def _fail(error: str) -> NoReturn:
    """End with a user's mistake, in JSON for programs that ask for it: see ``cli.progress``.

    The arguments are looked at as they are, as the mistake may be in them.
    """
    error = one_line(error)
    as_json = " --progress json" in " ".join(sys.argv).replace("=", " ")
    _end(json.dumps({"error": error}) if as_json else f"Error: {error}", 2)


def _end(message: str, code: int) -> NoReturn:
    sys.stdout.flush()
    print(message, file=sys.stderr)
    sys.exit(code)


if __name__ == "__main__":
    main()
