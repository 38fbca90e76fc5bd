"""``homolog volume``: shapes from segmentation masks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from homolog.cli.options import Quiet
from homolog.shapes import write_shape
from homolog.volumes import mask_surface, read_mask, slice_cloud

volume = typer.Typer(name="volume", no_args_is_help=True, help="Make shapes of segmentation masks.")

MaskFile = Annotated[
    Path,
    typer.Argument(metavar="MASK", help="A .mhd, .mha, .nii, .nii.gz, .nrrd or .nhdr file.", show_default=False),
]
Label = Annotated[int | None, typer.Option(help="The value of the voxels that are meant.", show_default="all but 0")]


@volume.command()
def surface(
    mask: MaskFile,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="A mesh.")] = Path("surface.ply"),
    label: Label = None,
    points: Annotated[int, typer.Option(help="About how many points; 0 for all that there are.", min=0)] = 5000,
    smoothing: Annotated[float, typer.Option(help="Blur of the mask, in voxels.", min=0.0)] = 1.0,
    quiet: Quiet = False,
) -> None:
    """Make the surface of what a mask marks, in millimetres.

    Needs the extra `volumes`. Patients lie along +z in such files: match their surfaces with --up z.

    Examples:
      homolog volume surface lungs.mhd --label 3 -o left_lung.ply

      homolog volume surface femur.nii.gz -o femur.ply --points 20000
    """
    write_shape(output, mask_surface(read_mask(mask, label=label), points=points or None, smoothing=smoothing))
    if not quiet:
        typer.echo(output)


@volume.command()
def slices(
    mask: MaskFile,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="A cloud.")] = Path("slices.ply"),
    label: Label = None,
    axis: Annotated[int, typer.Option(help="Which axis of the volume runs through the slices.", min=0, max=2)] = 2,
    every: Annotated[int, typer.Option(help="Take every so many-th slice.", min=1)] = 1,
    span: Annotated[
        tuple[float, float], typer.Option(help="Of the slices that the object is in, those between these shares.")
    ] = (0.0, 1.0),
    points: Annotated[int, typer.Option(help="How many points to keep; 0 for all.", min=0)] = 0,
    seed: Annotated[int, typer.Option(help="Of the choice of points.", min=0)] = 0,
    quiet: Quiet = False,
) -> None:
    """Make a cloud of the outlines in some slices of a mask, in millimetres.

    Needs the extra `volumes`. What lies outside the slices is missing: match such a cloud with --partial.

    Examples:
      homolog volume slices lungs.mhd --label 3 --every 4 -o lung.ply

      homolog volume slices lungs.mhd --label 3 --span 0 0.6 --points 3000 -o lower_lung.ply
    """
    found = slice_cloud(
        read_mask(mask, label=label), axis=axis, every=every, span=span, points=points or None, seed=seed
    )
    write_shape(output, found)
    if not quiet:
        typer.echo(output)
