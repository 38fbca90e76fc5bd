"""``homolog data``: the sets of shapes that are known, and whether a folder holds one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from homolog.cli.options import Quiet
from homolog.cli.progress import progress_bar
from homolog.datasets import (
    DatasetDescription,
    DatasetReport,
    builtin_descriptions,
    check_dataset,
    counted,
    read_description,
)

data = typer.Typer(name="data", no_args_is_help=True, help="Sets of shapes: which are known, and checking a folder.")

SetName = Annotated[
    str,
    typer.Argument(metavar="NAME", help="Of a set that homolog data list knows, or a TOML file.", show_default=False),
]

_COLUMNS = ("name", "title", "shapes", "truth", "terms")


@data.command(name="list")
def list_sets() -> None:
    """List the sets of shapes that evaluate and train know by name.

    A table on a terminal; elsewhere lines with tabs between the columns.

    Examples:
      homolog data list

      homolog data list | cut -f 1
    """
    rows = [_row(description) for description in builtin_descriptions()]
    console = Console()
    if not console.is_terminal:
        typer.echo("\n".join("\t".join(row) for row in (_COLUMNS, *rows)))
        return
    table = Table(*_COLUMNS)
    for row in rows:
        table.add_row(*map(escape, row))
    console.print(table)


def _row(description: DatasetDescription) -> tuple[str, ...]:
    count = description.expected_shapes
    return description.name, description.title, f"{count:,}" if count else "", description.truth, description.terms


@data.command()
def show(name: SetName) -> None:
    """Show what is known of a set: where to get it, on which terms, what lies where, and how it is scored.

    Examples:
      homolog data show faust_r

      homolog data show my_set.toml
    """
    described = read_description(name)
    table = Table(title=escape(described.title or described.name), show_header=False, title_justify="left")
    for label, value in _facts(described):
        if value:
            table.add_row(label, escape(value))
    Console().print(table)


def _facts(described: DatasetDescription) -> list[tuple[str, str]]:
    truth = "" if described.truth in ("same-numbering", "none") else f", {described.truth_files}"
    kept = f"; test without {', '.join(described.left_out)}" if described.left_out else ""
    return [
        ("where to get it", described.source),
        ("terms", described.terms),
        ("citation", described.citation),
        (described.holds, f"{described.shapes}{_number(described.expected_shapes)}"),
        ("complete shapes", _complete(described)),
        ("up", f"+{described.up}"),
        ("unit", described.unit),
        ("ground truth", f"{described.truth}{truth}"),
        ("split", f"{described.split}{_split(described)}"),
        ("pairs", f"{described.pairs}{_number(described.n_pairs)}{kept}"),
        ("partial", ("in place" if described.pre_aligned else "yes") if described.partial else ""),
        ("notes", described.notes),
    ]


def _complete(described: DatasetDescription) -> str:
    return described.full and f"{described.full}{_number(len(described.expected_full_names))}"


def _number(count: int) -> str:
    return f", {count:,}" if count else ""


def _split(described: DatasetDescription) -> str:
    counts = {"train": described.n_train, "test": described.n_test}
    return "".join(f", {split} {count:,}" for split, count in counts.items() if count)


@data.command()
def check(
    name: SetName,
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Where the set lies.", show_default=False)],
    quiet: Quiet = False,
) -> None:
    """Read every file of a set, and compare with what is known of it.

    What is missing or wrong is a line each on stderr, and the exit code is 2; it is 0 if all is as it should be.

    Examples:
      homolog data check faust_r FAUST_r

      homolog data check shrec16_cuts SHREC16

      homolog data check own scans
    """
    described = read_description(name)
    with progress_bar(quiet=quiet) as progress:
        report = check_dataset(folder, described, progress=progress)
    if not quiet and report.n_shapes:
        Console().print(_summary(report, described))
    errors = Console(stderr=True, highlight=False)
    for finding in report.findings:
        errors.print(f"[bold red]Error:[/] {escape(finding)}", soft_wrap=True)
    if report.findings:
        raise typer.Exit(2)


def _summary(report: DatasetReport, described: DatasetDescription) -> Table:
    n = len(report.findings)
    verdict = f"{n} finding{'s' if n > 1 else ''}" if n else "as it should be"
    title = f"{described.name} at {report.root}: {verdict}"
    table = Table("", "", title=escape(title), show_header=False, title_justify="left", title_style="bold")
    table.columns[1].overflow = "fold"  # a checksum that is cut short is none
    for label, value in _counts(report, described):
        if value:
            table.add_row(label, value)
    return table


def _counts(report: DatasetReport, described: DatasetDescription) -> list[tuple[str, str]]:
    parts = "parts" if described.full else "volumes" if described.holds == "volumes" else "shapes"
    return [
        (parts, _of(report.n_shapes, described.expected_shapes)),
        ("complete shapes", _of(report.n_full, len(described.expected_full_names))),
        ("points", counted(report.n_points)),
        ("points with ground truth", counted(report.n_truth)),
        *((f"split {split!r}", _sizes(report, split)) for split in report.splits),
        ("checksum", report.sha256),
    ]


def _of(found: int, wanted: int) -> str:
    return f"{found:,}" + (f" of {wanted:,}" if wanted else "") if found or wanted else ""


def _sizes(report: DatasetReport, split: str) -> str:
    pairs = report.pairs.get(split, 0)
    return f"{report.splits[split]:,} shapes" + (f", {pairs:,} pairs" if pairs else "")
