"""``homolog synth views``: datasets of partial views of full shapes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import homolog
from homolog.cli.options import ClusterOption, Processes, Quiet, ResumedOutput, Seed, workers
from homolog.cli.progress import progress_bar


def views(
    data: Annotated[
        Path,
        typer.Argument(
            metavar="DATA", help="A folder of full meshes, or one with off/ and perhaps corres/.", show_default=False
        ),
    ],
    output: ResumedOutput = Path("views"),
    n_views: Annotated[
        int,
        typer.Option(
            "--n-views", "-n", metavar="N", help="How many views, or pairs of them; a fifth is for testing.", min=5
        ),
    ] = 5000,
    apart: Annotated[
        float | None,
        typer.Option(
            metavar="DEGREES",
            help="Pair each view with another one of the same shape, from a camera so many degrees apart.",
            show_default=False,
        ),
    ] = None,
    two_shapes: Annotated[
        bool, typer.Option("--two-shapes", help="With --apart: the second camera looks at another shape.")
    ] = False,
    distance: Annotated[
        tuple[float, float],
        typer.Option(metavar="LOW HIGH", help="Distance of the camera, in radii of the shape's bounding sphere."),
    ] = (2.0, 4.0),
    elevation: Annotated[
        tuple[float, float], typer.Option(metavar="LOW HIGH", help="Elevation of the camera, in degrees.")
    ] = (-15.0, 45.0),
    pixels: Annotated[
        tuple[int, int], typer.Option(metavar="WIDTH HEIGHT", help="Size of the depth images that give the clouds.")
    ] = (240, 180),
    noise: Annotated[
        float, typer.Option(metavar="SIGMA", help="Noise of the clouds' depths, in units of sqrt(area).", min=0.0)
    ] = 0.0,
    seed: Seed = 0,
    processes: Processes = None,
    cluster: ClusterOption = None,
    quiet: Quiet = False,
) -> None:
    """Make a dataset of partial views of full meshes, with ground truth.

    Each view is a mesh and a depth camera's cloud, and is paired with a full shape, or with another view (--apart).
    Four fifths of the bodies, and of the views, are for training; the others for testing. The same seed gives the same
    bytes, and the same command resumes where it was stopped. The shapes must stand +y up.

    Examples:
      homolog synth views people -n 5000 --seed 1 -o people_views --processes 8

      homolog synth views people -n 100 --apart 60 -o people_pairs

      homolog evaluate people_views --dataset views --modality mesh-to-cloud --weights views.safetensors
    """
    synthesis = homolog.synthesis
    settings = synthesis.ViewSettings(distance=distance, elevation=elevation, pixels=pixels, noise=noise)
    with progress_bar(quiet=quiet) as progress:
        synthesis.write_view_dataset(
            data,
            output,
            views=n_views,
            seed=seed,
            settings=settings,
            apart=apart,
            two_shapes=two_shapes,
            processes=workers(processes, cluster),
            progress=progress,
        )
    if not quiet:
        typer.echo(output)
