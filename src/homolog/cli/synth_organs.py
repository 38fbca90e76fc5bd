"""``homolog synth organs``: a dataset with ground truth from one shape of one's own."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

import homolog
from homolog.cli.options import (
    INPUT,
    ClusterOption,
    Processes,
    Quiet,
    ResumedOutput,
    Seed,
    Verbose,
    check_inputs,
    workers,
)
from homolog.cli.synth_options import NBodies, Stretch, TurnOption, Vertices, make_bodies


def organs(
    file: Annotated[
        Path,
        typer.Option(
            "--from",
            metavar="SHAPE",
            help="A mesh of an organ, a bone or anything else that is one closed surface.",
            show_default=False,
            rich_help_panel=INPUT,
        ),
    ],
    output: ResumedOutput = Path("organs"),
    n_bodies: NBodies = 400,
    strength: Annotated[
        float, typer.Option(metavar="FACTOR", help="How much the variants differ from SHAPE.", min=0.0, max=2.0)
    ] = 1.0,
    turn: TurnOption = "any",
    vertices: Vertices = 5000,
    stretch: Stretch = 1.0,
    seed: Seed = 0,
    processes: Processes = None,
    cluster: ClusterOption = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Make a training set from one shape of your own: variants that are warped smoothly, each with its own mesh.

    A warp stretches the shape along three axes and lets it flow unevenly; it folds nothing. Variants are in the units
    of SHAPE, and SHAPE's terms hold for them. Writes DIR/off/NAME.off and DIR/corres/NAME.vts, which train and evaluate
    read, and DIR/barycentric, DIR/records, DIR/template and DIR/manifest.json. The same command resumes where it was
    stopped; a larger -n adds variants.

    Examples:
      homolog synth organs --from liver.ply -n 100 -o livers

      homolog synth organs --from vertebra.stl --strength 0.5 --turn none -o vertebrae
    """
    check_inputs(file)
    make_bodies(
        partial(homolog.synthesis.synthesize_organs, file, strength=strength, turn=turn),
        output,
        n_bodies,
        vertices=vertices,
        stretch=stretch,
        seed=seed,
        processes=workers(processes, cluster),
        quiet=quiet,
        verbose=verbose,
    )
