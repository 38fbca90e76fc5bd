"""Draw how trainings went: scores of held-out pairs, and the validation loss, against minutes.

Run from the root of the checkout::

    python tools/plot_training.py results/faust/report.json results/scape/report.json -o docs/images/training.png
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

_SCORES = {"geodesic error/mesh": "meshes", "geodesic error/cloud": "clouds"}
_LOSS = "validation/total"


def draw(reports: list[dict[str, Any]], picture: Path) -> None:
    """One column for each training: scores above, the loss below."""
    figure = Figure(figsize=(4.5 * len(reports), 5.0), layout="constrained")
    axes = figure.subplots(2, len(reports), sharex="col", squeeze=False)
    for column, report in zip(axes.T, reports, strict=True):
        records = report["validations"]
        column[0].set_title(f"{report['recipe']['name']}: {report['shapes']} shapes, {report['steps']:,} steps")
        for key, label in _SCORES.items():
            scored = [(record["minutes"], record[key]) for record in records if key in record]
            column[0].plot(*zip(*scored, strict=True), marker="o", label=label)
        column[0].set_ylabel("error x100 of held-out pairs")
        column[0].set_ylim(0, 3.5)
        column[0].legend()
        column[1].plot([record["minutes"] for record in records], [record[_LOSS] for record in records], color="0.3")
        column[1].set_ylabel("validation loss")
        column[1].set_ylim(bottom=0)
        column[1].set_xlabel("minutes on two cores")
        column[1].set_xlim(left=0)
        for axis in column:
            axis.grid(alpha=0.3)
    figure.savefig(picture, dpi=150)


def main() -> None:
    """Read the reports and draw them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reports", nargs="+", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    arguments = parser.parse_args()
    draw([json.loads(path.read_text(encoding="utf-8")) for path in arguments.reports], arguments.output)


if __name__ == "__main__":
    main()
