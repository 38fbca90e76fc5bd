"""``homolog reconstruct``: surfaces of point clouds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from homolog.cli.options import Quiet, check_folder
from homolog.cli.progress import progress_bar, say
from homolog.core.errors import ArgumentError, ShapeError
from homolog.core.files import expanded
from homolog.shapes import read_shape, write_shape
from homolog.volumes import reconstruct_surface


def reconstruct(
    clouds: Annotated[list[Path], typer.Argument(help="Point clouds in any format.", show_default=False)],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Where the meshes go.")] = Path(
        "surfaces"
    ),
    points: Annotated[int, typer.Option(help="About how many points each mesh has; 0 for all.", min=0)] = 5000,
    resolution: Annotated[int, typer.Option(help="Voxels along a cloud's longest side.", min=16)] = 128,
    quiet: Quiet = False,
) -> None:
    """Make closed surfaces of clouds that lie all around a solid: DIR/NAME.ply of each NAME, in its coordinates.

    Needs the extra `volumes`. Training takes meshes: this makes them where there are only points. Normals are not
    needed. What is narrower than a cloud's widest holes is filled: organs and bones come out well, hands do not.

    Examples:
      homolog reconstruct lung.csv

      homolog reconstruct lungs/*.csv -o lung_surfaces

      homolog train lung_surfaces -o run

    A cloud that does not close is one line on stderr; the others are still written, and the exit code is 2.
    """
    places = _places(clouds, output)
    check_folder(output, names=[place.name for place in places])
    failed = False
    with progress_bar(quiet=quiet) as progress:
        for done, (cloud, place) in enumerate(zip(clouds, places, strict=True)):
            progress(done, len(clouds), cloud.name)
            try:
                found = reconstruct_surface(read_shape(cloud), points=points or None, resolution=resolution)
            except ShapeError as error:
                failed = True
                say(f"Error: {error}")
                continue
            expanded(output).mkdir(parents=True, exist_ok=True)
            write_shape(place, found)
    if failed:
        raise typer.Exit(2)
    if not quiet:
        typer.echo(output)


def _places(clouds: list[Path], output: Path) -> list[Path]:
    """Where each mesh goes; no two to one file, and none over a cloud."""
    places = [output / f"{cloud.stem}.ply" for cloud in clouds]
    given = {expanded(cloud).resolve() for cloud in clouds}
    for number, place in enumerate(places):
        if place in places[:number]:
            raise ArgumentError(f"{clouds[number]} and another cloud would both give {place}; give them one at a time")
        if expanded(place).resolve() in given:
            raise ArgumentError(f"{place} is a cloud and would be replaced by its surface; give another -o")
    return places
