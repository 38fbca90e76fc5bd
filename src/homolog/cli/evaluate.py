"""``homolog evaluate``: the published score on a folder with ground truth."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import homolog
from homolog.cli.lazy import OTHER
from homolog.cli.options import (
    INPUT,
    METHOD,
    OUTPUT,
    PARTIAL,
    Adapt,
    ClusterOption,
    ClutterOption,
    DatasetOption,
    DeviceOption,
    Json,
    MethodOption,
    NoCache,
    OrientOption,
    Quiet,
    Seed,
    SettingsFile,
    UseProxyOption,
    Verbose,
    Weights,
    build_matcher,
    check_files,
    check_inputs,
    described,
    device_of,
    on_stdout,
    set_verbosity,
    settings_and_method,
    workers,
    write_figures,
)
from homolog.cli.progress import progress_bar, say
from homolog.cli.wording import in_options
from homolog.core.choices import Background, Modalities, OutlierKind, Split, Turn, Up
from homolog.core.errors import ArgumentError
from homolog.core.files import write_csv
from homolog.core.plots import check_plot
from homolog.core.versions import versions
from homolog.methods import AUTO

if TYPE_CHECKING:
    from rich.table import Table

    from homolog.datasets import DatasetDescription, ShapeFolder
    from homolog.evaluation import Detection, Evaluation, Protocol
    from homolog.evaluation.protocol import PartialPairs
    from homolog.matching import Match, Matcher
    from homolog.pairs import Pair

# Options that have no effect on maps that are there already.
_OF_MAKING_MAPS = (
    "noise",
    "outliers",
    "background",
    "clutter",
    "proxy",
    "turn",
    "part_units",
    "orient",
    "landmarks",
    "method",
    "weights",
    "settings",
    "adapt",
    "refinement",
    "alignment",
    "pre_aligned",
    "device",
    "no_cache",
)


def evaluate(
    context: typer.Context,
    data: Annotated[
        Path,
        typer.Argument(metavar="DATA", help="A dataset's folder, or one with off/ and corres/.", show_default=False),
    ],
    dataset: DatasetOption = None,
    split: Annotated[
        Split, typer.Option(help="Which shapes: by train.txt and test.txt, or by order of name.", rich_help_panel=INPUT)
    ] = "test",
    pairs: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Lines of SOURCE,TARGET: the pairs to match instead.", rich_help_panel=INPUT),
    ] = None,
    n_pairs: Annotated[
        int | None,
        typer.Option(
            "--n-pairs",
            "-n",
            metavar="N",
            help="Draw so many pairs of different shapes at random.",
            min=1,
            rich_help_panel=INPUT,
        ),
    ] = None,
    modality: Annotated[
        Modalities | None,
        typer.Option(
            metavar="MODALITY",
            help="What source and target are used as: mesh, cloud, mesh-to-cloud or cloud-to-mesh.",
            show_default="mesh, or cloud for datasets of clouds",
            rich_help_panel=INPUT,
        ),
    ] = None,
    noise: Annotated[
        float,
        typer.Option(
            metavar="SIGMA",
            help="Noise added to the points of clouds, in units of sqrt(area).",
            min=0.0,
            rich_help_panel=INPUT,
        ),
    ] = 0.0,
    outliers: Annotated[
        float,
        typer.Option(
            metavar="SHARE",
            help="Outliers added to every cloud, relative to the number of its points.",
            min=0.0,
            rich_help_panel=INPUT,
        ),
    ] = 0.0,
    outlier_kind: Annotated[
        OutlierKind,
        typer.Option(
            help="Where outliers lie: anywhere in the bounding box, in clusters there, or near the surface.",
            rich_help_panel=INPUT,
        ),
    ] = "box",
    background: Annotated[
        Background,
        typer.Option(help="Put every cloud on a floor with as many points.", rich_help_panel=INPUT),
    ] = "none",
    clutter: ClutterOption = "remove",
    proxy: UseProxyOption = "auto",
    up: Annotated[
        Up | None,
        typer.Option(
            help="The axis that points up in the files.",
            show_default="as the dataset has it, or y",
            rich_help_panel=INPUT,
        ),
    ] = None,
    turn: Annotated[
        Turn,
        typer.Option(
            help="Turn every shape by a rotation of its own before anything sees it: about the vertical axis, or any.",
            rich_help_panel=INPUT,
        ),
    ] = "none",
    orient: OrientOption = "auto",
    landmarks: Annotated[
        int,
        typer.Option(
            metavar="N",
            help="Guide each match by N points of its ground truth that lie far apart; the others are scored.",
            min=0,
            max=50,
            rich_help_panel=INPUT,
        ),
    ] = 0,
    method: MethodOption = AUTO,
    weights: Weights = None,
    settings: SettingsFile = None,
    adapt: Adapt = 0,
    refinement: Annotated[
        bool | None,
        typer.Option(
            "--refinement/--no-refinement",
            help="Refine maps by ZoomOut, where they may be refined, or leave them as the method makes them.",
            show_default="refinement",
            rich_help_panel=METHOD,
        ),
    ] = None,
    alignment: Annotated[
        bool | None,
        typer.Option(
            "--alignment/--no-alignment",
            help="Align partial shapes with their full shapes before they are matched, or leave them as they lie.",
            show_default="alignment",
            rich_help_panel=PARTIAL,
        ),
    ] = None,
    partial: Annotated[
        bool | None,
        typer.Option(
            "--partial/--full",
            help="Each target is a partial view or a part of a shape like its source, in the same units.",
            show_default="as the dataset has it",
            rich_help_panel=PARTIAL,
        ),
    ] = None,
    part_units: Annotated[
        float,
        typer.Option(
            metavar="FACTOR",
            help="Multiply the lengths of each target by this before anything sees it: a part in other units than its "
            "full shape.",
            rich_help_panel=PARTIAL,
        ),
    ] = 1.0,
    both_partial: Annotated[
        bool,
        typer.Option(
            "--both-partial",
            help="Both shapes of each pair are partial, and overlap.",
            show_default="as the dataset has it",
            rich_help_panel=PARTIAL,
        ),
    ] = False,
    pre_aligned: Annotated[
        bool | None,
        typer.Option(
            "--pre-aligned/--not-pre-aligned",
            help="Partial shapes lie in the coordinates of their full shapes, about where they belong.",
            show_default="as the dataset has it",
            rich_help_panel=PARTIAL,
        ),
    ] = None,
    maps: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Score point maps that another program computed: a file per pair, SOURCE_TARGET.txt (.vts, .map, "
            ".mat, .npz), with the source point of each target point. No weights are used.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    base: Annotated[
        int | None,
        typer.Option(
            help="The first index in the files of --maps, 0 or 1.",
            min=0,
            max=1,
            show_default="0 for .txt and .npz, else 1",
            rich_help_panel=INPUT,
        ),
    ] = None,
    json: Json = None,
    csv: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a table of the pairs.", rich_help_panel=OUTPUT)
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Draw the PCK curve, as .png, .pdf or .svg.", rich_help_panel=OUTPUT),
    ] = None,
    seed: Seed = 0,
    processes: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="How many processes match pairs at once.", min=1, show_default="1", rich_help_panel=OTHER
        ),
    ] = None,
    cluster: ClusterOption = None,
    device: DeviceOption = "auto",
    no_cache: NoCache = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Score maps on a folder of shapes with ground truth.

    The score is the mean geodesic error x100 of the map from target to source, over all points of all pairs together,
    in units of the square root of the source's area. For datasets of clouds it is the mean Euclidean distance in the
    files' unit. For partial shapes, precision and recall of points without a counterpart are printed as well; for full
    shapes with template correspondence, how many pairs are exchanged left for right, or turned over.

    With --dataset, the up axis, whether targets are partial and whether these are pre-aligned come from the dataset's
    description, unless options say otherwise.

    Examples:
      homolog evaluate FAUST_r --weights people.safetensors

      homolog evaluate FAUST_r --weights people.safetensors -n 20

      homolog evaluate SCAPE_r --weights people.safetensors --adapt 40 -n 20

      homolog evaluate SHREC16 --dataset shrec16_cuts --weights cuts.safetensors

      homolog evaluate people_views --weights views.safetensors --partial

      homolog evaluate SCAPE_r --weights people.safetensors --modality cloud --noise 0.01 --json scape.json

      homolog evaluate SMAL_r --landmarks 5

      homolog evaluate FAUST_r --modality cloud --outliers 0.1 --background floor

      homolog evaluate FAUST_r --turn any --seed 1
    """
    set_verbosity(quiet=quiet, verbose=verbose)
    _check_given(context, weights, maps, base, (json, csv, plot))
    told, method = settings_and_method(context, settings, method)
    description = homolog.datasets.read_description(dataset) if dataset else homolog.datasets.DatasetDescription()
    folder = homolog.datasets.ShapeFolder.open(data, description, up=up)
    protocol = homolog.evaluation.Protocol(
        modality=modality or ("cloud" if description.holds == "clouds" else "mesh"),
        split=split,
        pairs_file=None if pairs is None else str(pairs),
        n_pairs=n_pairs,
        partial=_partial_pairs(description, partial, both_partial=both_partial),
        part_units=part_units,
        pre_aligned=(description.pre_aligned and partial is not False) if pre_aligned is None else pre_aligned,
        noise=noise,
        outliers=outliers,
        outlier_kind=outlier_kind,
        background=background,
        clutter=clutter,
        proxy=proxy,
        turn=turn,
        orient=orient,
        landmarks=landmarks,
        seed=seed,
    )
    stages = {"refinement": refinement, "alignment": alignment, "parts": alignment}
    device = device_of(device, cluster)
    how_made: dict[str, Any] = {"no_cache": no_cache, "told": told, "stages": stages}
    matcher = None if maps is not None else build_matcher(weights, method, device, **how_made)
    scored = None if maps is None else homolog.evaluation.MapsFolder(maps, base=base)
    match_pair = None if matcher is None else _adapting(matcher, adapt)
    workers_of = workers(processes, cluster, usually=1)
    how: dict[str, Any] = {"match": scored, "match_pair": match_pair, "processes": workers_of}
    with progress_bar(quiet=quiet) as progress:
        evaluation = homolog.evaluation.evaluate(matcher, folder, protocol, **how, progress=progress)
    made_by = {"maps": str(maps)} if matcher is None else {"adapt": adapt, **described(matcher)}
    figures = {**evaluation.to_dict(), **_setup(folder, protocol), **made_by}
    _write(evaluation, folder, figures, json, csv, plot)
    if not quiet:
        _tell(evaluation, figures, _title(folder, protocol), table=not on_stdout(json))


def _partial_pairs(description: DatasetDescription, partial: bool | None, *, both_partial: bool) -> PartialPairs:
    """Which shapes of a pair are partial: as the options say, or the dataset."""
    if both_partial and partial is not None:
        raise ArgumentError("--both-partial and --partial or --full are both given; give one of them")
    told = description.partial if partial is None else partial
    return "both" if both_partial else told


def _check_given(
    context: typer.Context,
    weights: str | None,
    maps: Path | None,
    base: int | None,
    outputs: tuple[Path | None, Path | None, Path | None],
) -> None:
    """Refuse what cannot be written or is not there, and options that do not go with maps that are there, or not."""
    json, csv, plot = outputs
    check_files(csv, plot, None if on_stdout(json) else json)
    if plot is not None:
        check_plot(plot)
    check_inputs(weights=weights)
    if maps is not None:
        _refuse_unused(context)
    elif base is not None:
        raise ArgumentError(f"--base is {base}, but is about the files of --maps; add --maps DIR, or leave it out")


def _refuse_unused(context: typer.Context) -> None:
    """Refuse options of how maps are made: those of --maps are there already."""
    for parameter in context.command.params:
        if parameter.name in _OF_MAKING_MAPS and context.params[parameter.name] != parameter.get_default(context):
            raise ArgumentError(
                f"--maps scores maps that are there already, so that {parameter.opts[0]} has no effect; leave it out"
            )


def _write(
    evaluation: Evaluation,
    folder: ShapeFolder,
    figures: dict[str, Any],
    json: Path | None,
    csv: Path | None,
    plot: Path | None,
) -> None:
    write_figures(json, figures)
    if csv is not None:
        write_csv(csv, evaluation.rows())
    if plot is not None:
        homolog.evaluation.plot_pck(plot, {folder.description.name or folder.root.name: evaluation})


def _tell(evaluation: Evaluation, figures: dict[str, Any], title: str, *, table: bool) -> None:
    for warning in figures.get("warnings", ()):
        say(f"Warning: {in_options(warning)}")
    if table:
        from rich.console import Console

        Console().print(_table(evaluation, figures, title))


def _setup(folder: ShapeFolder, protocol: Protocol) -> dict[str, Any]:
    """What was evaluated, and how, for JSON."""
    return {
        "data": str(folder.root),
        "dataset": folder.description.name or None,
        "up": folder.up,
        "protocol": asdict(protocol),
        "command": ["homolog", *sys.argv[1:]],
        "versions": versions(),
    }


def _adapting(matcher: Matcher, steps: int) -> Callable[[Pair], Match] | None:
    """How a pair is matched: as it is, or after the network is adapted to it, where that is better."""
    if not steps:
        return None

    settings = homolog.training.AdaptationSettings(steps=steps)

    def match(pair: Pair) -> Match:
        adapted, pair = homolog.training.adapt_if_better(matcher, pair, settings)
        return adapted.find(pair)

    return match


def _table(evaluation: Evaluation, found: dict[str, Any], title: str) -> Table:
    from rich.table import Table

    table = Table(title=title, show_header=False, title_justify="left")
    kind = evaluation.error_kind
    unit = "x100" if evaluation.euclidean_unit is None else f"in {evaluation.euclidean_unit}"
    table.add_row(f"mean {kind} error {unit}", f"{found[f'mean_{kind}_error']:.2f}")
    without = found.get(f"mean_{kind}_error_without_self_pairs")
    if without is not None:
        table.add_row("without pairs of a shape with itself", f"{without:.2f}")
    table.add_row(f"median {kind} error {unit}", f"{found[f'median_{kind}_error']:.2f}")
    if "pck" in found:
        table.add_row(f"area under the curve to {found['pck_threshold']:g}", f"{found['pck_auc']:.3f}")
    found_points = {"points without a counterpart": evaluation.missing, "points that were added": evaluation.clutter}
    for label, detection in found_points.items():
        if detection is not None:
            table.add_row(label, _described_detection(detection))
    if evaluation.overlap is not None:
        table.add_row("mean IoU of the overlap", _figure(evaluation.overlap_iou))
        table.add_row("points of the overlap", _described_detection(evaluation.overlap))
    table.add_row("pairs", str(len(found["pairs"])))
    if found["unmatched_points"]:
        without = found[f"mean_{kind}_error_of_matched_points"]
        others = "no other points" if without is None else f"{without:.2f} without them"
        count = f"{found['unmatched_points']}, counted as the diameter ({others})"
        table.add_row("points without a match", count)
    table.add_row("method", found["method"])
    if evaluation.choices:
        table.add_row("matched by", ", ".join(f"{name} {count}" for name, count in evaluation.choices.items()))
    if evaluation.n_adapted is not None:
        table.add_row("pairs whose adapted map was kept", f"{evaluation.n_adapted} of {len(evaluation.pairs)}")
    if evaluation.exchanges is not None:
        sides, over = (evaluation.exchanges[way] for way in ("left-right", "turned over"))
        known = sum(evaluation.exchanges.values())
        table.add_row("pairs exchanged left-right, turned over", f"{sides}, {over} of {known}")
    if evaluation.n_doubtful:
        table.add_row("doubtful matches", f"{evaluation.n_doubtful} of {len(evaluation.pairs)}")
    table.add_row("seconds (preparing, matching, measuring)", f"{found['seconds']['total']:.0f}")
    return table


def _title(folder: ShapeFolder, protocol: Protocol) -> str:
    name = folder.description.name or folder.root.name
    partial = {False: "", True: ", partial", "both": ", both partial"}[protocol.partial]
    partial += ", pre-aligned" if protocol.pre_aligned else ""
    noise = f", noise {protocol.noise:g}" if protocol.noise else ""
    noise += f", {protocol.outliers:g} outliers ({protocol.outlier_kind})" if protocol.outliers else ""
    noise += "" if protocol.background == "none" else f", {protocol.background}"
    turned = {"none": "", "vertical": ", turned about the vertical", "any": ", turned"}[protocol.turn]
    guided = f", {protocol.landmarks} landmarks" if protocol.landmarks else ""
    return f"{name}, {protocol.modality}{partial}{noise}{turned}{guided}"


def _described_detection(found: Detection) -> str:
    figures = {"precision": found.precision, "recall": found.recall, "F1": found.f1}
    return ", ".join(f"{name} {_figure(value)}" for name, value in figures.items())


def _figure(value: float | None) -> str:
    return "-" if value is None else format(value, ".3f")
