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
# What a line may hold at most; longer ones are no messages.
_LONGEST_LINE = 4000


class OverLimitError(Exception):
    """A program was ended as it took more than it may; the message says what of."""


async def run_limited(
    command: Iterable[str],
    *,
    folder: Path,
    environment: Mapping[str, str],
    limits: Limits,
    heard: Callable[[str], None],
) -> int:
    """Run a program until it ends; whatever ends this, cancellation too, ends the program and its children.

    Args:
        command: the program and its arguments.
        folder: where it runs.
        environment: its environment variables.
        limits: of its time and memory.
        heard: told each line of its standard error.

    Returns:
        Its exit code; below zero the signal that ended it.

    Raises:
        OverLimitError: if it took too long or too much memory.
    """
    process = await anyio.open_process(
        _limited(command, limits),
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        with anyio.move_on_after(limits.seconds):
            return await _end_of(process, limits, heard)
    finally:
        _kill(process.pid)
        with anyio.CancelScope(shield=True):
            await process.aclose()
    raise OverLimitError(f"took longer than {limits.minutes:g} minutes")


def _limited(command: Iterable[str], limits: Limits) -> list[str]:
    """The command with limits of the system's, where there are any."""
    if sys.platform == "win32":
        return list(command)
    return [sys.executable, "-I", str(_LIMITED), str(limits.memory_bytes), *command]


async def _end_of(process: Process, limits: Limits, heard: Callable[[str], None]) -> int:
    """Hear what a program says until it ends."""
    assert process.stderr is not None
    outgrown = anyio.Event()
    async with anyio.create_task_group() as group:
        group.start_soon(_watch, process.pid, limits.memory_bytes, outgrown)
        async for line in _lines(process.stderr):
            heard(line)
        code = await process.wait()
        group.cancel_scope.cancel()
    if outgrown.is_set():
        raise OverLimitError(f"needed more than {limits.memory_gb:g} GB of memory")
    return code


async def _watch(pid: int, most: int, outgrown: anyio.Event) -> None:
    """Kill a program once it and its children hold too much memory: not every system keeps to limits of its own."""
    while _memory_of(pid) <= most:
        await anyio.sleep(_WATCH_SECONDS)
    outgrown.set()
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


def _family(pid: int) -> list[psutil.Process]:
    """A process and all below it, as far as they still are."""
    with suppress(psutil.Error):
        first = psutil.Process(pid)
        return [first, *first.children(recursive=True)]
    return []


def _memory_of(pid: int) -> int:
    """Resident memory of a process and all below it, in bytes."""
    total = 0
    for process in _family(pid):
        with suppress(psutil.Error):
            total += process.memory_info().rss
    return total


def _kill(pid: int) -> None:
    """End a process and its children at once; its group is its own."""
    if sys.platform == "win32":
        for process in _family(pid):
            with suppress(psutil.Error):
                process.kill()
    else:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(pid, signal.SIGKILL)
