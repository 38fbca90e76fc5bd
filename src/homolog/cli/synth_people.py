"""``homolog synth people``: sets of bodies with ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from homolog.cli.options import ONE_PER_CORE, Processes, Quiet, Verbose, set_verbosity
from homolog.cli.progress import progress_bar
from homolog.synthesis import MeshSettings, PeopleSettings, synthesize_people


def people(
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="A new folder, or one to go on with.")
    ] = Path("people"),
    number: Annotated[int, typer.Option("--number", "-n", help="How many bodies.", min=1)] = 500,
    seed: Annotated[int, typer.Option(help="Another seed, other bodies.", min=0)] = 0,
    vertices: Annotated[int, typer.Option(help="About how many vertices each mesh has.", min=500)] = 5000,
    stretch: Annotated[
        float,
        typer.Option(
            help="How much longer than wide triangles are, in a direction of each body's own.", min=1.0, max=5.0
        ),
    ] = 1.0,
    processes: Processes = ONE_PER_CORE,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Make people of any age, sex and build in any pose, each with a mesh of its own.

    Needs the extra `synth`. Writes DIR/off/NAME.off and DIR/corres/NAME.vts, which train and evaluate read, and
    DIR/places, DIR/records, DIR/template and DIR/manifest.json: places on the common template, how each body was made,
    and licences. The same command goes on where it was stopped; a larger -n adds bodies to those that are there.

    Examples:
      homolog synth people -n 500 -o people

      homolog synth people -n 500 -o stretched --stretch 3 --seed 1

      homolog train people -o run
    """
    set_verbosity(quiet=quiet, verbose=verbose)
    settings = PeopleSettings(seed, MeshSettings(vertices, stretch))
    with progress_bar(quiet=quiet) as progress:
        folder = synthesize_people(output, number, settings, processes=processes, progress=progress)
    if not quiet:
        typer.echo(folder.root)
