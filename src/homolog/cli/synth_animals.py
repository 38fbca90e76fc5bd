"""``homolog synth animals``: datasets of synthetic animals with ground truth."""

from __future__ import annotations

from pathlib import Path

import homolog
from homolog.cli.options import ClusterOption, Processes, Quiet, ResumedOutput, Seed, Verbose, workers
from homolog.cli.synth_options import NBodies, Stretch, Vertices, make_bodies


def animals(
    output: ResumedOutput = Path("animals"),
    n_bodies: NBodies = 400,
    vertices: Vertices = 5000,
    stretch: Stretch = 1.0,
    seed: Seed = 0,
    processes: Processes = None,
    cluster: ClusterOption = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Make synthetic animals with four legs: two dozen species and mixtures of them, each body with its own mesh.

    Four bodies in a row are one individual in different poses. Writes DIR/off/NAME.off and DIR/corres/NAME.vts, which
    train and evaluate read, and DIR/barycentric, DIR/records, DIR/template and DIR/manifest.json: barycentric
    coordinates on the common template, how each body was made, and licences. The same command resumes where it was
    stopped; a larger -n adds bodies.

    Examples:
      homolog synth animals -n 400 -o animals

      homolog train animals -o run --recipe animals
    """
    make_bodies(
        homolog.synthesis.synthesize_animals,
        output,
        n_bodies,
        vertices=vertices,
        stretch=stretch,
        seed=seed,
        processes=workers(processes, cluster),
        quiet=quiet,
        verbose=verbose,
    )
