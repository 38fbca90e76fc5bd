"""``homolog demo``: match the two bodies that come with the package."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import typer

import homolog
from homolog.cli.options import Quiet, ResultOutput, build_matcher, check_folder
from homolog.cli.progress import progress_bar, tell_files
from homolog.core.progress import Timings

_SOURCE, _TARGET = "amber", "boris"
_LARGEST_ERROR = 5.0
# Points this far from the middle, as a share of the body's width, are clearly left or right.
_LATERAL = 0.1


def demo(
    output: ResultOutput = Path("homolog-demo"),
    quiet: Quiet = False,
) -> None:
    """Match the two bodies that come with the package, and compare with the ground truth.

    Two different people in different poses, meshed separately (CC0). Fails if the mean geodesic error x100 is above 5.

    Examples:
      homolog demo -o homolog-demo
    """
    from homolog.cli.match import counted

    check_folder(output, names=homolog.matching.RESULT_FILES)
    folder = homolog.datasets.demo_folder()
    files = [folder.file(name) for name in (_SOURCE, _TARGET)]
    with progress_bar(quiet=quiet) as progress:
        timings = Timings(listener=counted(progress))
        found = build_matcher(None, "auto", "auto", no_cache=True).match(files[0], files[1], timings=timings)
        paths = homolog.matching.write_folder(output, found, timings=timings)
    source = folder.shape(_SOURCE)
    truth, asked = folder.template_correspondence(_SOURCE), folder.template_correspondence(_TARGET)
    errors = 100 * homolog.evaluation.geodesic_errors(source, truth, found.target_to_source[asked])
    sides = _same_side(source, truth, found.target_to_source[asked])
    if not quiet:
        _show(found, errors, sides, timings, output, paths)
    if errors.mean() > _LARGEST_ERROR:
        typer.echo(f"The mean error is {errors.mean():.2f}, above {_LARGEST_ERROR:g}: something is wrong.", err=True)
        raise typer.Exit(1)


def _same_side(source: homolog.Shape, truth: np.ndarray, mapped: np.ndarray) -> float:
    """Share of clearly left or right points that are mapped to their own side of the source."""
    across = source.points[:, 0] - np.median(source.points[:, 0])
    lateral = np.abs(across[truth]) > _LATERAL * np.ptp(across)
    return float(np.mean(np.sign(across[truth]) == np.sign(across[mapped]), where=lateral))


def _show(
    found: homolog.Match, errors: np.ndarray, sides: float, timings: Timings, output: Path, paths: list[Path]
) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"{_SOURCE} to {_TARGET}", show_header=False, title_justify="left")
    table.add_row("points", f"{len(found.source_to_target)} and {len(found.target_to_source)}")
    table.add_row("method", found.method)
    table.add_row("mean geodesic error x100", f"{errors.mean():.2f}")
    table.add_row("median, 95th percentile", f"{np.median(errors):.2f}, {np.percentile(errors, 95):.2f}")
    verdict = "right" if sides > 0.95 else "mixed up"
    table.add_row("left and right", f"{verdict}: {100 * sides:.1f} % of lateral points on their own side")
    table.add_row("seconds, from reading to writing", f"{sum(step.seconds for step in timings.finished):.1f}")
    console = Console()
    console.print(table)
    console.print(f"Look at it: homolog view {output} --html view.html", highlight=False, soft_wrap=True)
    tell_files(paths)
