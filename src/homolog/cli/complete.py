"""``homolog complete``: the whole shape of a fragment, by the shape model of a collection."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import homolog
from homolog.cli.match import counted, has_choice
from homolog.cli.options import (
    INPUT,
    METHOD,
    DeviceOption,
    MethodOption,
    NoCache,
    OrientOption,
    Quiet,
    ResultOutput,
    Verbose,
    Weights,
    build_matcher,
    check_folder,
    check_inputs,
    set_verbosity,
)
from homolog.cli.progress import progress_bar, say, tell_files
from homolog.cli.wording import in_options
from homolog.core.choices import System, Up
from homolog.core.progress import Timings

# Those of a match but for writing, and the fit.
_STEPS = 12


def complete(
    fragment: Annotated[
        Path, typer.Argument(metavar="FRAGMENT", help="A part of a shape: a mesh or a cloud.", show_default=False)
    ],
    model: Annotated[
        Path,
        typer.Option(
            metavar="DIR",
            help="A folder that homolog collection wrote, of shapes like the whole one.",
            show_default=False,
            rich_help_panel=INPUT,
        ),
    ],
    up: Annotated[Up, typer.Option(help="The axis that points up in the fragment.", rich_help_panel=INPUT)] = "y",
    orient: OrientOption = "auto",
    landmarks: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Points that are known on the fragment, by the names of the collection's landmarks: .csv, .mrk.json, "
            ".fcsv, or scalismo's .json.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    axes: Annotated[
        System | None,
        typer.Option(
            help="The fragment's coordinate system, for landmark files that have one.",
            show_default="as the fragment's file says, or LPS",
            rich_help_panel=INPUT,
        ),
    ] = None,
    scale: Annotated[
        bool,
        typer.Option("--scale", help="The whole may have another size than the model's shapes.", rich_help_panel=INPUT),
    ] = False,
    uncertainty: Annotated[
        float | None,
        typer.Option(
            metavar="LENGTH",
            help="Standard deviation of the fragment's points around what the model can show, in units of the file.",
            show_default="what leaving shapes out of the collection tells",
            min=1e-12,
            rich_help_panel=METHOD,
        ),
    ] = None,
    method: MethodOption = "auto",
    weights: Weights = None,
    output: ResultOutput = Path("completed"),
    device: DeviceOption = "auto",
    no_cache: NoCache = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Complete a fragment or a partial scan by a shape model, and say how far each point may be off.

    The fragment is matched with the model's mean in any pose. Then the likeliest shape of the model and its place on
    the fragment are found together, with the standard deviation of each point. The fragment must be in the unit of the
    collection.

    Writes DIR/completed.ply (the whole shape in the fragment's coordinates, in a heat map of the deviations, with the
    properties deviation and observed), DIR/points.csv (the same as a table), DIR/landmarks.csv (the landmarks that the
    collection was made with, given or imputed, each with its deviation) and DIR/completion.json.

    Examples:
      homolog complete fragment.ply --model bones -o whole

      homolog complete scan.ply --model skulls -o whole --landmarks known.mrk.json

      homolog complete half.stl --model femurs -o whole --orient given
    """
    set_verbosity(quiet=quiet, verbose=verbose)
    check_inputs(fragment, weights=weights)
    models = homolog.shape_models
    check_folder(output, names=models.COMPLETION_FILES)
    stored = models.StoredModel.read(model)
    with progress_bar(quiet=quiet) as progress:
        timings = Timings(listener=counted(progress, _STEPS + has_choice(weights, method), verbose=verbose))
        shape = homolog.read_shape(fragment)
        matcher = None if orient == "given" else build_matcher(weights, method, device, no_cache=no_cache)
        found = models.complete(
            shape,
            stored,
            matcher,
            settings=models.ModelFitSettings(scale=scale),
            uncertainty=uncertainty,
            up=up,
            orient=orient,
            landmarks=landmarks,
            axes=axes,
            timings=timings,
        )
        paths = models.write_completion(output, found, files=[fragment])
    if not quiet:
        for warning in found.warnings:
            say(f"Warning: {in_options(warning)}")
        figures = found.figures()
        say(
            f"{figures['observed_points']} of {figures['points']} points lie on the fragment; the others are expected "
            f"within {figures['missing_deviation'] or 0:.3g} (root mean square) of where they are."
        )
        tell_files(paths)
