"""Ctrl-C and SIGTERM, deferred until a training has saved a checkpoint."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from homolog.core.ends import patience

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
# For a step to be done, and a checkpoint to be written.
_PATIENCE_SECONDS = 60.0


class Interrupts:
    """The signal that came last, if any."""

    def __init__(self) -> None:
        self.number: int | None = None

    def __bool__(self) -> bool:
        return self.number is not None


@contextmanager
def deferred_interrupts() -> Iterator[Interrupts]:
    """Defer a first Ctrl-C or SIGTERM until the block ends, and raise it then.

    The block should check the result regularly, and end soon if it is true: a command is ended after a minute. A second
    signal acts at once. Outside the
    main thread, where Python delivers no signals, this does nothing.
    """
    interrupts = Interrupts()
    if threading.current_thread() is not threading.main_thread():
        yield interrupts
        return
    before = {number: signal.getsignal(number) or signal.SIG_DFL for number in _SIGNALS}

    def give_back() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def keep(number: int, frame: FrameType | None) -> None:
        interrupts.number = number
        give_back()

    for number in _SIGNALS:
        signal.signal(number, keep)
    try:
        with patience(_PATIENCE_SECONDS):
            yield interrupts
    finally:
        give_back()
    if interrupts.number is not None:
        signal.raise_signal(interrupts.number)
