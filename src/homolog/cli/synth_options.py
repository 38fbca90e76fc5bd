"""Options that the commands for synthetic bodies share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import homolog
from homolog.cli.options import set_verbosity
from homolog.cli.progress import progress_bar
from homolog.core.choices import Turn

if TYPE_CHECKING:
    from homolog.core.cluster import Processes
    from homolog.synthesis import BodyFolder

NBodies = Annotated[int, typer.Option("--n-bodies", "-n", metavar="N", help="How many bodies.", min=1)]
Vertices = Annotated[int, typer.Option(metavar="N", help="About how many vertices each mesh has.", min=500)]
Stretch = Annotated[
    float,
    typer.Option(
        metavar="FACTOR",
        help="How much longer than wide triangles are, in a direction that each body has of its own.",
        min=1.0,
        max=5.0,
    ),
]
TurnOption = Annotated[
    Turn, typer.Option(help="How shapes are turned at random: none, vertical: about the y axis, or any way round.")
]


def make_bodies(
    synthesize: Callable[..., BodyFolder],
    output: Path,
    n_bodies: int,
    *,
    vertices: int,
    stretch: float,
    seed: int,
    processes: Processes,
    quiet: bool,
    verbose: bool,
) -> None:
    """Make a dataset of bodies, and print its folder."""
    set_verbosity(quiet=quiet, verbose=verbose)
    synthesis = homolog.synthesis
    settings = synthesis.BodySettings(seed, synthesis.MeshSettings(vertices, stretch))
    with progress_bar(quiet=quiet) as progress:
        folder = synthesize(output, n_bodies, settings, processes=processes, progress=progress)
    if not quiet:
        typer.echo(folder.root)
