"""``homolog volume``: shapes from segmentation masks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import homolog
from homolog.cli.lazy import lazy_typer
from homolog.cli.options import OUTPUT, Quiet, Seed, check_file
from homolog.cli.progress import progress_bar

volume = lazy_typer(
    "volume",
    help="Make shapes from segmentation masks.",
    surface="homolog.cli.volume:surface",
    slices="homolog.cli.volume:slices",
)

MaskFile = Annotated[
    Path,
    typer.Argument(metavar="MASK", help="A .mhd, .mha, .nii, .nii.gz, .nrrd or .nhdr file.", show_default=False),
]
Label = Annotated[
    int | None, typer.Option(metavar="VALUE", help="The value of the voxels to take.", show_default="all but 0")
]


def surface(
    mask: MaskFile,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="The mesh to write.", rich_help_panel=OUTPUT)
    ] = Path("surface.ply"),
    label: Label = None,
    points: Annotated[int, typer.Option(metavar="N", help="About how many points; 0 for all.", min=0)] = 5000,
    smoothing: Annotated[
        float, typer.Option(metavar="SIGMA", help="Gaussian smoothing of the mask, in voxels.", min=0.0)
    ] = 1.0,
    quiet: Quiet = False,
) -> None:
    """Extract the surface of a segmentation mask as a mesh, in millimetres.

    Needs the extra `volumes`. Patients lie along +z in such files: match their surfaces with --up z.

    Examples:
      homolog volume surface lungs.mhd --label 3 -o left_lung.ply

      homolog volume surface femur.nii.gz -o femur.ply --points 20000
    """
    check_file(output)
    with progress_bar(quiet=quiet) as progress:
        progress(0, 2, "read")
        found = homolog.volumes.read_mask(mask, label=label)
        progress(1, 2, "surface")
        made = homolog.volumes.mask_surface(found, points=points or None, smoothing=smoothing)
        homolog.write_shape(output, made)
    if not quiet:
        typer.echo(output)


def slices(
    mask: MaskFile,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="The cloud to write.", rich_help_panel=OUTPUT)
    ] = Path("slices.ply"),
    label: Label = None,
    axis: Annotated[
        int, typer.Option(metavar="AXIS", help="The axis of the volume across the slices: 0, 1 or 2.", min=0, max=2)
    ] = 2,
    every: Annotated[int, typer.Option(metavar="N", help="Take every N-th slice.", min=1)] = 1,
    span: Annotated[
        tuple[float, float],
        typer.Option(metavar="LOW HIGH", help="Of the slices through the object, those between these fractions."),
    ] = (0.0, 1.0),
    points: Annotated[int, typer.Option(metavar="N", help="How many points to keep; 0 for all.", min=0)] = 0,
    seed: Seed = 0,
    quiet: Quiet = False,
) -> None:
    """Make a point cloud of the outlines in some slices of a segmentation mask, in millimetres.

    Needs the extra `volumes`. Where slices are left out the cloud is partial: match it with --partial.

    Examples:
      homolog volume slices lungs.mhd --label 3 --every 4 -o lung.ply

      homolog volume slices lungs.mhd --label 3 --span 0 0.6 --points 3000 -o lower_lung.ply
    """
    check_file(output)
    with progress_bar(quiet=quiet) as progress:
        progress(0, 2, "read")
        found = homolog.volumes.read_mask(mask, label=label)
        progress(1, 2, "slices")
        cloud = homolog.volumes.slice_cloud(found, axis=axis, every=every, span=span, points=points or None, seed=seed)
        homolog.write_shape(output, cloud)
    if not quiet:
        typer.echo(output)
