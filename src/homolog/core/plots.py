"""Which files plots are written to, known without loading what is plotted."""

from __future__ import annotations

from pathlib import Path

from homolog.core.errors import ArgumentError, needs_extra
from homolog.core.files import expanded

PLOT_SUFFIXES = (".png", ".pdf", ".svg")


def check_plot(path: str | Path) -> None:
    """Check, before any work is done, that a plot has a known suffix and that the extra ``plot`` is installed.

    Raises:
        ArgumentError: if there is no such format.
        MissingExtraError: if matplotlib is not installed.
    """
    suffix = expanded(path).suffix.lower()
    if suffix not in PLOT_SUFFIXES:
        found = f"the suffix {suffix!r}" if suffix else "no suffix"
        raise ArgumentError(f"{path} has {found}, but a plot must have one of {', '.join(PLOT_SUFFIXES)}")
    with needs_extra("a plot", "plot"):
        import matplotlib  # noqa: F401
