"""How threads wait and memory is handed out, to be chosen before PyTorch is first imported."""

from __future__ import annotations

import os


def tune_threads() -> None:
    """Set environment variables that make small matrix products faster, where the user has not set them.

    Call it before anything imports PyTorch, which reads them once; afterwards it has no effect on this process. The
    ``homolog`` command does. Processes that are started later inherit the variables.

    ``OMP_WAIT_POLICY=PASSIVE`` and ``GOMP_SPINCOUNT=10000``: threads spin for some 10 us, then sleep. Threads that
    spin for long slow small products down many times on a machine with other work; threads that sleep at once halve
    the speed on an idle one. ``THP_MEM_ALLOC_ENABLE=1``: PyTorch takes memory in large pages where the system has them,
    as fresh memory costs as much as the matrix product that fills it.

    Examples:
        >>> import homolog
        >>> homolog.tune_threads()
        >>> import torch
    """
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
        os.environ.setdefault("GOMP_SPINCOUNT", "10000")
    os.environ.setdefault("THP_MEM_ALLOC_ENABLE", "1")
