"""``homolog evaluate``: the published score on a folder with ground truth."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from homolog.cli.options import (
    Adapt,
    DeviceOption,
    InPlace,
    MethodOption,
    NoCache,
    Quiet,
    Verbose,
    Weights,
    build_matcher,
    check_file,
    described,
    set_verbosity,
)
from homolog.cli.progress import progress_bar
from homolog.datasets import ShapeFolder, Split
from homolog.evaluation import Evaluation, MatchPair, Modalities, Protocol
from homolog.evaluation import evaluate as evaluate_folder
from homolog.files import write_json
from homolog.matching import Correspondence, Matcher, Prepared, Side
from homolog.shapes import Up
from homolog.training import AdaptationSettings, adapt_to_pair
from homolog.versions import versions


def evaluate(
    data: Annotated[Path, typer.Argument(help="A folder with off/ and corres/.", show_default=False)],
    weights: Weights = None,
    method: MethodOption = "auto",
    adapt: Adapt = 0,
    modality: Annotated[Modalities, typer.Option(help="What source and target are used as.")] = "mesh",
    split: Annotated[Split, typer.Option(help="Which shapes: train.txt or test.txt, or by order of name.")] = "test",
    pairs: Annotated[Path | None, typer.Option(help="A file of SOURCE,TARGET lines to use instead.")] = None,
    n_pairs: Annotated[
        int | None, typer.Option(help="Draw so many pairs of different shapes at random, by the seed.", min=1)
    ] = None,
    partial: Annotated[
        bool, typer.Option("--partial", help="Each target is a part of a shape like its source, in the same units.")
    ] = False,
    in_place: InPlace = False,
    up: Annotated[Up, typer.Option(help="The axis that points up in the files.")] = "y",
    noise: Annotated[float, typer.Option(help="Noise on cloud points, in units of sqrt(area).", min=0.0)] = 0.0,
    seed: Annotated[int, typer.Option(help="Seed of the noise, and of the pairs drawn.")] = 0,
    json: Annotated[Path | None, typer.Option(metavar="OUT", help="Also write everything as JSON.")] = None,
    device: DeviceOption = "auto",
    no_cache: NoCache = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Score maps on a folder of shapes with ground truth.

    The score is the mean geodesic error x100 of the map that gives each target point its source point, over all points
    of all pairs together, in units of the square root of the source's area.

    Examples:
      homolog evaluate FAUST_r --weights people.safetensors

      homolog evaluate FAUST_r --weights people.safetensors --n-pairs 20

      homolog evaluate SCAPE_r --weights people.safetensors --adapt 15 --n-pairs 20

      homolog evaluate people_views --weights views.safetensors --partial

      homolog evaluate SCAPE_r --weights people.safetensors --modality cloud --noise 0.01 --json scape.json
    """
    set_verbosity(quiet=quiet, verbose=verbose)
    if json is not None:
        check_file(json)
    protocol = Protocol(
        modality=modality,
        split=split,
        pairs_file=None if pairs is None else str(pairs),
        n_pairs=n_pairs,
        partial=partial,
        in_place=in_place,
        noise=noise,
        seed=seed,
    )
    matcher = build_matcher(weights, method, device, no_cache=no_cache)
    folder = ShapeFolder.open(data, up=up)
    with progress_bar(quiet=quiet) as progress:
        evaluation = evaluate_folder(
            matcher, folder, protocol, match=_match_by(matcher, adapt, partial=partial), progress=progress
        )
    if json is not None:
        report = {
            **evaluation.to_dict(),
            "data": str(folder.root),
            "protocol": asdict(protocol),
            "adapt": adapt,
            **described(matcher, weights),
            "command": ["homolog", *sys.argv[1:]],
            "versions": versions(),
        }
        write_json(json, report)
    if not quiet:
        Console().print(_table(evaluation, folder, protocol))


def _match_by(matcher: Matcher, steps: int, *, partial: bool) -> MatchPair | None:
    """How a pair is matched: as it is, or after the network is adapted to it."""
    if not steps:
        return None
    side: Side | None = "target" if partial else None

    def match(source: Prepared, target: Prepared) -> Correspondence:
        adapted, *pair = adapt_to_pair(matcher, source, target, AdaptationSettings(steps=steps), partial=side)
        return adapted.match_prepared(*pair, partial=side)

    return match


def _table(evaluation: Evaluation, folder: ShapeFolder, protocol: Protocol) -> Table:
    found = evaluation.to_dict()
    partial = ", partial" if protocol.partial else ""
    noise = f", noise {protocol.noise:g}" if protocol.noise else ""
    table = Table(
        title=f"{folder.root.name}, {protocol.modality}{partial}{noise}", show_header=False, title_justify="left"
    )
    table.add_row("mean geodesic error x100", f"{found['mean_geodesic_error']:.2f}")
    table.add_row("median geodesic error x100", f"{found['median_geodesic_error']:.2f}")
    table.add_row(f"area under the curve to {found['pck_threshold']:g}", f"{found['pck_auc']:.3f}")
    table.add_row("pairs", str(len(found["pairs"])))
    if found["unmatched_points"]:
        table.add_row("points without a match, left out", str(found["unmatched_points"]))
    table.add_row("route", found["route"])
    table.add_row("seconds", f"{found['seconds']['total']:.0f}")
    return table
