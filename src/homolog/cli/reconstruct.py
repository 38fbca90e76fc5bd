"""``homolog reconstruct``: surfaces of point clouds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import homolog
from homolog.cli.options import OUTPUT, Quiet, check_folder
from homolog.cli.progress import progress_bar, say
from homolog.core.errors import ArgumentError, ShapeError
from homolog.core.files import expanded, resolved


def reconstruct(
    clouds: Annotated[list[Path], typer.Argument(metavar="CLOUDS...", help="Point clouds.", show_default=False)],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for the meshes.", rich_help_panel=OUTPUT)
    ] = Path("surfaces"),
    points: Annotated[
        int,
        typer.Option(
            metavar="N", help="About how many points each mesh has; 0 for all.", min=0, rich_help_panel=OUTPUT
        ),
    ] = 5000,
    resolution: Annotated[
        int,
        typer.Option(metavar="N", help="Voxels along a cloud's longest side.", min=16, rich_help_panel=OUTPUT),
    ] = 128,
    quiet: Quiet = False,
) -> None:
    """Reconstruct closed surfaces from point clouds.

    Writes DIR/NAME.ply for each cloud, in its coordinates. Needs the extra `volumes`. The points must lie all around a
    solid; normals are not needed. Gaps narrower than a cloud's widest holes are filled: organs and bones come out well,
    hands do not.

    Examples:
      homolog reconstruct lung.csv

      homolog reconstruct lungs/*.csv -o lung_surfaces

      homolog train lung_surfaces -o run

    A cloud that does not close is one line on stderr; the others are still written, and the exit code is 2.
    """
    files = _mesh_files(clouds, output)
    check_folder(output, names=[file.name for file in files])
    failed = False
    with progress_bar(quiet=quiet) as progress:
        for done, (cloud, file) in enumerate(zip(clouds, files, strict=True)):
            progress(done, len(clouds), cloud.name)
            try:
                found = homolog.volumes.reconstruct_surface(
                    homolog.read_shape(cloud), points=points or None, resolution=resolution
                )
            except ShapeError as error:
                failed = True
                say(f"Error: {error}")
                continue
            expanded(output).mkdir(parents=True, exist_ok=True)
            homolog.write_shape(file, found)
    if failed:
        raise typer.Exit(2)
    if not quiet:
        typer.echo(output)


def _mesh_files(clouds: list[Path], output: Path) -> list[Path]:
    """Where each mesh goes; no two to one file, and none over a cloud."""
    files = [output / f"{cloud.stem}.ply" for cloud in clouds]
    given = {resolved(cloud) for cloud in clouds}
    for number, file in enumerate(files):
        if file in files[:number]:
            raise ArgumentError(f"{clouds[number]} and another cloud would both give {file}; give them one at a time")
        if resolved(file) in given:
            raise ArgumentError(f"{file} is a cloud and would be replaced by its surface; give another -o")
    return files
