"""How threads wait and memory is handed out, to be chosen before PyTorch is first imported."""

from __future__ import annotations

import os
from pathlib import Path

# How often a waiting thread looks before it sleeps: for some 10 us, or 1 us.
_SPINS, _SPINS_BESIDE_OTHERS = "10000", "1000"


def tune_threads() -> None:
    """Set environment variables that make small matrix products faster, where the user has not set them.

    Call it before anything imports PyTorch, which reads them once; afterwards it has no effect on this process. The
    ``homolog`` command does. Processes that are started later inherit the variables.

    ``OMP_WAIT_POLICY=PASSIVE`` and ``GOMP_SPINCOUNT=10000``: threads spin for some 10 us, then sleep. Threads that
    spin for long slow small products down many times on a machine with other work; threads that sleep at once halve
    the speed on an idle one. Where other processes keep half of the processors busy at this moment, as Linux tells,
    they spin for 1 us. ``THP_MEM_ALLOC_ENABLE=1``: PyTorch takes memory in large pages where the system has them,
    as fresh memory costs as much as the matrix product that fills it.

    Examples:
        >>> import homolog
        >>> homolog.tune_threads()
        >>> import torch
    """
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
        busy = 2 * other_running_threads() >= (os.cpu_count() or 1)
        os.environ.setdefault("GOMP_SPINCOUNT", _SPINS_BESIDE_OTHERS if busy else _SPINS)
    os.environ.setdefault("THP_MEM_ALLOC_ENABLE", "1")


def other_running_threads(told: str | Path = "/proc/loadavg") -> int:
    """How many threads beside this one run or wait for a processor now; 0 where the system does not tell.

    Args:
        told: the file in which Linux tells of running and of all threads, as in ``1.20 0.95 0.80 3/412 9120``.
    """
    try:
        running, _ = Path(told).read_text().split()[3].split("/")
        return max(0, int(running) - 1)
    except (OSError, ValueError, IndexError):
        return 0
