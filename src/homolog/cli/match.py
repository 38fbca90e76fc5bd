"""``homolog match``: two files in, a correspondence out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

import homolog
from homolog.cli.options import (
    INPUT,
    OUTPUT,
    PARTIAL,
    PICTURE_WIDTH,
    Adapt,
    ClutterOption,
    DeviceOption,
    Lines,
    MethodOption,
    NoCache,
    OrientOption,
    Page,
    Picture,
    PictureWidth,
    PreAligned,
    Quiet,
    ResultOutput,
    SettingsFile,
    UseProxyOption,
    Verbose,
    Weights,
    build_matcher,
    check_folder,
    check_inputs,
    check_page_file,
    check_picture_file,
    set_verbosity,
    settings_and_method,
)
from homolog.cli.progress import ProgressOption, Report, progress_bar, say, tell_files
from homolog.cli.wording import in_options
from homolog.core.choices import AsCloud, Mirror, Parts, Side, System, Up
from homolog.core.errors import ArgumentError
from homolog.core.files import refuse_overwriting_inputs, remove
from homolog.core.method_names import AUTO
from homolog.core.pretrained import AUTO_WEIGHTS
from homolog.core.progress import Listener, Timings

if TYPE_CHECKING:
    from homolog.matching import Match, Matcher
    from homolog.pairs import Pair

# read, repair, proxy, operators, orientation and features for each shape, the map, and writing.
STEPS = 14


def match(
    context: typer.Context,
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="The shape whose positions give the colours.", show_default=False)
    ],
    target: Annotated[Path, typer.Argument(metavar="TARGET", help="The shape to match it to.", show_default=False)],
    as_cloud: Annotated[
        AsCloud | None, typer.Option(help="Use only the points of this shape.", rich_help_panel=INPUT)
    ] = None,
    up: Annotated[Up, typer.Option(help="The axis that points up in both files.", rich_help_panel=INPUT)] = "y",
    source_up: Annotated[
        Up | None, typer.Option(help="The axis that points up in the source, if it differs.", rich_help_panel=INPUT)
    ] = None,
    target_up: Annotated[
        Up | None, typer.Option(help="The axis that points up in the target, if it differs.", rich_help_panel=INPUT)
    ] = None,
    landmarks: Annotated[
        tuple[Path, Path] | None,
        typer.Option(
            metavar="SOURCE_FILE TARGET_FILE",
            help="Points that are known to correspond, 1 to 50: a file of the source's and one of the target's. Paired "
            "by name where both have names, else by order.",
            show_default=False,
            rich_help_panel=INPUT,
        ),
    ] = None,
    landmark_uncertainty: Annotated[
        float,
        typer.Option(
            metavar="LENGTH",
            help="How far from the target's landmarks the source's may end, in the target's units.",
            min=0.0,
            rich_help_panel=INPUT,
        ),
    ] = 0.0,
    axes: Annotated[
        System | None,
        typer.Option(
            help="The shapes' coordinate system, for landmark files that have one.",
            show_default="as the shapes' files say, or LPS",
            rich_help_panel=INPUT,
        ),
    ] = None,
    orient: OrientOption = "auto",
    mirror: Annotated[
        Mirror | None,
        typer.Option(
            help="This shape is a mirror image: reflect it before it is matched. auto: the source, if it is one of the "
            "target.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    clutter: ClutterOption = "remove",
    proxy: UseProxyOption = "auto",
    source_mask: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="How much each point of the source counts, 0 to leave it out: .npy, .txt or .csv with a number per "
            "point, or .ply with the property mask or weight, or painted black and white.",
            show_default=False,
            rich_help_panel=INPUT,
        ),
    ] = None,
    target_mask: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="How much each point of the target counts, likewise.",
            show_default=False,
            rich_help_panel=INPUT,
        ),
    ] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Stop at anything to repair or to warn of.", rich_help_panel=INPUT)
    ] = False,
    method: MethodOption = "auto",
    weights: Weights = None,
    settings: SettingsFile = None,
    adapt: Adapt = 0,
    partial: Annotated[
        Parts | None,
        typer.Option(
            help="This shape is partial: a part of a shape like the other, whose points may then have no counterpart; "
            "both, where two parts overlap.",
            rich_help_panel=PARTIAL,
        ),
    ] = None,
    partial_scale: Annotated[
        float,
        typer.Option(
            metavar="FACTOR",
            help="Multiply the partial shape's lengths by this to bring them to the full one's units; of two "
            "parts, the target's.",
            rich_help_panel=PARTIAL,
        ),
    ] = 1.0,
    pre_aligned: PreAligned = False,
    alternatives: Annotated[
        int,
        typer.Option(
            metavar="N",
            help="Also write the maps of other ways round, N in all, the likeliest first: DIR/alternative-2 and so on.",
            min=1,
            rich_help_panel=OUTPUT,
        ),
    ] = 1,
    output: ResultOutput = Path("match"),
    page: Page = None,
    picture: Picture = None,
    lines: Lines = 0,
    picture_width: PictureWidth = PICTURE_WIDTH,
    device: DeviceOption = "auto",
    no_cache: NoCache = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    progress_form: ProgressOption = "bar",
) -> None:
    """Match two shapes: for every point of each, the corresponding point of the other.

    Writes DIR/correspondence.npz (point indices both ways and confidences), DIR/source.ply and DIR/target.ply (the same
    colours on corresponding points) and DIR/report.json.

    Examples:
      homolog match cat.off lion.obj -o result --weights animals.safetensors

      homolog match scan.ply template.obj -o result --partial source --source-up z

      homolog match part.stl full.glb -o result --partial source --partial-scale 0.001

      homolog match front.ply side.ply -o result --partial both --weights views

      homolog match a.ply b.xyz -o result --method axiomatic

      homolog match dancer.ply statue.ply -o result --html both.html --picture both.png --lines 20

      homolog match a.ply b.ply -o result --landmarks a.mrk.json b.mrk.json

      homolog match jaw.ply other.ply -o result --source-mask teeth.ply --target-mask other-teeth.ply

      homolog match old.ply new.ply -o result --weights people.safetensors --adapt 40

      homolog match a.ply c.ply -o again --settings result/report.json
    """
    set_verbosity(quiet=quiet, verbose=verbose)
    check_inputs(source, target, weights=weights)
    told, method = settings_and_method(context, settings, method)
    options = homolog.PairOptions(
        as_cloud=as_cloud,
        partial=partial,
        partial_scale=partial_scale,
        pre_aligned=pre_aligned,
        source_up=source_up or up,
        target_up=target_up or up,
        orient=orient,
        mirror=mirror,
        clutter=clutter,
        proxy=proxy,
        strict=strict,
        landmarks=known_points(landmarks, landmark_uncertainty, axes),
        source_mask=homolog.pairs.mask_of(source_mask, "source_mask"),
        target_mask=homolog.pairs.mask_of(target_mask, "target_mask"),
    )
    _check_outputs(output, alternatives, page, picture, width=picture_width, lines=lines)
    with progress_bar(quiet=quiet, form=progress_form) as progress:
        steps = STEPS + has_choice(weights, method) + adapt + (adapt > 0) + 2 * (alternatives - 1)
        timings = Timings(listener=counted(progress, steps, verbose=verbose))
        how: dict[str, Any] = {"no_cache": no_cache, "told": told, "file_told": progress_form != "json"}
        matcher = build_matcher(weights, method, device, **how)
        pair, files = matcher.pair(source, target, options, timings=timings)
        matcher, pair = adapted(matcher, pair, adapt, timings)
        each = [timings, *(timings.branch() for _ in range(alternatives - 1))]
        matches = [
            homolog.matching.with_inputs(match, files, own, adapt=adapt)
            for match, own in zip(matcher.alternatives(pair, alternatives, timings=each), each, strict=False)
        ]
        paths = write_results(output, matches, each)
    paths += _shown(matches, page, picture, width=picture_width, lines=lines)
    if len(matches) < alternatives and not quiet:
        say(f"Note: {len(matches)} of {alternatives} ways round were found.")
    if not quiet:
        _summary(matches, timings, paths, verbose=verbose)


def _check_outputs(
    output: Path, alternatives: int, page: Path | None, picture: Path | None, *, width: int, lines: int
) -> None:
    """Refuse folders, those of the alternatives included, page and picture that cannot be written, before any work."""
    for folder in (output, *(homolog.matching.alternative_folder(output, 2 + n) for n in range(alternatives - 1))):
        check_folder(folder, names=homolog.matching.RESULT_FILES)
    check_page_file(page)
    check_picture_file(picture, lines, width)
    refuse_overwriting_inputs(_alternatives(output))


def has_choice(weights: str | None, method: str) -> bool:
    """Whether weights and method are chosen for the pair, which is a step of its own."""
    return weights in (None, AUTO_WEIGHTS) and method == AUTO


def known_points(
    landmarks: tuple[Path, Path] | None, uncertainty: float, axes: System | None
) -> homolog.pairs.LandmarkPairs | None:
    """The landmarks that are to guide a match; None without any."""
    if landmarks is not None:
        return homolog.transfer.read_landmark_pairs(*landmarks, axes=axes, uncertainty=uncertainty)
    for name, given in (("--landmark-uncertainty", uncertainty), ("--axes", axes)):
        if given:
            raise ArgumentError(f"{name} is {given}, but is about landmarks; add --landmarks, or leave it out")
    return None


def remove_alternatives(output: Path) -> None:
    """Remove the alternatives that an earlier match left in the folder: they belong to other maps."""
    for file in _alternatives(output):
        remove(file)
    for folder in homolog.matching.alternative_folders(output):
        if not any(folder.iterdir()):
            folder.rmdir()


def _alternatives(output: Path) -> list[Path]:
    """The files of alternatives that an earlier match left in the folder."""
    folders = homolog.matching.alternative_folders(output)
    return [folder / name for folder in folders for name in homolog.matching.RESULT_FILES]


def write_results(output: Path, matches: list[Match], timings: list[Timings]) -> list[Path]:
    """Write the best match into a folder, and the others into folders in it, in place of those that are there."""
    paths = homolog.matching.write_folder(output, matches[0], timings=timings[0])
    remove_alternatives(output)
    for number, match in enumerate(matches[1:], homolog.matching.FIRST_ALTERNATIVE):
        folder = homolog.matching.alternative_folder(output, number)
        paths += homolog.matching.write_folder(folder, match, timings=timings[number - 1])
    return paths


def _shown(matches: list[Match], page: Path | None, picture: Path | None, *, width: int, lines: int) -> list[Path]:
    """Write a page of all maps and a picture of the best, where they are wanted."""
    if page is None and picture is None:
        return []
    scene = homolog.viewing.scene_of_all(matches)
    if page is not None:
        homolog.viewing.write_page(page, scene)
    if picture is not None:
        homolog.viewing.write_picture(picture, scene, width=width, lines=lines)
    return [path for path in (page, picture) if path is not None]


def adapted(matcher: Matcher, pair: Pair, steps: int, timings: Timings) -> tuple[Matcher, Pair]:
    """Both after so many steps of test-time adaptation, where these make the map better."""
    if not steps:
        return matcher, pair
    settings = homolog.training.AdaptationSettings(steps=steps)
    with timings.measure("adapt"):
        return homolog.training.adapt_if_better(matcher, pair, settings, listener=timings.listener)


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


def _summary(matches: list[Match], timings: Timings, paths: list[Path], *, verbose: bool) -> None:
    match, *others = matches
    for warning in match.warnings:
        say(f"Warning: {in_options(warning)}")
    for side in get_args(Side):
        for finding in match.report["inputs"][side]["findings"]:
            if finding["rule"] in (
                *homolog.geometry.CLUTTER_RULES,
                homolog.geometry.MASKED,
                *homolog.pairs.PROXY_RULES,
            ):
                say(in_options(f"Note: {side}: {finding['count']} {finding['rule']} {finding['action']}."))
    for number, other in enumerate(others, 2):
        for warning in other.warnings:
            if warning not in match.warnings:
                say(f"Warning: alternative-{number}: {in_options(warning)}")
    if verbose:
        for step in timings.finished:
            say(f"{step.name:<24} {step.seconds:8.2f} s   process peak {step.process_peak_mb:7.0f} MB")
    seconds = sum(step.seconds for step in timings.finished)
    sides = "; ".join(f"{side} {_in_words(match.matched(side))}" for side in get_args(Side))
    if match.report["adaptation"]:
        say(_of_adaptation(match.report["adaptation"]))
    say(f"Matched by {match.method}{_with_weights(match)} in {seconds:.1f} s (reading, matching and writing): {sides}.")
    tell_files(paths)


def _of_adaptation(told: dict[str, Any]) -> str:
    if not told["steps"]:
        return "Not adapted: these shapes are matched best by a method without weights."
    figures = f"the map's misfit is {told['adapted_map_misfit']:.2f} with it and {told['map_misfit']:.2f} without"
    return f"Adaptation {'kept' if told['kept'] else 'not kept'}: {figures}."


def _with_weights(match: Match) -> str:
    """The weights whose features were compared, whether they were chosen or given; none where the method needs none."""
    chosen = next((candidate["name"] for candidate in match.report["choice"]), None)
    features = match.report["features"]
    name = features["name"] if chosen is None and features is not None else chosen
    return "" if name in (None, match.method) else f" with the weights {name}"


def _in_words(matched: dict[str, int | float]) -> str:
    reasons = {"points_left_out": "left out by repair", "points_without_counterpart": "without a counterpart"}
    missing = [f"{matched[name]} {reason}" for name, reason in reasons.items() if matched[name]] or ["all matched"]
    return f"{matched['points']} points, {', '.join(missing)}, mean confidence {matched['mean_confidence']:.2f}"
