"""Writes tables of docs/results.md anew, from cells of ``homolog reproduce``.

python tools/results_tables.py           # from results/reproduced, where the cells of the page's tables are kept
python tools/results_tables.py FOLDER    # from the folder that a run of one's own wrote

A table stands between the lines ``<!-- cells of NAME -->`` and ``<!-- end of cells -->``. NAME is an experiment's. It
has the rows that somebody ran.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from homolog.reproduction import read_experiment
from homolog.reproduction.cells import stored_cells
from homolog.reproduction.report import chosen_cells, figure_table

ROOT = Path(__file__).parents[1]
PAGE, CELLS = ROOT / "docs" / "results.md", ROOT / "results" / "reproduced"
_BLOCK = re.compile(r"(<!-- cells of (\w+) -->\n).*?(<!-- end of cells -->)", re.DOTALL)


def filled(text: str, reproduced: Path) -> str:
    """A page with the tables of the cells in a folder; where an experiment has none there, its table stays as it is."""

    def block(found: re.Match[str]) -> str:
        start, name, end = found.groups()
        table = _table(name, reproduced)
        return f"{start}\n{table}\n\n{end}" if table else found[0]

    return _BLOCK.sub(block, text)


def _table(name: str, reproduced: Path) -> str:
    """The rows of an experiment that there are cells of, and where these come from; empty if there are none."""
    experiment = read_experiment(name)
    cells = chosen_cells(experiment, stored_cells(reproduced / name))
    rows = [row for row in experiment.rows if any(key[0] == row.name for key in cells)]
    if not rows:
        return ""
    dates, commits = (sorted({str(cell[told]) for cell in cells.values()}) for told in ("date", "commit"))
    minutes = [cell["training"]["seconds"] / 60 for cell in cells.values() if cell["training"]]
    trained = f" A training took {min(minutes):.0f} to {max(minutes):.0f} minutes." if minutes else ""
    return f"{figure_table(rows, cells)}\n\n{', '.join(dates)}, commit {' and '.join(commits)}.{trained}"


def main() -> None:
    """Fill the page."""
    reproduced = Path(sys.argv[1]) if len(sys.argv) > 1 else CELLS
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8"), reproduced), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
