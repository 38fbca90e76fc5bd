"""``homolog synth hands``: datasets of synthetic hands with ground truth."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

import homolog
from homolog.cli.options import ClusterOption, Processes, Quiet, ResumedOutput, Seed, Verbose, workers
from homolog.cli.synth_options import NBodies, Stretch, Vertices, make_bodies
from homolog.core.choices import HandSides


def hands(
    output: ResumedOutput = Path("hands"),
    n_bodies: NBodies = 400,
    vertices: Vertices = 5000,
    stretch: Stretch = 1.0,
    sides: Annotated[
        HandSides, typer.Option(help="left, right, or both: every second individual is a right hand.")
    ] = "both",
    seed: Seed = 0,
    processes: Processes = None,
    cluster: ClusterOption = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Make synthetic hands of any age and build in many poses, cut at the wrist, each with its own mesh.

    Needs the extra `synth`. Four in a row are one individual in different poses; every second one is open at the wrist.
    Fingers point to +y and thumbs to +x, of right hands as well, which are mirror images. Writes DIR/off/NAME.off and
    DIR/corres/NAME.vts, which train and evaluate read, and DIR/barycentric, DIR/records, DIR/template and
    DIR/manifest.json. The same command resumes where it was stopped; a larger -n adds hands.

    Examples:
      homolog synth hands -n 400 -o hands

      homolog synth hands -n 40 --sides left --seed 1 -o left_hands
    """
    make_bodies(
        partial(homolog.synthesis.synthesize_hands, sides=sides),
        output,
        n_bodies,
        vertices=vertices,
        stretch=stretch,
        seed=seed,
        processes=workers(processes, cluster),
        quiet=quiet,
        verbose=verbose,
    )
