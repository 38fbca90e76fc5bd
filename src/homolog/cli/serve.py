"""``homolog serve``: a page that matches two files that are dropped on it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

import homolog
from homolog.cli.browsing import PAGE, Host, NoOpen, Port, announce, interrupt_ends
from homolog.cli.options import DeviceOption, MethodOption, Quiet, Weights, build_matcher, check_inputs
from homolog.cli.progress import say
from homolog.core.errors import needs_extra
from homolog.core.files import resolved
from homolog.core.pretrained import AUTO_WEIGHTS, pretrained_weights

_LIMITS = "Limits"
_AT_ONCE = min(2, os.cpu_count() or 1)


def serve(
    host: Host = "127.0.0.1",
    port: Port = 8080,
    name: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="A host name that browsers may use for this server, such as that of a reverse proxy. Can be repeated.",
            show_default=False,
            rich_help_panel=PAGE,
        ),
    ] = None,
    no_open: NoOpen = False,
    max_mb: Annotated[
        float, typer.Option(metavar="MB", help="The largest file.", min=0.001, rich_help_panel=_LIMITS)
    ] = 100.0,
    jobs: Annotated[
        int, typer.Option(metavar="N", help="Matches at once; they share the cores.", min=1, rich_help_panel=_LIMITS)
    ] = _AT_ONCE,
    queue: Annotated[
        int, typer.Option(metavar="N", help="Matches that may wait in the queue.", min=0, rich_help_panel=_LIMITS)
    ] = 8,
    per_address: Annotated[
        int,
        typer.Option(
            metavar="N",
            help="Matches per address; this machine's are not limited.",
            min=1,
            rich_help_panel=_LIMITS,
        ),
    ] = 3,
    minutes: Annotated[
        float, typer.Option(metavar="MIN", help="Time that a match may take.", min=0.01, rich_help_panel=_LIMITS)
    ] = 15.0,
    memory_gb: Annotated[
        float, typer.Option(metavar="GB", help="Memory that a match may take.", min=0.1, rich_help_panel=_LIMITS)
    ] = 4.0,
    weights: Weights = None,
    method: MethodOption = "auto",
    device: DeviceOption = "auto",
    quiet: Quiet = False,
) -> None:
    """Serve a page that matches two shapes that are dropped on it.

    The page shows the steps and the map, and gives the result to download. Each match runs in its own process, bounded
    in time and memory, and ends when its page is closed. Nothing is written outside a temporary folder, which is
    removed; nothing that was uploaded is kept. Prints the address and
    serves until Ctrl-C. Needs the extra `serve`.

    Examples:
      homolog serve

      homolog serve --port 9000 --jobs 4 --minutes 5 --memory-gb 8

      homolog serve --weights animals.safetensors --no-open

      homolog serve --host 0.0.0.0 --name shapes.example.org --max-mb 20

    On a remote machine: run it there, run `ssh -L 8080:127.0.0.1:8080 MACHINE` here, and open the address here.
    """
    check_inputs(weights=weights)
    with needs_extra("homolog serve", "serve"):
        from homolog.serving.server import MatchServer
    matcher = build_matcher(weights, method, device, no_cache=True)  # says now what would be wrong with each match
    if not quiet:
        for warning in matcher.warnings:
            say(f"Warning: {warning}")
    command = homolog.serving.MatchCommand(_options(weights, method, device))
    limits = homolog.serving.Limits(
        max_mb=max_mb, jobs=jobs, queue=queue, per_address=per_address, minutes=minutes, memory_gb=memory_gb
    )
    made_with = method
    if weights is not None or homolog.matching.needs_features(matcher.settings):
        made_with = f"{method}, with the weights {Path(weights or AUTO_WEIGHTS).stem}"
    server = MatchServer(command, limits, host=host, port=port, names=name or (), made_with=made_with)
    announce(server.address, open_browser=not no_open, quiet=quiet)
    with interrupt_ends(server.end):
        server.serve()


def _options(weights: str | None, method: str, device: str) -> tuple[str, ...]:
    """What every match is told; its process runs elsewhere."""
    given = (f"--method={method}", f"--device={device}")
    if weights is None:
        return given
    place = weights if weights in (AUTO_WEIGHTS, *pretrained_weights()) else str(resolved(weights))
    return (*given, f"--weights={place}")
