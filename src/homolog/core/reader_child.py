"""What ``reader_process`` starts: it sets limits, calls a reader, and answers with arrays or a reason."""

from __future__ import annotations

import json
import os
import runpy
import signal
import sys
from contextlib import suppress
from typing import Any

# In /proc/self/statm: the pages of data and stack.
_DATA = 5
# Of the C library of Linux: which signal a process gets when its parent ends.
_PR_SET_PDEATHSIG = 1


def main() -> None:
    """Do what the order on the command line says."""
    order = json.loads(sys.argv[1])
    sys.path[:] = order["search_path"]
    _end_with_parent(order["parent"])
    # What libraries print goes nowhere; the answer goes where their output would go.
    answer = os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    os.dup2(nothing, 2)
    read = runpy.run_path(order["script"])["read"]
    _limit(order["memory"], order["processor_seconds"])
    try:
        arrays = read(*order["arguments"])
    except MemoryError:
        _tell(answer, {"refused": "it needs too much memory for its size; set HOMOLOG_EXPANSION_MB if it is right"})
    except (ValueError, OSError, RuntimeError) as error:
        _tell(answer, {"refused": str(error)})
    else:
        _tell(answer, {"arrays": list(arrays)})
        for array in arrays.values():
            _send(answer, array)
    answer.flush()
    os._exit(0)  # libraries may crash as they are unloaded


def _end_with_parent(parent: int) -> None:
    """Have this process killed when its parent ends; elsewhere than on Linux the limit of the processor ends it."""
    if sys.platform != "linux":
        return
    import ctypes

    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def _limit(memory: int, seconds: int) -> None:
    """Let damaged sizes in a file fail here, not exhaust the machine; there are no such limits on Windows."""
    with suppress(ImportError, OSError, ValueError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
        with open("/proc/self/statm") as pages:  # noqa: PTH123  # before anything is imported for it
            held = int(pages.read().split()[_DATA]) * resource.getpagesize()
        _, hard = resource.getrlimit(resource.RLIMIT_DATA)
        wanted = held + memory
        if hard == resource.RLIM_INFINITY or wanted < hard:
            resource.setrlimit(resource.RLIMIT_DATA, (wanted, hard))


def _tell(answer: Any, what: dict[str, Any]) -> None:
    answer.write(json.dumps(what).encode() + b"\n")


def _send(answer: Any, array: Any) -> None:
    """Write an array as NPY, without a copy of it."""
    import numpy as np

    array = np.asarray(array, order="C")
    np.lib.format.write_array_header_1_0(answer, np.lib.format.header_data_from_array_1_0(array))
    answer.write(array.reshape(-1).view(np.uint8))


if __name__ == "__main__":
    main()
