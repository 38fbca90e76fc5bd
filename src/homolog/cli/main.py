"""How the ``homolog`` command begins and ends."""

from __future__ import annotations

import logging
import signal
import sys
import warnings
from types import FrameType
from typing import NoReturn

from homolog.errors import HomologError


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
        # Only now, as loading PyTorch takes seconds in which Ctrl-C must work, too.
        from homolog.cli.app import app

        status = app(standalone_mode=False)
    except HomologError as error:
        _end(f"Error: {error}", 2)
    except _Interrupted:
        _end("Interrupted; nothing was left half-written.", 130)
    except MemoryError:
        _end("Error: not enough memory; use smaller shapes, or close other programs", 2)
    except Exception as error:
        # Mistakes in options are exceptions of the command-line library, which keeps their class to itself.
        if not hasattr(error, "format_message"):
            raise
        complaint = error.format_message().replace("Value error, ", "").rstrip(".") or "a command is missing"
        _end(f"Error: {complaint}; see homolog --help", 2)
    sys.exit(status if isinstance(status, int) else 0)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise _Interrupted


def _end(message: str, code: int) -> NoReturn:
    sys.stdout.flush()
    print(message, file=sys.stderr)
    sys.exit(code)


if __name__ == "__main__":
    main()
