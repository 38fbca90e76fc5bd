"""``homolog synth heads``: datasets of synthetic heads with ground truth."""

from __future__ import annotations

from pathlib import Path

import homolog
from homolog.cli.options import ClusterOption, Processes, Quiet, ResumedOutput, Seed, Verbose, workers
from homolog.cli.synth_options import NBodies, Stretch, Vertices, make_bodies


def heads(
    output: ResumedOutput = Path("heads"),
    n_bodies: NBodies = 400,
    vertices: Vertices = 5000,
    stretch: Stretch = 1.0,
    seed: Seed = 0,
    processes: Processes = None,
    cluster: ClusterOption = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Make synthetic heads of any age and build with many expressions, cut at the neck, each with its own mesh.

    Needs the extra `synth`. Four in a row are one individual with different expressions; every second one is open at
    the neck. Writes DIR/off/NAME.off and DIR/corres/NAME.vts, which train and evaluate read, and DIR/barycentric,
    DIR/records, DIR/template and DIR/manifest.json. The same command resumes where it was stopped; a larger -n adds
    heads.

    Examples:
      homolog synth heads -n 400 -o heads

      homolog synth heads -n 40 --vertices 8000 --seed 1 -o fine_heads
    """
    make_bodies(
        homolog.synthesis.synthesize_heads,
        output,
        n_bodies,
        vertices=vertices,
        stretch=stretch,
        seed=seed,
        processes=workers(processes, cluster),
        quiet=quiet,
        verbose=verbose,
    )
