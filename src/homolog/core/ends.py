"""Ends of a process that come within seconds, whatever it is doing: after Ctrl-C or SIGTERM, and with its parent."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn

from homolog.core.files import remove_temporary_files

_POLL_SECONDS = 0.5
# What blocks ask for that have something to bring to an end after a signal.
_more_patience: list[float] = []
# Is written in place of a signal's number to call the waiting off.
_CALLED_OFF = 0


def bound_end(seconds: float, end: Callable[[int], NoReturn]) -> Callable[[], None]:
    """From now on, end this process some seconds after Ctrl-C or SIGTERM, unless it has ended by then.

    Python calls a signal's handler once native code returns, and the factorisation of a large matrix takes minutes. So
    a thread waits beside it. Signals that are ignored end nothing. To be called in the main thread.

    Args:
        seconds: which the handlers of signals have.
        end: called with the number of the signal, without temporary files of this process; it must end the process.

    Returns:
        What calls it off, unless there was a signal.
    """
    heard, told = os.pipe()
    os.set_blocking(told, False)
    before = signal.set_wakeup_fd(told, warn_on_full_buffer=False)  # written to at once, whatever runs

    def wait() -> None:
        while (number := os.read(heard, 1)[0]) not in (signal.SIGINT, signal.SIGTERM, _CALLED_OFF):
            pass
        if number != _CALLED_OFF:
            time.sleep(max([seconds, *_more_patience]))
            remove_temporary_files()
            end(number)
        os.close(heard)
        os.close(told)

    def call_off() -> None:
        signal.set_wakeup_fd(before)
        os.write(told, bytes([_CALLED_OFF]))

    threading.Thread(target=wait, daemon=True).start()
    return call_off


@contextmanager
def patience(seconds: float) -> Iterator[None]:
    """Give what runs in this block so long to end after a signal."""
    _more_patience.append(seconds)
    try:
        yield
    finally:
        _more_patience.remove(seconds)


def end_with_parent(parent: int) -> None:
    """From now on, end this process within a second or so of its parent, even if that is killed.

    Args:
        parent: the number of the process that started this one.
    """
    import psutil  # commands load this module before they can hear a signal

    def watch() -> None:
        while os.getppid() == parent and psutil.pid_exists(parent):
            time.sleep(_POLL_SECONDS)
        remove_temporary_files()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
