"""``homolog data``: the datasets that are known, and whether a folder holds one."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import homolog
from homolog.cli.lazy import lazy_typer
from homolog.cli.options import Quiet
from homolog.cli.progress import progress_bar, stderr_console

if TYPE_CHECKING:
    from rich.table import Table

    from homolog.datasets import DatasetDescription, DatasetReport

data = lazy_typer(
    "data",
    help="Datasets: which are known, and checking a folder.",
    list="homolog.cli.data:list_datasets",
    show="homolog.cli.data:show",
    check="homolog.cli.data:check",
)

DatasetName = Annotated[
    str,
    typer.Argument(metavar="NAME", help="A name from homolog data list, or a TOML file.", show_default=False),
]

_COLUMNS = ("name", "title", "shapes", "truth", "terms")


def list_datasets() -> None:
    """List the datasets that evaluate and train know by name.

    A table on a terminal; elsewhere lines with tabs between the columns.

    Examples:
      homolog data list

      homolog data list | cut -f 1
    """
    rows = [
        (each.name, each.title, f"{each.expected_shapes:,}" if each.expected_shapes else "", each.truth, each.terms)
        for each in homolog.datasets.builtin_descriptions()
    ]
    if not sys.stdout.isatty():
        typer.echo("\n".join("\t".join(row) for row in (_COLUMNS, *rows)))
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(*_COLUMNS)
    for row in rows:
        table.add_row(*map(escape, row))
    Console().print(table)


def show(name: DatasetName) -> None:
    """Show what is known of a dataset: where to get it, its terms, what lies where, and how it is scored.

    Examples:
      homolog data show faust_r

      homolog data show my_set.toml
    """
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    described = homolog.datasets.read_description(name)
    table = Table(title=escape(described.title or described.name), show_header=False, title_justify="left")
    for label, value in _facts(described):
        if value:
            table.add_row(label, escape(value))
    Console().print(table)


def _facts(described: DatasetDescription) -> list[tuple[str, str]]:
    truth = "" if described.truth in ("same-numbering", "none") else f", {described.truth_files}"
    kept = f"; test without {', '.join(described.left_out)}" if described.left_out else ""
    counts = {"train": described.n_train, "test": described.n_test}
    split = "".join(f", {name} {count:,}" for name, count in counts.items() if count)
    return [
        ("where to get it", described.source),
        ("terms", described.terms),
        ("citation", described.citation),
        (described.holds, f"{described.shapes}{_number(described.expected_shapes)}"),
        ("full shapes", described.full and f"{described.full}{_number(len(described.expected_full_names))}"),
        ("up", f"+{described.up}"),
        ("unit", described.unit),
        ("ground truth", f"{described.truth}{truth}"),
        ("split", f"{described.split}{split}"),
        ("pairs", f"{described.pairs}{_number(described.n_pairs)}{kept}"),
        ("partial", {False: "", True: "yes", "both": "both shapes"}[described.partial]),
        ("pre-aligned", "yes" if described.pre_aligned else ""),
        ("notes", described.notes),
    ]


def _number(count: int) -> str:
    return f", {count:,}" if count else ""


def check(
    name: DatasetName,
    folder: Annotated[Path, typer.Argument(metavar="DATA", help="The dataset's folder.", show_default=False)],
    quiet: Quiet = False,
) -> None:
    """Read every file of a dataset, and compare with what is known of it.

    Everything that is missing or wrong is one line on stderr, and the exit code is 2; it is 0 if nothing is.

    Examples:
      homolog data check faust_r FAUST_r

      homolog data check shrec16_cuts SHREC16

      homolog data check own scans
    """
    from rich.console import Console
    from rich.markup import escape

    described = homolog.datasets.read_description(name)
    with progress_bar(quiet=quiet) as progress:
        report = homolog.datasets.check_dataset(folder, described, progress=progress)
    if not quiet and report.n_shapes:
        n = len(report.findings)
        verdict = f"{n} finding{'s' if n > 1 else ''}" if n else "nothing is missing or wrong"
        # Not in the table, which breaks a long path over lines.
        typer.echo(f"{described.name} at {report.root}: {verdict}")
        Console().print(_summary(report, described))
    for finding in report.findings:
        stderr_console().print(f"[bold red]Error:[/] {escape(finding)}", soft_wrap=True)
    if report.findings:
        raise typer.Exit(2)


def _summary(report: DatasetReport, described: DatasetDescription) -> Table:
    from rich.table import Table

    table = Table("", "", show_header=False)
    table.columns[1].overflow = "fold"  # a checksum that is cut short is none
    for label, value in _counts(report, described):
        if value:
            table.add_row(label, value)
    return table


def _counts(report: DatasetReport, described: DatasetDescription) -> list[tuple[str, str]]:
    partial = "partial shapes" if described.full else "volumes" if described.holds == "volumes" else "shapes"
    pairs = {split: f", {number:,} pairs" for split, number in report.pairs.items() if number}
    return [
        (partial, _of(report.n_shapes, described.expected_shapes)),
        ("full shapes", _of(report.n_full, len(described.expected_full_names))),
        ("points", homolog.datasets.counted(report.n_points)),
        ("points with ground truth", homolog.datasets.counted(report.n_truth)),
        *((f"split {split!r}", f"{n:,} shapes{pairs.get(split, '')}") for split, n in report.splits.items()),
        ("checksum", report.sha256),
    ]


def _of(found: int, expected: int) -> str:
    return f"{found:,}" + (f" of {expected:,}" if expected else "") if found or expected else ""
