"""A program in a process of its own: bounded in time and memory, and killed with all that it started."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path

import anyio
import psutil
from anyio.abc import ByteReceiveStream, Process

from homolog.serving.limits import Limits

_LIMITED = Path(__file__).with_name("limited.py")
_WATCH_SECONDS = 0.25
# Of a line, in bytes; longer ones are cut, and no messages.
_LONGEST_LINE = 16_000


class LimitExceededError(Exception):
    """A program was ended as it exceeded a limit; the message says which."""


async def run_limited(
    command: Iterable[str],
    *,
    folder: Path,
    environment: Mapping[str, str],
    limits: Limits,
    on_line: Callable[[str], None],
) -> int:
    """Run a program until it ends; whatever ends this, cancellation too, ends the program and its children.

    Args:
        command: the program and its arguments.
        folder: where it runs.
        environment: its environment variables.
        limits: of its time and memory.
        on_line: called with each line of its standard error.

    Returns:
        Its exit code; below zero the signal that ended it.

    Raises:
        LimitExceededError: if it took too long or too much memory.
    """
    # With limits of the system's, where there are any.
    wrapper = [] if sys.platform == "win32" else [sys.executable, "-I", str(_LIMITED), str(limits.memory_bytes)]
    # Whole, even if cancelled meanwhile: else what the program has started by then would live on.
    with anyio.CancelScope(shield=True):
        process = await anyio.open_process(
            [*wrapper, *command],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            start_new_session=True,
        )
    try:
        with anyio.move_on_after(limits.seconds):
            return await _wait_for(process, limits, on_line)
    finally:
        _kill(process.pid)
        with anyio.CancelScope(shield=True):
            await process.aclose()
    raise LimitExceededError(f"took longer than {limits.minutes:g} minutes")


async def _wait_for(process: Process, limits: Limits, on_line: Callable[[str], None]) -> int:
    """Read what a program writes until it ends."""
    assert process.stderr is not None
    exceeded = anyio.Event()
    async with anyio.create_task_group() as group:
        group.start_soon(_watch, process.pid, limits.memory_bytes, exceeded)
        async for line in _lines(process.stderr):
            on_line(line)
        code = await process.wait()
        group.cancel_scope.cancel()
    if exceeded.is_set():
        raise LimitExceededError(f"needed more than {limits.memory_gb:g} GB of memory")
    return code


async def _watch(pid: int, most: int, exceeded: anyio.Event) -> None:
    """Kill a program once it and its children hold too much memory: not every system keeps to limits of its own."""
    while _memory_of(pid) <= most:
        await anyio.sleep(_WATCH_SECONDS)
    exceeded.set()
    _kill(pid)


async def _lines(stream: ByteReceiveStream) -> AsyncIterator[str]:
    kept = b""
    async for part in stream:
        *whole, kept = (kept + part).split(b"\n")
        for line in whole:
            yield line[:_LONGEST_LINE].decode(errors="replace")
        kept = kept[:_LONGEST_LINE]
    if kept:
        yield kept.decode(errors="replace")


def _process_tree(pid: int) -> list[psutil.Process]:
    """A process and its descendants, as far as they still exist."""
    with suppress(psutil.Error):
        first = psutil.Process(pid)
        return [first, *first.children(recursive=True)]
    return []


def _memory_of(pid: int) -> int:
    """Resident memory of a process and its descendants, in bytes."""
    total = 0
    for process in _process_tree(pid):
        with suppress(psutil.Error):
            total += process.memory_info().rss
    return total


def _kill(pid: int) -> None:
    """End a process and its children at once; its group is its own."""
    if sys.platform == "win32":
        for process in _process_tree(pid):
            with suppress(psutil.Error):
                process.kill()
    else:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(pid, signal.SIGKILL)
