"""``homolog synth views``: a set of partial views of complete shapes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from homolog.cli.options import ONE_PER_CORE, Processes, Quiet
from homolog.cli.progress import progress_bar
from homolog.synthesis import ViewSettings, write_view_dataset


def views(
    data: Annotated[
        Path,
        typer.Argument(
            metavar="SET", help="A folder of complete meshes, or one with off/ and perhaps corres/.", show_default=False
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="A new folder, or one to go on with.")
    ] = Path("views"),
    number: Annotated[int, typer.Option("--number", "-n", help="Views; a fifth of them for testing.", min=5)] = 5000,
    seed: Annotated[int, typer.Option(help="Of all that is drawn.", min=0)] = 0,
    distance: Annotated[
        tuple[float, float], typer.Option(help="Least and most, in radii of the sphere around the shape.")
    ] = (2.0, 4.0),
    elevation: Annotated[
        tuple[float, float], typer.Option(help="Lowest and highest place of the camera, in degrees.")
    ] = (-15.0, 45.0),
    pixels: Annotated[tuple[int, int], typer.Option(help="Width and height of the clouds' images.")] = (240, 180),
    noise: Annotated[float, typer.Option(help="Noise of clouds' depths, in units of sqrt(area).", min=0.0)] = 0.0,
    processes: Processes = ONE_PER_CORE,
    quiet: Quiet = False,
) -> None:
    """Make a set of views of complete meshes, each as a mesh and as a depth camera's cloud, paired with one of
    the bodies.

    Four fifths of the bodies, and of the views, are for training; the others for testing. The same seed gives the same
    bytes, and the same command goes on where it was interrupted. The shapes must stand +y up.

    Examples:
      homolog synth views people -n 5000 --seed 1 -o people_views --processes 8

      homolog evaluate people_views --dataset views --modality mesh-to-cloud --weights views.safetensors
    """
    settings = ViewSettings(distance=distance, elevation=elevation, pixels=pixels, noise=noise)
    with progress_bar(quiet=quiet) as progress:
        write_view_dataset(
            data, output, views=number, seed=seed, settings=settings, processes=processes, progress=progress
        )
    if not quiet:
        typer.echo(output)
