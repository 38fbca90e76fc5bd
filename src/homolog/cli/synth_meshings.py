"""``homolog synth meshings``: other meshings of the shapes of a dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import homolog
from homolog.cli.options import INPUT, ClusterOption, DatasetOption, Processes, Quiet, ResumedOutput, Seed, workers
from homolog.cli.progress import progress_bar
from homolog.cli.synth_options import Stretch, Vertices
from homolog.core.choices import Split


def meshings(
    data: Annotated[
        Path,
        typer.Argument(metavar="DATA", help="A dataset's folder, or one with off/ and corres/.", show_default=False),
    ],
    dataset: DatasetOption = None,
    split: Annotated[Split, typer.Option(help="Which shapes.", rich_help_panel=INPUT)] = "test",
    output: ResumedOutput = Path("meshings"),
    vertices: Vertices = 5000,
    stretch: Stretch = 3.0,
    seed: Seed = 0,
    processes: Processes = None,
    cluster: ClusterOption = None,
    quiet: Quiet = False,
) -> None:
    """Mesh the shapes of a dataset anew, with triangles that are longer than wide, and keep its ground truth.

    The shapes must be closed; they may touch themselves. Line i of a .vts file is the vertex that is nearest to where
    template point i lies on the new mesh, and DIR/truth/NAME.npz has that place itself. The same seed gives the same
    bytes, and the same command resumes where it was stopped.

    Examples:
      homolog synth meshings FAUST_r --dataset faust_r --seed 1 -o FAUST_stretched

      homolog evaluate FAUST_stretched --weights people
    """
    synthesis = homolog.synthesis
    with progress_bar(quiet=quiet) as progress:
        synthesis.write_meshings(
            data,
            output,
            description=homolog.datasets.read_description(dataset) if dataset else None,
            split=split,
            settings=synthesis.MeshSettings(vertices, stretch),
            seed=seed,
            processes=workers(processes, cluster),
            progress=progress,
        )
    if not quiet:
        typer.echo(output)
