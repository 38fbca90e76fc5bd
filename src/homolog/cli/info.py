"""``homolog info``: what is in a file, and what would be repaired."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import homolog
from homolog.cli.options import Json, check_json, on_stdout, write_figures
from homolog.cli.progress import stderr_console
from homolog.core.errors import HomologError
from homolog.core.messages import one_line

if TYPE_CHECKING:
    from rich.table import Table


def info(
    files: Annotated[
        list[Path], typer.Argument(metavar="SHAPES...", help="Meshes and point clouds.", show_default=False)
    ],
    json: Json = None,
) -> None:
    """Show what is in each file and what would be repaired before matching.

    Examples:
      homolog info horse.ply

      homolog info scans/*.obj --json scans.json

    A file that cannot be used is one line on stderr; the others are still shown, and the exit code is 2.
    """
    from rich.console import Console
    from rich.markup import escape

    check_json(json)
    entries, failed = list[dict[str, Any]](), False
    for file in files:
        try:
            report = homolog.check(homolog.read_shape(file))
        except HomologError as error:
            failed = True
            stderr_console().print(f"[bold red]Error:[/] {escape(str(error))}", soft_wrap=True)
            entries.append({"file": str(file), "error": str(error)})
            continue
        failed |= not report.usable
        entries.append({"file": str(file), "format": _format(file), **report.to_dict()})
        if not on_stdout(json):
            typer.echo(one_line(file))  # not in the table, which breaks a long path over lines
            Console().print(_table(file, report))
    write_figures(json, entries)
    if failed:
        raise typer.Exit(2)


def _format(file: Path) -> str:
    return file.suffix[1:].upper()


def _table(file: Path, report: homolog.Report) -> Table:
    from rich.markup import escape
    from rich.table import Table

    table = Table(show_header=False)
    for label, value in _rows(file, report):
        table.add_row(label, escape(value))
    styles = {"note": "", "repaired": "yellow", "unusable": "bold red"}
    for finding in report.findings:
        table.add_row(finding.severity, escape(str(finding)), style=styles[finding.severity])
    return table


def _rows(file: Path, report: homolog.Report) -> list[tuple[str, str]]:
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
