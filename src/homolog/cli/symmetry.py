"""``homolog symmetry``: mirror partners, the mirror plane, and how asymmetric a shape is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import homolog
from homolog.cli.match import counted, has_choice
from homolog.cli.options import (
    INPUT,
    PICTURE_WIDTH,
    ClutterOption,
    DeviceOption,
    Lines,
    MethodOption,
    NoCache,
    OrientOption,
    Page,
    Picture,
    PictureWidth,
    Quiet,
    ResultOutput,
    Verbose,
    Weights,
    build_matcher,
    check_folder,
    check_inputs,
    check_page_file,
    check_picture_file,
    set_verbosity,
)
from homolog.cli.progress import progress_bar, say, tell_files
from homolog.cli.wording import in_options
from homolog.core.choices import Up
from homolog.core.progress import Timings

# Those of a match but for writing, and the smooth map with all that is measured on it.
_STEPS = 14


def symmetry(
    shape: Annotated[Path, typer.Argument(metavar="SHAPE", help="A mesh or a point cloud.", show_default=False)],
    as_cloud: Annotated[
        bool, typer.Option("--as-cloud", help="Use only the points of the shape.", rich_help_panel=INPUT)
    ] = False,
    up: Annotated[Up, typer.Option(help="The axis that points up in the file.", rich_help_panel=INPUT)] = "y",
    orient: OrientOption = "auto",
    clutter: ClutterOption = "remove",
    mask: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Points that count, 0 to leave one out: .npy, .txt or .csv with a number per point, or .ply with the "
            "property mask or weight, or painted black and white.",
            show_default=False,
            rich_help_panel=INPUT,
        ),
    ] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Stop at anything to repair or to warn of.", rich_help_panel=INPUT)
    ] = False,
    method: MethodOption = "auto",
    weights: Weights = None,
    output: ResultOutput = Path("symmetry"),
    page: Page = None,
    picture: Picture = None,
    lines: Lines = 0,
    picture_width: PictureWidth = PICTURE_WIDTH,
    device: DeviceOption = "auto",
    no_cache: NoCache = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Find the mirror partner of every point of a shape, its mirror plane, and how asymmetric it is.

    The shape is matched with its own mirror image, so that a bent body has partners as well.

    Writes DIR/points.csv (for each point its partner and its asymmetry), DIR/asymmetry.ply and DIR/stretch.ply (heat
    maps), DIR/mirrored.ply (the shape reflected, its points numbered as in its file) and DIR/symmetry.json.

    Examples:
      homolog symmetry skull.ply -o skull-symmetry

      homolog symmetry dancer.obj -o result --weights people --html result.html

      homolog symmetry vertebra.stl -o result --method registration
    """
    set_verbosity(quiet=quiet, verbose=verbose)
    check_inputs(shape, weights=weights)
    check_folder(output, names=homolog.symmetries.SYMMETRY_FILES)
    check_page_file(page)
    check_picture_file(picture, lines, picture_width)
    options = {"orient": orient, "clutter": clutter, "strict": strict}
    words = homolog.symmetries.mirror_words(up=up, as_cloud=as_cloud, mask=mask, **options)
    with progress_bar(quiet=quiet) as progress:
        timings = Timings(listener=counted(progress, _STEPS + has_choice(weights, method), verbose=verbose))
        matcher = build_matcher(weights, method, device, no_cache=no_cache)
        match = matcher.match(shape, shape, timings=timings, **words)
        with timings.measure("symmetry"):
            found = homolog.symmetries.Symmetry.of(match)
        paths = homolog.symmetries.write_symmetry(output, found)
    if page is not None or picture is not None:
        scene = homolog.symmetries.scene_of_symmetry(found)
        if page is not None:
            homolog.viewing.write_page(page, scene)
        if picture is not None:
            homolog.viewing.write_picture(picture, scene, width=picture_width, lines=lines)
        paths += [path for path in (page, picture) if path is not None]
    if not quiet:
        _summary(found, paths)


def _summary(found: homolog.symmetries.Symmetry, paths: list[Path]) -> None:
    for warning in found.warnings:
        say(f"Warning: {in_options(warning)}")
    figures = found.figures()
    normal = ", ".join(f"{value:.4f}" for value in found.plane.normal)
    say(f"Mirror plane: normal ({normal}), offset {found.plane.offset:.6g}, in the coordinates of the file.")
    say(
        f"Asymmetry: {figures['asymmetry']['mean']:.4g} on average, {100 * figures['asymmetry_of_size']:.1f} % of the "
        f"shape's size; lengths differ by {100 * (figures['stretch']['mean'] - 1):.1f} %."
    )
    if figures["asymmetry_of_size"] > homolog.symmetries.BENT:
        say("Note: the shape is bent to one side, so that the stretch tells more of its form than the asymmetry.")
    tell_files(paths)
