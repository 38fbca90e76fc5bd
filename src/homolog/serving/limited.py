"""Takes memory away from this process, and becomes another program.

Run as a script with a number of bytes, a command and its arguments. It imports nothing of Homolog, to start fast.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from contextlib import suppress

_DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG of Linux


def main() -> None:
    """Set the limits that this system has, and go on as the command."""
    _set_limits(int(sys.argv[1]))
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)
    os.execv(sys.argv[2], sys.argv[2:])


def _set_limits(n_bytes: int) -> None:
    """Of memory that is written to, of files, and of what a crash leaves.

    The whole address space says little: libraries for graphics cards reserve far more of it than they use.
    """
    import resource

    for limit, most in (
        (resource.RLIMIT_DATA, n_bytes),
        (resource.RLIMIT_FSIZE, n_bytes),
        (resource.RLIMIT_CORE, 0),
    ):
        _, hard = resource.getrlimit(limit)
        lowest = most if hard == resource.RLIM_INFINITY else min(most, hard)
        with suppress(ValueError, OSError):
            resource.setrlimit(limit, (lowest, lowest))


if __name__ == "__main__":
    main()
