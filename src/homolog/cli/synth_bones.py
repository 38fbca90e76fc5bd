"""``homolog synth bones``: datasets of synthetic bones with ground truth."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

import homolog
from homolog.cli.options import ClusterOption, Processes, Quiet, ResumedOutput, Seed, Verbose, workers
from homolog.cli.synth_options import NBodies, Stretch, TurnOption, Vertices, make_bodies
from homolog.core.choices import Bone


def bones(
    output: ResumedOutput = Path("bones"),
    bone: Annotated[Bone, typer.Option(help="Which bone.")] = "femur",
    n_bodies: NBodies = 400,
    turn: TurnOption = "any",
    vertices: Vertices = 5000,
    stretch: Stretch = 1.0,
    seed: Seed = 0,
    processes: Processes = None,
    cluster: ClusterOption = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Make synthetic bones of the pelvis and the left leg, each of another person, with its own mesh.

    Needs the extra `synth`. They are samples of a statistical model of the bones of 26 people, in millimetres. With
    --turn none they are +y up and face +z. Writes DIR/off/NAME.off and DIR/corres/NAME.vts, which train and evaluate
    read, and DIR/barycentric, DIR/records, DIR/template and DIR/manifest.json. The same command resumes where it was
    stopped; a larger -n adds bones.

    Examples:
      homolog synth bones --bone femur -n 100 -o femurs

      homolog synth bones --bone hip --turn none --seed 1 -o hips
    """
    make_bodies(
        partial(homolog.synthesis.synthesize_bones, bone=bone, turn=turn),
        output,
        n_bodies,
        vertices=vertices,
        stretch=stretch,
        seed=seed,
        processes=workers(processes, cluster),
        quiet=quiet,
        verbose=verbose,
    )
