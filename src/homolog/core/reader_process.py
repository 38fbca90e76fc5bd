"""Readers that may crash, hang or fill the memory on a damaged file run in a process of their own.

It has limits of time, processor and memory, prints nothing, and ends when the process that started it ends.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from homolog.core.memory import most_expanded

# Within so many seconds of processor time, or of waiting for it, any small file is read that is whole.
_PROCESSOR_SECONDS, _SECONDS = 4.0, 30.0
_SECONDS_PER_BYTE = 2e-6
# Of a library, whatever it reads.
_OWN_MEMORY = 32 * 2**20
_CHILD = Path(__file__).with_name("reader_child.py")


class ReaderProcessError(Exception):
    """A reader refused a file, crashed, or came to a limit; the message is the reason, without the file's name."""


def read_in_process(script: Path, path: Path, *arguments: str, library: str) -> dict[str, np.ndarray]:
    """Call the function ``read`` of a Python file in a process of its own.

    Args:
        script: the Python file. It imports nothing of Homolog that loads slowly, and its ``read`` gives arrays by name;
            a ``ValueError`` of it is the reason why the file is refused.
        path: the file to read, the first argument of ``read``.
        arguments: the others.
        library: what reads it, for messages.

    Raises:
        ReaderProcessError: with the reason.
    """
    size = path.stat().st_size
    limit = _SECONDS + size * _SECONDS_PER_BYTE
    order = {
        "search_path": sys.path,  # which may have been changed in this process
        "parent": os.getpid(),
        "script": str(script),
        "arguments": [str(path.resolve()), *arguments],
        "memory": most_expanded(size) + _OWN_MEMORY,
        "processor_seconds": int(_PROCESSOR_SECONDS + size * _SECONDS_PER_BYTE),
    }
    command = [sys.executable, "-I", "-W", "ignore", str(_CHILD), json.dumps(order)]
    silent = subprocess.DEVNULL
    with subprocess.Popen(command, stdin=silent, stdout=subprocess.PIPE, stderr=silent) as process:
        timer = threading.Timer(limit, process.kill)
        timer.start()
        try:
            return _received(process.stdout)
        except (EOFError, ValueError):
            if not timer.is_alive():
                reason = f"{library} has not read it within {limit:.0f} s"
            elif process.wait() == -getattr(signal, "SIGXCPU", 0):
                reason = f"{library} has not read it within {order['processor_seconds']} s of the processor's time"
            else:
                reason = f"{library} cannot take it in"
            raise ReaderProcessError(reason) from None
        finally:
            timer.cancel()
            process.kill()


def _received(pipe: Any) -> dict[str, np.ndarray]:
    """What the process answers: a line of JSON, and then arrays."""
    head = pipe.readline()
    if not head:
        raise EOFError
    answer = json.loads(head)
    if "refused" in answer:
        raise ReaderProcessError(answer["refused"])
    # NumPy would look for a place in what it takes for a file.
    stream: Any = SimpleNamespace(read=pipe.read)
    return {name: np.lib.format.read_array(stream, allow_pickle=False) for name in answer["arrays"]}
