"""``homolog compare``: two groups of a collection's shapes, compared point by point."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import homolog
from homolog.cli.options import INPUT, METHOD, Quiet, ResultOutput, Seed, check_folder
from homolog.cli.progress import progress_bar, say, tell_files


def compare(
    collection: Annotated[
        Path, typer.Argument(metavar="COLLECTION", help="A folder that homolog collection wrote.", show_default=False)
    ],
    groups: Annotated[
        Path,
        typer.Option(
            metavar="FILE.csv",
            help="A table with the columns name and group; shapes without a group are left out.",
            show_default=False,
            rich_help_panel=INPUT,
        ),
    ],
    between: Annotated[
        tuple[str, str] | None,
        typer.Option(
            metavar="GROUP GROUP",
            help="Which two groups, if there are more; the difference is the second less the first.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    permutations: Annotated[
        int,
        typer.Option(
            metavar="N",
            help="Relabellings of the shapes; all of them where there are no more.",
            min=100,
            rich_help_panel=METHOD,
        ),
    ] = 10_000,
    output: ResultOutput = Path("comparison"),
    seed: Seed = 0,
    quiet: Quiet = False,
) -> None:
    """Compare two groups of shapes point by point, with a permutation test that is corrected for many points.

    Each point has Hotelling's T squared of its positions after alignment. p_corrected is the share of relabellings of
    the shapes whose largest T squared on the whole surface is as large: below 0.05 the chance of any false point is at
    most 5 %. q is the false discovery rate.

    Writes DIR/comparison.ply (the mean with difference, along_normal, t_squared, p, p_corrected and q at each point),
    DIR/points.csv (the same as a table), DIR/mean-GROUP.ply (the mean of each group, which may be the template of
    another collection) and DIR/comparison.json.

    Examples:
      homolog compare skulls --groups groups.csv -o patients

      homolog compare skulls --groups groups.csv --between controls patients --permutations 100000
    """
    models = homolog.shape_models
    check_folder(output, names=models.COMPARISON_FILES)
    stored = models.StoredModel.read(collection)
    named = models.read_groups(groups, stored.names)
    with progress_bar(quiet=quiet) as progress:
        found = models.compared_groups(stored, named, between, permutations=permutations, seed=seed, progress=progress)
        paths = models.write_comparison(output, found, files=[groups])
    if not quiet:
        _summary(found, len(stored.names))
        tell_files(paths)


def _summary(found: homolog.shape_models.ComparedGroups, n_shapes: int) -> None:
    figures, (first, second) = found.figures(), found.groups
    compared = sum(map(len, found.members))
    if compared < n_shapes:
        say(f"Note: {n_shapes - compared} of the collection's {n_shapes} shapes are in neither group.")
    how = "all" if figures["is_exact"] else "drawn"
    say(
        f"{second} ({len(found.members[1])}) less {first} ({len(found.members[0])}): p = {figures['p_overall']:.3g} "
        f"({figures['permutations']} {how} relabellings); {figures['points_below_level_corrected']} of "
        f"{figures['points']} points differ at {figures['level']:g} corrected, "
        f"{figures['points_below_level_of_false_discoveries']} at that rate of false discoveries."
    )
