"""``homolog collection``: one template registered to many shapes, and their shape model."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

import homolog
from homolog.cli.options import (
    INPUT,
    METHOD,
    OUTPUT,
    ClusterOption,
    ClutterOption,
    DeviceOption,
    MethodOption,
    NoCache,
    OrientOption,
    Processes,
    Quiet,
    ResumedOutput,
    Seed,
    UpOfAll,
    UseProxyOption,
    Verbose,
    Weights,
    build_matcher,
    check_folder,
    check_inputs,
    described,
    device_of,
    set_verbosity,
    workers,
)
from homolog.cli.progress import progress_bar, say, say_error, tell_files
from homolog.cli.wording import in_options
from homolog.core.choices import System, Up

if TYPE_CHECKING:
    from homolog.pairs import Candidate
    from homolog.shape_models import BuiltModel

Collected = Literal["template", "shapes", "both"]


def collection(
    template: Annotated[
        Path,
        typer.Argument(metavar="TEMPLATE", help="The shape that is registered to all others.", show_default=False),
    ],
    shapes: Annotated[
        list[Path] | None, typer.Argument(metavar="SHAPES...", help="Meshes and point clouds.", show_default=False)
    ] = None,
    listed: Annotated[
        Path | None,
        typer.Option(
            "--list",
            metavar="FILE",
            help="A text file with the path of a shape on each line, from its own folder on, for more shapes than a "
            "command line holds.",
            show_default=False,
            rich_help_panel=INPUT,
        ),
    ] = None,
    as_cloud: Annotated[
        Collected | None,
        typer.Option(
            help="Use only the points of the template, of the shapes, or of both; faces are still written.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    up: UpOfAll = "y",
    template_up: Annotated[
        Up | None,
        typer.Option(help="The axis that points up in the template, if it differs.", rich_help_panel=INPUT),
    ] = None,
    orient: OrientOption = "auto",
    clutter: ClutterOption = "remove",
    proxy: UseProxyOption = "auto",
    strict: Annotated[
        bool,
        typer.Option("--strict", help="Refuse shapes with anything to repair or to warn of.", rich_help_panel=INPUT),
    ] = False,
    method: MethodOption = "auto",
    weights: Weights = None,
    adapt: Annotated[
        int,
        typer.Option(
            metavar="STEPS",
            help="Train a copy of the weights on all shapes at once for so many steps, and use it for the shapes whose "
            "maps then contradict themselves less; 0 for none.",
            min=0,
            rich_help_panel=METHOD,
        ),
    ] = 0,
    landmarks: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Landmarks on the template, to be carried to all shapes: .csv, .mrk.json, .fcsv, or scalismo's .json.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    axes: Annotated[
        System | None,
        typer.Option(
            help="The shapes' coordinate system, for landmark files that have one.",
            show_default="as the shapes' files say, or LPS",
            rich_help_panel=INPUT,
        ),
    ] = None,
    symmetry: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="The folder that homolog symmetry wrote of the template: take the shapes apart into symmetric and "
            "asymmetric components.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    template_mask: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="How much each point of the template counts, as --source-mask of homolog match has it. Points with 0 "
            "are neither matched nor counted, and follow the others; others count by their number in the alignment.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    masks: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Masks of shapes, such as of scan edges: files named as their shapes. Shapes without one count fully.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    output: ResumedOutput = Path("collection"),
    scale: Annotated[
        bool,
        typer.Option("--scale", help="Remove size as well before the modes are computed.", rich_help_panel=OUTPUT),
    ] = False,
    seed: Seed = 0,
    processes: Processes = None,
    cluster: ClusterOption = None,
    device: DeviceOption = "auto",
    no_cache: NoCache = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Register a template to many shapes, and compute their statistical shape model.

    Needs the extra `collection`. Writes DIR/shapes/NAME.ply (the template's points, registered smoothly to each
    shape's surface, in its own coordinates), DIR/matches/NAME (the match that led there), DIR/points.npy (shapes,
    points, 3), DIR/quality.csv (a row per shape), DIR/contact_sheet.png (the worst first), DIR/model (the mean, the
    principal modes, curves, and modes.html to drag through), DIR/shapeworks and DIR/scalismo (for these programs), and
    DIR/report.json. By default one choice of weights, or of a method without any, is made for all shapes. With
    --landmarks also DIR/landmarks (a file per shape, in the given format) and DIR/landmarks.csv (all of them), with
    --symmetry DIR/symmetry (both components, and how asymmetric each shape is). `homolog view DIR --shape NAME` shows
    the match of a shape.

    The same command resumes where it was stopped, and redoes what changed; more shapes can be given then. A shape that
    cannot be matched is one line on stderr and in quality.csv; the others are still written, and the exit code is 2.

    Examples:
      homolog collection template.ply scans/*.ply -o people

      homolog collection femur.stl femurs/*.stl -o femurs_model --weights femurs.safetensors --up z

      homolog collection femur.stl --list femurs.txt -o femurs_model --cluster auto

      homolog collection skull.ply skulls/*.ply -o skulls_model --landmarks skull.mrk.json

      homolog collection skull.ply skulls/*.ply -o skulls_model --symmetry skull-symmetry

      homolog collection skull.ply skulls/*.ply -o skulls_model --template-mask no-teeth.npy --masks skull-masks

      homolog collection character.glb scans/*.ply -o characters --proxy always --clutter keep

      homolog collection lung.csv lungs/*.csv -o lungs_model --method registration --up z --scale
    """
    set_verbosity(quiet=quiet, verbose=verbose)
    check_inputs(template, weights=weights)
    models = homolog.shape_models
    models.check_extra()
    check_folder(output)
    settings = models.ShapeModelSettings(
        template_up=template_up or up,
        shapes_up=up,
        template_as_cloud=as_cloud in ("template", "both"),
        shapes_as_cloud=as_cloud in ("shapes", "both"),
        orient=orient,
        clutter=clutter,
        proxy=proxy,
        strict=strict,
        adapt=adapt,
        template_mask=homolog.pairs.mask_of(template_mask, "template_mask"),
    )
    model = models.ModelSettings(scale=scale, seed=seed, template_up=template_up or up, shapes_up=up)
    make_matcher = partial(build_matcher, weights, method, device_of(device, cluster), no_cache=no_cache)
    matcher = make_matcher()
    report = {"command": ["homolog", *sys.argv[1:]], **described(matcher, warnings="warnings_of_all")}
    known: Any = {"landmarks": landmarks, "axes": axes, "symmetry": symmetry, "masks": masks}
    with progress_bar(quiet=quiet) as progress:
        built = models.build(
            template,
            [*(shapes or ()), *models.listed_files(listed)],
            output,
            make_matcher,
            settings=settings,
            model=model,
            **known,
            processes=workers(processes, cluster),
            progress=progress,
            listener=say_error,
            report=report,
        )
    if not quiet:
        _summary(built, matcher.warnings)
    if any(outcome.error for outcome in built.outcomes):
        raise typer.Exit(2)


def _of_choice(choice: Sequence[Candidate]) -> str:
    """Which features or method all shapes are matched by, and what the others had."""
    best, *others = choice
    if best.misfit is None and best.map_misfit is None:
        return f"All shapes are matched by {best.name}: they are nearly rigid copies."
    if best.map_misfit is None:
        return f"All shapes are matched with the weights {best.name}, which know them best (misfit {best.misfit:.2f})."
    told = ", ".join(f"{each.name} {each.map_misfit:.2f}" for each in others if each.map_misfit is not None)
    if not told:
        why = f"its maps hardly contradict themselves (misfit {best.map_misfit:.2f})"
    else:
        why = f"its maps have the least misfit, {best.map_misfit:.2f} ({told})"
    return f"All shapes are matched by {best.name}: {why}."


def _summary(built: BuiltModel, warnings_of_all: Iterable[str]) -> None:
    folder, outcomes = built.folder, built.outcomes
    for warning in (*warnings_of_all, *built.warnings):
        say(f"Warning: {in_options(warning)}")
    if choice := folder.choice():
        say(_of_choice(choice))
    registered = [outcome for outcome in outcomes if not outcome.error]
    adapted = [outcome.figures.adapted for outcome in registered if outcome.figures is not None]
    if any(kept is not None for kept in adapted):
        say(f"Maps by the adapted weights are kept for {sum(map(bool, adapted))} of {len(adapted)} shapes.")
    warned = [outcome for outcome in registered if outcome.warnings]
    for outcome in warned:
        for warning in outcome.warnings:
            say(f"Warning: {outcome.subject.name}: {in_options(warning)}")
    others = folder.others([outcome.subject for outcome in outcomes])
    if others:
        say(f"Not given this time, and not counted: {len(others)} of the shapes in {folder.root / 'shapes'}.")
    most_shown = homolog.shape_models.MOST_SHOWN
    if len(outcomes) > most_shown:
        say(f"contact_sheet.png shows the worst {most_shown} of {len(outcomes)} shapes.")
    failed = len(outcomes) - len(registered)
    say(f"Registered {len(registered)} of {len(outcomes)} shapes: {failed} failed, {len(warned)} with warnings.")
    tell_files(built.files)
