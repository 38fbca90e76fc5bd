"""Tables in Markdown of all cells that are found in a folder."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from homolog.core.files import atomic_path
from homolog.reproduction.cells import NO_WEIGHTS, stored_cells
from homolog.reproduction.experiments import COLUMNS, Experiment, Row, experiment_names, read_experiment

REPORT, TABLE = "report.md", "table.md"
"""The files with the tables of all experiments, and with that of one."""
_Key = tuple[str, str, str]
_Cells = Mapping[_Key, Mapping[str, Any]]
_LEGEND = (
    "Mean errors x100, in units of the square root of the area, of all pairs / of pairs of different shapes; in "
    "millimetres where a figure says so. A number of pairs is given where these are not all of the dataset. F1 tells "
    "how well points without a counterpart are found. Nobody has run what is empty."
)


def write_report(root: Path) -> Path:
    """Write the table of each experiment, and one report of all.

    Args:
        root: the folder that ``reproduce`` writes.
    """
    tables = []
    for name in experiment_names():
        if found := stored_cells(root / name):
            experiment = read_experiment(name)
            tables.append(table_of(experiment, chosen_cells(experiment, found)))
            _write(root / name / TABLE, tables[-1])
    _write(root / REPORT, "\n".join(["# Experiments", "", _LEGEND, "", *tables]))
    return root / REPORT


def chosen_cells(experiment: Experiment, cells: Iterable[Mapping[str, Any]]) -> dict[_Key, Mapping[str, Any]]:
    """One cell for each row, column and origin of weights, in the order of the table: the one of the most pairs, and of
    these the newest.
    """
    ordered = sorted(cells, key=lambda cell: (cell["figures"]["pairs"], cell["date"]))
    found = {(cell["row"], cell["column"], cell["made_by"]): cell for cell in ordered}
    origins = sorted({cell["made_by"] for cell in ordered})
    keys = product([row.name for row in experiment.rows], COLUMNS, origins)
    return {key: found[key] for key in keys if key in found}


def table_of(experiment: Experiment, cells: _Cells) -> str:
    """The table of an experiment in Markdown, and what made each cell.

    Args:
        experiment: whose rows the table has.
        cells: by row, column and origin of weights.
    """
    lines = [f"## {experiment.title}", "", f"`homolog reproduce {experiment.name}`. {experiment.about}", ""]
    return "\n".join([*lines, figure_table(experiment.rows, cells), "", *_makers(cells)])


def figure_table(rows: Sequence[Row], cells: _Cells) -> str:
    """The figures of some rows beside the paper's, in Markdown.

    Args:
        rows: of the table; without the paper's figures if none has one.
        cells: by row, column and origin of weights. A line says whose weights all rows are measured with, or a column
            does for each; rows that are measured with several have a column for each of them.
    """
    weights_of = {row.name: sorted({key[2] for key in cells if key[0] == row.name} - {NO_WEIGHTS}) for row in rows}
    weights = sorted({origin for found in weights_of.values() for origin in found})
    told = ["the paper"] if any(row.paper is not None for row in rows) else []
    origins, shown = (NO_WEIGHTS, *weights), {key[1:] for key in cells}
    columns: list[tuple[str, tuple[str, ...]]]
    if any(len(found) > 1 for found in weights_of.values()):
        columns = [(column, (origin,)) for column, origin in product(COLUMNS, origins) if (column, origin) in shown]
        heads = [f"{COLUMNS[column].title}, {''.join(origin)}" for column, origin in columns]
    else:
        columns = [(each, origins) for each in COLUMNS if any(column == each for column, _ in shown)]
        heads = [COLUMNS[column].title for column, _ in columns]
        told = ["weights", *told] if len(weights) > 1 else told
    lines = [f"Weights: {weights[0]}.", ""] if len(weights) == 1 else []
    lines += [_line(["", *told, *heads]), _line(["---"] * (1 + len(told) + len(heads)))]
    for row in rows:
        texts = {"weights": "".join(weights_of[row.name]), "the paper": "" if row.paper is None else f"{row.paper:.1f}"}
        keys = [[(row.name, column, origin) for origin in each] for column, each in columns]
        found = [next((cells[key] for key in each if key in cells), None) for each in keys]
        lines.append(_line([row.name, *(texts[head] for head in told), *map(_shown, found)]))
    return "\n".join(lines)


def _shown(cell: Mapping[str, Any] | None) -> str:
    """The figures of a cell, as a table shows them."""
    if cell is None:
        return ""
    figures = cell["figures"]
    text = f"{figures['mean']:.2f}"
    if figures["self_pairs"] and figures["mean_without_self_pairs"] is not None:
        text += f" / {figures['mean_without_self_pairs']:.2f}"
    text += "" if figures["unit"].startswith("sqrt") else f" {figures['unit']}"
    text += "" if figures["f1"] is None else f", F1 {figures['f1']:.3f}"
    return text if figures["is_whole"] else f"{text} ({figures['pairs']} pairs)"


def _makers(cells: _Cells) -> list[str]:
    heads = ["cell", "pairs", "seconds", "machine", "date", "version, commit", "seed", "command"]
    lines = ["<details><summary>How each cell was made</summary>", "", _line(heads), _line(["---"] * len(heads))]
    for cell in cells.values():
        trained = cell["training"]
        steps = [f"`{trained['command']}` ({trained['steps']} steps), then "] if trained else []
        lines.append(
            _line(
                [
                    f"{cell['row']}: {COLUMNS[cell['column']].title}",
                    cell["figures"]["pairs"],
                    f"{cell['seconds']:.0f}",
                    f"{cell['machine']}, {cell['device']}",
                    cell["date"],
                    f"{cell['version']}, {cell['commit'] or 'no checkout'}",
                    cell["seed"],
                    "".join([*steps, f"`{cell['command']}`"]),
                ]
            )
        )
    return [*lines, "", "</details>", ""]


def _line(cells: Iterable[Any]) -> str:
    return "| " + " | ".join(str(cell).replace("|", r"\|") for cell in cells) + " |"


def _write(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="replace", newline="\n")
