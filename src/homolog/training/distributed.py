"""Several processes: where one fails, all do and say the same, and all leave in good order."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import torch.distributed as processes

from homolog.core.errors import HomologError, TrainingError


def is_started_by_another() -> bool:
    """Whether another process of this machine started this one, and waits for it."""
    return os.environ.get("LOCAL_RANK", "0") != "0"


@contextmanager
def leaving_together() -> Iterator[None]:
    """Take apart what connects the processes when this block ends, however it does.

    Its threads would otherwise be at work while the interpreter is taken down around them, which may abort a process.
    """
    try:
        yield
    finally:
        if processes.is_available() and processes.is_initialized():
            processes.destroy_process_group()


@contextmanager
def failing_together() -> Iterator[None]:
    """Raise in every process the error that any of them meets in this block, the lowest one's if several do.

    Otherwise the others would wait for the failed one, and the first process, which speaks to the user, would know
    nothing of its error. Where there is but one process nothing is changed.
    """
    if not (processes.is_available() and processes.is_initialized()):
        yield
        return
    failure: HomologError | None = None
    try:
        yield
    except HomologError as error:
        failure = error
    messages: list[str | None] = [None] * processes.get_world_size()
    processes.all_gather_object(messages, None if failure is None else str(failure))
    first = next((message for message in messages if message is not None), None)
    if first is not None:
        raise failure if failure is not None and str(failure) == first else TrainingError(first)
