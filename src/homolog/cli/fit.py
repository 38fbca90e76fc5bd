"""``homolog fit``: the parameters of a body model under a scan."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

import homolog
from homolog.cli.match import counted
from homolog.cli.options import (
    INPUT,
    METHOD,
    ClutterOption,
    DeviceOption,
    NoCache,
    OrientOption,
    Quiet,
    ResultOutput,
    Verbose,
    build_matcher,
    check_folder,
    check_inputs,
    set_verbosity,
)
from homolog.cli.progress import progress_bar, say, tell_files
from homolog.cli.wording import in_options
from homolog.core.choices import Up
from homolog.core.progress import Timings

# Those of a match but for writing.
_STEPS = 11


def fit(
    scan: Annotated[
        Path, typer.Argument(metavar="SCAN", help="A mesh or a point cloud of a person.", show_default=False)
    ],
    model: Annotated[
        Literal["people"], typer.Option("--model", help="The model: that of homolog synth people.")
    ] = "people",
    unit: Annotated[
        Literal["auto", "m", "cm", "mm", "free"],
        typer.Option(
            "--unit",
            help="Of the scan's coordinates. auto: told by its size. free: none of these, so that the scale is fitted.",
            rich_help_panel=INPUT,
        ),
    ] = "auto",
    partial: Annotated[
        bool,
        typer.Option(
            "--partial/--full",
            help="The scan is a partial view or a part of a person: what is not there follows from the model.",
            rich_help_panel=INPUT,
        ),
    ] = False,
    up: Annotated[Up, typer.Option(help="The axis that points up in the file.", rich_help_panel=INPUT)] = "y",
    orient: OrientOption = "auto",
    clutter: ClutterOption = "remove",
    weights: Annotated[
        str | None,
        typer.Option(
            "--weights",
            metavar="NAME|FILE",
            help="Trained weights to match the scan with the model.",
            show_default="people, or views with --partial",
            rich_help_panel=METHOD,
        ),
    ] = None,
    output: ResultOutput = Path("fit"),
    device: DeviceOption = "auto",
    no_cache: NoCache = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Fit the body model of synthetic people to a scan of a person, in any pose and any way round.

    The scan is matched with the model's template; then sex, age, build and the rotations of all bones are fitted to
    the map, and to the scan's surface. Needs the extra `synth`; the model's first use on a machine takes minutes.

    Writes DIR/parameters.json (the parameters), DIR/registered.ply (the model's mesh in the scan's coordinates and
    units) and DIR/distances.npy (the distance of each of its points from the scan).

    Examples:
      homolog fit scan.ply -o body

      homolog fit scan.obj --unit cm --up z -o body

      homolog fit depth.ply --partial -o body
    """
    set_verbosity(quiet=quiet, verbose=verbose)
    check_inputs(scan, weights=weights)
    check_folder(output, names=homolog.fitting.FIT_FILES)
    with progress_bar(quiet=quiet) as progress:
        timings = Timings(listener=counted(progress, _STEPS + 1, verbose=verbose))
        with timings.measure(f"read the model {model}"):
            body = homolog.fitting.PeopleModel()
        matcher = build_matcher(weights or ("views" if partial else "people"), "auto", device, no_cache=no_cache)
        options: dict[str, Any] = {"orient": orient, "clutter": clutter, "target_up": up}
        options["partial"] = "target" if partial else None
        match = matcher.match(body.template, scan, timings=timings, **options)
        found = homolog.fitting.fit_to_match(match, body, unit=unit, progress=progress)
        paths = homolog.fitting.write_fit(output, found)
    if not quiet:
        _summary(found, paths)


def _summary(found: homolog.fitting.BodyFit, paths: list[Path]) -> None:
    for warning in found.warnings:
        say(f"Warning: {in_options(warning)}")
    unit = f"in {found.unit}" if found.unit != "free" else "in a unit of its own: the height is no metric one"
    if not found.seen.all():
        say(f"{found.seen.sum()} of the model's {len(found.seen)} points are on the scan; the others follow from it.")
    say(f"The body lies {1000 * found.mean_distance:.1f} mm from the scan on average; the scan is {unit}.")
    say("Parameters: " + ", ".join(f"{name} {value:.2f}" for name, value in found.parameters.items()) + ".")
    tell_files(paths)
