"""``homolog reproduce``: an experiment of the paper, from datasets to a table."""

from __future__ import annotations

import sys
from collections import defaultdict
from pathlib import Path
from typing import Annotated

import typer

import homolog
from homolog.cli.options import (
    INPUT,
    METHOD,
    OUTPUT,
    Changes,
    DeviceOption,
    Quiet,
    Seed,
    Verbose,
    changes_of,
    set_verbosity,
)
from homolog.cli.progress import progress_bar, say
from homolog.cli.wording import in_options
from homolog.core.errors import ArgumentError, bad_choice

_COLUMNS = ("name", "title", "rows", "data", "trainings, minutes")


def reproduce(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME",
            help="The experiment, from homolog reproduce --list.",
            show_default=False,
            autocompletion=lambda: list(homolog.reproduction.experiment_names()),
        ),
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(
            "--data",
            metavar="DIR",
            help="The folder that holds the datasets as subfolders: FAUST_r, SCAPE_r, SHREC19 and others.",
            show_default=False,
            rich_help_panel=INPUT,
        ),
    ] = None,
    weights: Annotated[
        str | None,
        typer.Option(
            "--weights",
            metavar="NAME|FILE",
            help="Use these trained weights for all rows, but those that are about a training.",
            show_default="those that were trained before into the same folder",
            rich_help_panel=METHOD,
        ),
    ] = None,
    train: Annotated[
        bool, typer.Option("--train", help="Train what is needed and not there yet.", rich_help_panel=METHOD)
    ] = False,
    changes: Changes = None,
    n_pairs: Annotated[
        int | None,
        typer.Option(
            "--n-pairs",
            "-n",
            metavar="N",
            help="For a quick look: draw so many pairs of different shapes of each dataset at random.",
            min=1,
            rich_help_panel=INPUT,
        ),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--only",
            metavar="ROW",
            help="Rows whose names contain this, such as FAUST_r or cloud; may be given several times.",
            show_default="all rows",
            rich_help_panel=INPUT,
        ),
    ] = None,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            help="Folder for cells, tables, pictures and trainings; all experiments can share one.",
            rich_help_panel=OUTPUT,
        ),
    ] = Path("reproduced"),
    list_them: Annotated[
        bool, typer.Option("--list", help="List the experiments: data that each needs, what it trains, and how long.")
    ] = False,
    seed: Seed = 0,
    device: DeviceOption = "auto",
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Run an experiment of the paper, from datasets to a table.

    Each row is measured twice: in the paper's setting, with poses as given and without search and refinement, and in
    ours, with the defaults of homolog evaluate. Writes a JSON file for each cell, with the command that makes it alone,
    and a table with the paper's figures beside, the curves of correct points, and a picture of a match of each cell.

    Cells that are there, made with the same settings, weights and data, are not made again. Ctrl-C leaves whole cells
    and checkpoints; the same command goes on. Cells whose data or weights are not there stay empty.

    Examples:
      homolog reproduce --list

      homolog reproduce complete --data benchmarks --weights people -n 20

      homolog reproduce complete --data benchmarks --train

      homolog reproduce noise --data benchmarks --weights people --only FAUST_r
    """
    set_verbosity(quiet=quiet, verbose=verbose)
    if list_them:
        _list()
        return
    names = homolog.reproduction.experiment_names()
    if name is None:
        raise ArgumentError(f"NAME is missing, but must be one of {', '.join(names)}; --list tells what they are")
    if name not in names:
        raise bad_choice("NAME", name, names, "--list tells what they are")
    if data is None:
        needed = ", ".join(homolog.reproduction.read_experiment(name).folders)
        raise ArgumentError(f"--data is missing; give the folder that holds {needed} as subfolders")
    settings = homolog.reproduction.ReproductionSettings(
        weights=weights,
        train=train,
        n_pairs=n_pairs,
        only=tuple(only or ()),
        seed=seed,
        changes=changes_of(changes),
        device=device,
    )
    with progress_bar(quiet=quiet) as progress:
        done = homolog.reproduction.reproduce(name, data, output, settings, progress=progress)
    if not quiet:
        cells_of = defaultdict[str, int](int)
        for reason in done.empty.values():
            cells_of[reason] += 1
        for reason, count in cells_of.items():
            say(f"{count} {'cell stays' if count == 1 else 'cells stay'} empty: {in_options(reason)}.")
        say(f"{done.made} cells made, {done.found} were there.")
        typer.echo(done.report)


def _list() -> None:
    """A table on a terminal; elsewhere lines with tabs between the columns."""
    from homolog.reproduction import experiment_names, read_experiment

    rows = [
        (
            each.name,
            each.title,
            str(len(each.rows)),
            ", ".join(each.folders),
            ", ".join(f"{plan.name} {plan.minutes}" for plan in each.trainings),
        )
        for each in map(read_experiment, experiment_names())
    ]
    if not sys.stdout.isatty():
        typer.echo("\n".join("\t".join(row) for row in (_COLUMNS, *rows)))
        return
    from rich.console import Console
    from rich.table import Table

    table = Table(*_COLUMNS)
    for row in rows:
        table.add_row(*row)
    Console().print(table)
