"""What the commands share that serve a page: where to listen, saying so, and ending by Ctrl-C."""

from __future__ import annotations

import os
import signal
import sys
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated

import typer

from homolog.cli.progress import say

PAGE = "Page"
"""The group that these options stand in."""
Host = Annotated[
    str,
    typer.Option(
        "--host",
        metavar="ADDRESS",
        help="Where to listen; 0.0.0.0 lets other machines in, without a password.",
        rich_help_panel=PAGE,
    ),
]
Port = Annotated[
    int,
    typer.Option(
        "--port",
        metavar="PORT",
        help="The port, or the next free one; 0 for any.",
        min=0,
        max=65535,
        rich_help_panel=PAGE,
    ),
]
NoOpen = Annotated[
    bool, typer.Option("--no-open", help="Print the address only; open no browser.", rich_help_panel=PAGE)
]


def announce(address: str, *, open_browser: bool, quiet: bool) -> None:
    """Print where the page is, and open it if that would be seen."""
    typer.echo(address)
    sys.stdout.flush()
    if not quiet:
        say("Serving until Ctrl-C.")
    if open_browser and _has_screen():
        webbrowser.open(address)


@contextmanager
def interrupt_ends(end: Callable[[], None]) -> Iterator[None]:
    """Within a ``with`` block Ctrl-C calls ``end``: it is how a server is meant to end, and no failure.

    So does a terminal that is closed, where the system tells of it.
    """
    numbers = [signal.SIGINT] if sys.platform == "win32" else [signal.SIGINT, signal.SIGHUP]
    former = {number: signal.signal(number, lambda *_: end()) for number in numbers}
    try:
        yield
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)


def _has_screen() -> bool:
    """Whether a browser would be seen by whoever typed the command; on a remote shell it would not."""
    if "SSH_CONNECTION" in os.environ:
        return False
    return sys.platform in ("win32", "darwin") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
