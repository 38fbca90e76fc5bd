"""Several processes: an error in one is raised in all, and their connections are closed at the end."""

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
def process_group() -> Iterator[None]:
    """Close the connections between processes when this block ends, with an error or without.

    Their threads would otherwise still run while the interpreter shuts down, which may abort a process.
    """
    try:
        yield
    finally:
        if processes.is_available() and processes.is_initialized():
            processes.destroy_process_group()


@contextmanager
def shared_errors() -> Iterator[None]:
    """Raise in every process the error that any of them raises in this block; of several, that of the lowest process.

    Otherwise the others would wait for the failed one, and the first process, which reports to the user, would not
    know of the error. With one process nothing is changed.
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
