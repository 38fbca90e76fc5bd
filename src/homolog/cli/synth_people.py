"""``homolog synth people``: datasets of synthetic people with ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import homolog
from homolog.cli.options import ONE_PER_CORE, OUTPUT, Processes, Quiet, Seed, Verbose, set_verbosity
from homolog.cli.progress import progress_bar


def people(
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="DIR", help="A new folder, or one to resume.", rich_help_panel=OUTPUT),
    ] = Path("people"),
    n_bodies: Annotated[int, typer.Option("--n-bodies", "-n", metavar="N", help="How many bodies.", min=1)] = 500,
    vertices: Annotated[int, typer.Option(metavar="N", help="About how many vertices each mesh has.", min=500)] = 5000,
    stretch: Annotated[
        float,
        typer.Option(
            metavar="FACTOR",
            help="How much longer than wide triangles are, in a direction that each body has of its own.",
            min=1.0,
            max=5.0,
        ),
    ] = 1.0,
    seed: Seed = 0,
    processes: Processes = ONE_PER_CORE,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Make synthetic people of any age, sex and build in any pose, each with its own mesh.

    Needs the extra `synth`. Writes DIR/off/NAME.off and DIR/corres/NAME.vts, which train and evaluate read, and
    DIR/places, DIR/records, DIR/template and DIR/manifest.json: barycentric coordinates on the common template, how
    each body was made, and licences. The same command resumes where it was stopped; a larger -n adds bodies.

    Examples:
      homolog synth people -n 500 -o people

      homolog synth people -n 500 -o stretched --stretch 3 --seed 1

      homolog train people -o run
    """
    set_verbosity(quiet=quiet, verbose=verbose)
    synthesis = homolog.synthesis
    settings = synthesis.PeopleSettings(seed, synthesis.MeshSettings(vertices, stretch))
    with progress_bar(quiet=quiet) as progress:
        folder = synthesis.synthesize_people(output, n_bodies, settings, processes=processes, progress=progress)
    if not quiet:
        typer.echo(folder.root)
