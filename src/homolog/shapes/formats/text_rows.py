"""Writing rows of numbers as text."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np


def write_rows(path: Path, parts: Iterable[tuple[str, np.ndarray]], head: str = "") -> None:
    """Write rows of numbers by a pattern; ``%r`` gives the shortest text that reads back the same number."""
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write(head)
        for pattern, rows in parts:
            file.writelines(pattern % tuple(row) for row in rows.tolist())
