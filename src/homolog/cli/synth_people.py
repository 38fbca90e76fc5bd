"""``homolog synth people``: datasets of synthetic people with ground truth."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

import homolog
from homolog.cli.options import ClusterOption, Processes, Quiet, ResumedOutput, Seed, Verbose, workers
from homolog.cli.synth_options import NBodies, Stretch, Vertices, make_bodies
from homolog.core.choices import Poses


def people(
    output: ResumedOutput = Path("people"),
    n_bodies: NBodies = 500,
    vertices: Vertices = 5000,
    stretch: Stretch = 1.0,
    poses: Annotated[
        Poses, typer.Option(help="natural, or wide: of gymnasts, and of people who lie, crawl or fall.")
    ] = "natural",
    seed: Seed = 0,
    processes: Processes = None,
    cluster: ClusterOption = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Make synthetic people of any age, sex and build in any pose, each with its own mesh.

    Needs the extra `synth`. Writes DIR/off/NAME.off and DIR/corres/NAME.vts, which train and evaluate read, and
    DIR/barycentric, DIR/records, DIR/template and DIR/manifest.json: barycentric coordinates on the common template,
    how each body was made, and licences. The same command resumes where it was stopped; a larger -n adds bodies.

    Examples:
      homolog synth people -n 500 -o people

      homolog synth people -n 500 -o stretched --stretch 3 --seed 1

      homolog synth people -n 500 -o gymnasts --poses wide

      homolog train people -o run
    """
    make_bodies(
        partial(homolog.synthesis.synthesize_people, poses=poses),
        output,
        n_bodies,
        vertices=vertices,
        stretch=stretch,
        seed=seed,
        processes=workers(processes, cluster),
        quiet=quiet,
        verbose=verbose,
    )
