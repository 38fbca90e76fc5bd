"""Limits on the matches of a server."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass

from homolog.core.arguments import is_real
from homolog.core.errors import bad_value

_MEBIBYTE = 2**20
_GIBIBYTE = 2**30


@dataclass(frozen=True)
class Limits:
    """Limits on uploads, and on what a match may use.

    Args:
        max_mb: the largest file, in MB (2^20 bytes).
        jobs: matches that run at once.
        queue: matches that may wait for their turn.
        per_address: matches of one address of another machine, running, waiting or kept.
        minutes: how long a match may run; uploading may take as long, and a result is kept as long.
        memory_gb: memory of a match, in GB (2^30 bytes).

    Raises:
        ArgumentError: if one of them is not a positive number; only the queue may be 0.
    """

    max_mb: float = 100.0
    jobs: int = 1
    queue: int = 8
    per_address: int = 3
    minutes: float = 15.0
    memory_gb: float = 4.0

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not is_real(value) or value < 0 or (value == 0 and name != "queue"):
                raise bad_value(name, value, "a positive number")

    @property
    def file_bytes(self) -> int:
        """The largest file in bytes."""
        return int(self.max_mb * _MEBIBYTE)

    @property
    def memory_bytes(self) -> int:
        """Memory of a match in bytes."""
        return int(self.memory_gb * _GIBIBYTE)

    @property
    def seconds(self) -> float:
        """How long a match may run, in seconds."""
        return 60 * self.minutes

    @property
    def admitted(self) -> int:
        """How many matches there can be at once, running, waiting or kept."""
        return self.jobs + self.queue

    @property
    def threads(self) -> int:
        """Threads of each match: all matches at once take one per core."""
        return max(1, (os.cpu_count() or 1) // self.jobs)
