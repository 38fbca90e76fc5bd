"""``homolog info``: what is in a file, and what would be repaired."""

from __future__ import annotations

from json import dumps
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from homolog.core.errors import HomologError
from homolog.shapes import Report, check, read_shape


def info(
    files: Annotated[list[Path], typer.Argument(help="Meshes and point clouds in any format.", show_default=False)],
    json: Annotated[bool, typer.Option("--json", help="Print one JSON list instead of tables.")] = False,
) -> None:
    """Show what is in each file and what would be repaired before matching.

    Examples:
      homolog info horse.ply
      homolog info scans/*.obj --json > scans.json

    A file that cannot be used is one line on stderr; the others are still shown, and the exit code is 2.
    """
    out, errors = Console(), Console(stderr=True)
    entries, failed = list[dict[str, Any]](), False
    for file in files:
        try:
            report = check(read_shape(file))
        except HomologError as error:
            failed = True
            errors.print(f"[bold red]Error:[/] {escape(str(error))}", soft_wrap=True, highlight=False)
            entries.append({"file": str(file), "error": str(error)})
            continue
        failed |= not report.usable
        entries.append({"file": str(file), "format": _format(file), **report.to_dict()})
        if not json:
            out.print(_table(file, report))
    if json:
        typer.echo(dumps(entries, indent=2, allow_nan=False))
    if failed:
        raise typer.Exit(2)


def _format(file: Path) -> str:
    return file.suffix[1:].upper()


def _table(file: Path, report: Report) -> Table:
    table = Table(title=escape(str(file)), show_header=False, title_justify="left", title_style="bold")
    for label, value in _rows(file, report):
        table.add_row(label, escape(value))
    styles = {"note": "", "repaired": "yellow", "unusable": "bold red"}
    for finding in report.findings:
        table.add_row(finding.severity, escape(str(finding)), style=styles[finding.severity])
    return table


def _rows(file: Path, report: Report) -> list[tuple[str, str]]:
    rows = [
        ("format", _format(file)),
        ("modality", report.modality),
        ("points", _changed(report.n_points, report.n_clean_points)),
        ("extent", f"{report.extent:.6g} (diagonal of the bounding box)"),
    ]
    if report.modality == "mesh":
        rows.insert(3, ("faces", _changed(report.n_faces, report.n_clean_faces)))
    if report.area is not None:
        rows += [
            ("surface area", f"{report.area:.6g}"),
            ("components", str(report.n_components)),
            ("boundary loops", str(report.n_boundary_loops)),
        ]
    return rows


def _changed(given: int, left: int) -> str:
    return f"{given}" if given == left else f"{given}, {left} after repair"
