"""``homolog match``: two files in, a correspondence out."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from homolog.cli.options import (
    DeviceOption,
    MethodOption,
    NoCache,
    Quiet,
    Verbose,
    Weights,
    build_matcher,
    check_folder,
    described,
    set_verbosity,
)
from homolog.cli.progress import Report, progress_bar
from homolog.errors import ShapeError
from homolog.files import sha256
from homolog.matching import AsCloud, Correspondence, Matcher, Prepared, Side, write_result
from homolog.shapes import Shape, Up, files_of_shape, read_shape, stand_upright
from homolog.steps import Listener, Steps
from homolog.versions import versions

# read, repair, operators and features for each shape, the map, the check of the orientation, and writing.
_STEPS = 11


def match(
    source: Annotated[Path, typer.Argument(help="The shape whose positions give the colours.", show_default=False)],
    target: Annotated[Path, typer.Argument(help="The shape to match it to.", show_default=False)],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="OUT", help="Folder for the result.")] = Path(
        "match"
    ),
    weights: Weights = None,
    method: MethodOption = "auto",
    as_cloud: Annotated[AsCloud | None, typer.Option(help="Use only the points of this shape.")] = None,
    partial: Annotated[
        Side | None,
        typer.Option(help="This shape is a part of one like the other, in the same units; points may have no match."),
    ] = None,
    up: Annotated[Up, typer.Option(help="The axis that points up in both files.")] = "y",
    source_up: Annotated[Up | None, typer.Option(help="The axis that points up in the source, if it differs.")] = None,
    target_up: Annotated[Up | None, typer.Option(help="The axis that points up in the target, if it differs.")] = None,
    device: DeviceOption = "auto",
    strict: Annotated[bool, typer.Option("--strict", help="Stop at anything to repair or to warn of.")] = False,
    no_cache: NoCache = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Match two shapes: for every point of each, the corresponding point of the other.

    Writes OUT/correspondence.npz (point indices both ways and confidences), OUT/source.ply and OUT/target.ply (same
    colour, same point) and OUT/report.json.

    Examples:
      homolog match cat.off lion.obj -o result --weights animals.safetensors

      homolog match scan.ply template.obj -o result --partial source --source-up z

      homolog match a.ply b.xyz -o result --method axiomatic
    """
    set_verbosity(quiet=quiet, verbose=verbose)
    check_folder(output, inputs=(source, target))
    ups: dict[Side, Up] = {"source": source_up or up, "target": target_up or up}
    with progress_bar(quiet=quiet) as progress:
        steps = Steps(listener=counted(progress, verbose=verbose))
        job = Job({"source": source, "target": target}, ups, build_matcher(weights, method, device, no_cache=no_cache))
        outcome = job.run(steps, as_cloud=as_cloud, partial=partial, strict=strict)
        options = {"method": method, "as_cloud": as_cloud, "partial": partial, "up": ups, "strict": strict}
        with steps.step("write"):
            paths = outcome.write(output, steps, {"options": options, **described(job.matcher, weights)})
    if not quiet:
        _summary(outcome.found, steps, paths, verbose=verbose)


@dataclass(frozen=True)
class Outcome:
    """What a job read and found, and what is to be reported of its inputs."""

    shapes: dict[Side, Shape]
    found: Correspondence
    inputs: dict[Side, dict[str, Any]]

    def write(self, output: Path, steps: Steps, setup: dict[str, Any]) -> list[Path]:
        """Write the result and its report."""
        report = {
            "inputs": self.inputs,
            "route": self.found.route,
            "warnings": list(self.found.warnings),
            **setup,
            "matched": _matched(self.found),
            "steps": [asdict(step) for step in steps.finished],
            "versions": versions(),
        }
        return write_result(output, self.shapes["source"], self.shapes["target"], self.found, report)


@dataclass(frozen=True)
class Job:
    """One match of two files."""

    files: dict[Side, Path]
    ups: dict[Side, Up]
    matcher: Matcher

    def run(
        self, steps: Steps, *, as_cloud: AsCloud | None = None, partial: Side | None = None, strict: bool = False
    ) -> Outcome:
        """Read and match; in strict mode anything repaired or warned of is an error."""
        shapes: dict[Side, Shape] = {}
        inputs: dict[Side, dict[str, Any]] = {}
        for side, file in self.files.items():
            with steps.step(f"read {side}"):
                shapes[side], digest = _read(file)
            inputs[side] = {"file": str(file), "sha256": digest}
        upright = {side: stand_upright(shape, self.ups[side]) for side, shape in shapes.items()}
        source, target = self.matcher.prepare_pair(
            upright["source"], upright["target"], as_cloud=as_cloud, partial=partial, strict=strict, steps=steps
        )
        inputs["source"] |= _described(source)
        inputs["target"] |= _described(target)
        found = self.matcher.match_checked(source, target, partial=partial, strict=strict, steps=steps)
        return Outcome(shapes, found, inputs)


def _read(file: Path) -> tuple[Shape, str]:
    """A shape and the hash of the very bytes that it was read from, be they in one file or in several."""
    before = sha256(*files_of_shape(file))
    shape = read_shape(file)
    digest = sha256(*files_of_shape(file))
    if digest != before:
        raise ShapeError(f"{file} changed while it was read; try again once it is complete")
    return shape, digest


def _described(prepared: Prepared) -> dict[str, Any]:
    """What was found in a shape and done about it, and how its eigenpairs were found."""
    operators = prepared.operators
    eigenpairs = {"number": operators.n_eigenpairs, "method": operators.method}
    return {**prepared.repaired.report.to_dict(), "eigenpairs": eigenpairs}


def _matched(found: Correspondence) -> dict[str, Any]:
    return {
        "source_points": len(found.source_to_target),
        "source_points_without_counterpart": int((found.source_to_target < 0).sum()),
        "source_mean_confidence": float(found.source_confidence.mean()),
        "target_points": len(found.target_to_source),
        "target_points_without_counterpart": int((found.target_to_source < 0).sum()),
        "target_mean_confidence": float(found.target_confidence.mean()),
    }


def counted(progress: Report, *, verbose: bool = False) -> Listener:
    """A listener for the steps of a job that moves the progress bar on, and prints their names if ``verbose``."""
    console = Console(stderr=True, highlight=False)
    count = 0

    def listen(name: str) -> None:
        nonlocal count
        progress(count, _STEPS, name)
        count += 1
        if verbose:
            console.print(f"{name} ...")

    return listen


def _summary(found: Correspondence, steps: Steps, paths: list[Path], *, verbose: bool) -> None:
    console = Console(stderr=True, highlight=False, soft_wrap=True, markup=False)
    for warning in found.warnings:
        console.print(f"Warning: {warning}")
    if verbose:
        for step in steps.finished:
            console.print(f"{step.name:<24} {step.seconds:8.2f} s   peak {step.peak_mb:7.0f} MB")
    seconds = sum(step.seconds for step in steps.finished)
    sides = "; ".join(_side_summary(side, _matched(found)) for side in ("source", "target"))
    console.print(f"Matched by {found.route} in {seconds:.1f} s: {sides}.")
    for path in paths:
        typer.echo(path)


def _side_summary(side: str, matched: dict[str, Any]) -> str:
    without = matched[f"{side}_points_without_counterpart"]
    found = f"{without} without a counterpart" if without else "all matched"
    return (
        f"{side} {matched[f'{side}_points']} points, {found}, mean confidence {matched[f'{side}_mean_confidence']:.2f}"
    )
