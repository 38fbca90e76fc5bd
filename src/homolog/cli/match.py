"""``homolog match``: two files in, a correspondence out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from homolog.cli.options import (
    PICTURE_WIDTH,
    Adapt,
    DeviceOption,
    Lines,
    MethodOption,
    NoCache,
    Page,
    Picture,
    PictureWidth,
    PreAligned,
    Quiet,
    Verbose,
    Weights,
    build_matcher,
    check_file,
    check_folder,
    check_picture_file,
    set_verbosity,
)
from homolog.cli.progress import ProgressOption, Report, progress_bar, say
from homolog.core.progress import Listener, Steps
from homolog.matching import RESULT_FILES, Match, Matcher, with_inputs, write_folder
from homolog.pairs import SIDES, AsCloud, PairOptions, Side
from homolog.shapes import Up
from homolog.training import AdaptationSettings, adapt_to_pair
from homolog.viewing import scene_of, write_page, write_picture

# read, repair, operators and features for each shape, the map, the check of the orientation, and writing.
STEPS = 11


def match(
    source: Annotated[Path, typer.Argument(help="The shape whose positions give the colours.", show_default=False)],
    target: Annotated[Path, typer.Argument(help="The shape to match it to.", show_default=False)],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="OUT", help="Folder for the result.")] = Path(
        "match"
    ),
    weights: Weights = None,
    method: MethodOption = "auto",
    adapt: Adapt = 0,
    as_cloud: Annotated[AsCloud | None, typer.Option(help="Use only the points of this shape.")] = None,
    partial: Annotated[
        Side | None,
        typer.Option(help="This shape is a part of one like the other, whose points may then have no match."),
    ] = None,
    partial_scale: Annotated[
        float,
        typer.Option(
            metavar="FACTOR",
            help="What the partial shape's lengths are multiplied by to be in the complete one's units.",
        ),
    ] = 1.0,
    pre_aligned: PreAligned = False,
    up: Annotated[Up, typer.Option(help="The axis that points up in both files.")] = "y",
    source_up: Annotated[Up | None, typer.Option(help="The axis that points up in the source, if it differs.")] = None,
    target_up: Annotated[Up | None, typer.Option(help="The axis that points up in the target, if it differs.")] = None,
    page: Page = None,
    picture: Picture = None,
    lines: Lines = 0,
    picture_width: PictureWidth = PICTURE_WIDTH,
    device: DeviceOption = "auto",
    strict: Annotated[bool, typer.Option("--strict", help="Stop at anything to repair or to warn of.")] = False,
    no_cache: NoCache = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    progress_form: ProgressOption = "bar",
) -> None:
    """Match two shapes: for every point of each, the corresponding point of the other.

    Writes OUT/correspondence.npz (point indices both ways and confidences), OUT/source.ply and OUT/target.ply (same
    colour, same point) and OUT/report.json.

    Examples:
      homolog match cat.off lion.obj -o result --weights animals.safetensors

      homolog match scan.ply template.obj -o result --partial source --source-up z

      homolog match part.stl whole.glb -o out --partial source --partial-scale 0.001

      homolog match a.ply b.xyz -o result --method axiomatic

      homolog match dancer.ply statue.ply -o result --html both.html --picture both.png --lines 20

      homolog match old.ply new.ply -o result --weights people.safetensors --adapt 15
    """
    set_verbosity(quiet=quiet, verbose=verbose)
    check_folder(output, inputs=(source, target), names=RESULT_FILES)
    if page is not None:
        check_file(page)
    check_picture_file(picture, lines, picture_width)
    options = PairOptions(
        as_cloud=as_cloud,
        partial=partial,
        partial_scale=partial_scale,
        pre_aligned=pre_aligned,
        source_up=source_up or up,
        target_up=target_up or up,
        strict=strict,
    )
    with progress_bar(quiet=quiet, form=progress_form) as progress:
        steps = Steps(listener=counted(progress, STEPS + adapt + (adapt > 0), verbose=verbose))
        matcher = build_matcher(weights, method, device, no_cache=no_cache)
        found = match_or_adapt(matcher, source, target, options, adapt, steps)
        paths = write_folder(output, found, steps=steps)
    if page is not None:
        write_page(page, scene_of(found))
        paths.append(page)
    if picture is not None:
        write_picture(picture, scene_of(found), width=picture_width, lines=lines)
        paths.append(picture)
    if not quiet:
        _summary(found, steps, paths, verbose=verbose)


def match_or_adapt(
    matcher: Matcher, source: Path, target: Path, options: PairOptions, adapt: int, steps: Steps
) -> Match:
    """Match two files, after so many steps of test-time adaptation."""
    if not adapt:
        return matcher.match(source, target, options, steps=steps)
    pair, files = matcher.pair(source, target, options, steps=steps)
    with steps.step("adapt"):
        matcher, pair = adapt_to_pair(matcher, pair, AdaptationSettings(steps=adapt), listener=steps.listener)
    return with_inputs(matcher.match_pair(pair, steps=steps), files, steps, adapt=adapt)


def counted(progress: Report, total: int = STEPS, *, verbose: bool = False) -> Listener:
    """A listener for so many steps of a match that moves the progress bar on, and prints their names if ``verbose``."""
    count = 0

    def listen(name: str) -> None:
        nonlocal count
        progress(count, total, name)
        count += 1
        if verbose:
            say(f"{name} ...")

    return listen


def _summary(match: Match, steps: Steps, paths: list[Path], *, verbose: bool) -> None:
    for warning in match.warnings:
        say(f"Warning: {warning}")
    if verbose:
        for step in steps.finished:
            say(f"{step.name:<24} {step.seconds:8.2f} s   process peak {step.process_peak_mb:7.0f} MB")
    seconds = sum(step.seconds for step in steps.finished)
    sides = "; ".join(f"{side} {_in_words(match.matched(side))}" for side in SIDES)
    say(f"Matched by {match.method} in {seconds:.1f} s (reading to writing): {sides}.")
    for path in paths:
        typer.echo(path)


def _in_words(matched: dict[str, int | float]) -> str:
    reasons = {"points_left_out": "left out by repair", "points_without_counterpart": "without a counterpart"}
    missing = [f"{matched[name]} {reason}" for name, reason in reasons.items() if matched[name]] or ["all matched"]
    return f"{matched['points']} points, {', '.join(missing)}, mean confidence {matched['mean_confidence']:.2f}"
