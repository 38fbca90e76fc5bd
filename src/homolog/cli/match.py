"""``homolog match``: two files in, a correspondence out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import homolog
from homolog.cli.options import (
    INPUT,
    OUTPUT,
    PARTIAL,
    PICTURE_WIDTH,
    Adapt,
    DeviceOption,
    Lines,
    MethodOption,
    NoCache,
    Page,
    Picture,
    PictureWidth,
    PreAligned,
    Quiet,
    Verbose,
    Weights,
    build_matcher,
    check_file,
    check_folder,
    check_inputs,
    check_picture_file,
    described,
    set_verbosity,
)
from homolog.cli.progress import Report, progress_bar, say
from homolog.core.choices import AsCloud, Side, Up
from homolog.core.progress import Listener, Timings
from homolog.core.versions import versions

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float, Int

    from homolog.matching import Correspondence, Matcher, Prepared
    from homolog.shapes import Shape

# read, repair, operators and features for each shape, the map, the check of the orientation, and writing.
STEPS = 11


def match(
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="The shape whose positions give the colours.", show_default=False)
    ],
    target: Annotated[Path, typer.Argument(metavar="TARGET", help="The shape to match it to.", show_default=False)],
    as_cloud: Annotated[
        AsCloud | None, typer.Option(help="Use only the points of this shape.", rich_help_panel=INPUT)
    ] = None,
    up: Annotated[Up, typer.Option(help="The axis that points up in both files.", rich_help_panel=INPUT)] = "y",
    source_up: Annotated[
        Up | None, typer.Option(help="The axis that points up in the source, if it differs.", rich_help_panel=INPUT)
    ] = None,
    target_up: Annotated[
        Up | None, typer.Option(help="The axis that points up in the target, if it differs.", rich_help_panel=INPUT)
    ] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Stop at anything to repair or to warn of.", rich_help_panel=INPUT)
    ] = False,
    method: MethodOption = "auto",
    weights: Weights = None,
    adapt: Adapt = 0,
    partial: Annotated[
        Side | None,
        typer.Option(
            help="This shape is partial: a part of a shape like the other, whose points may then have no counterpart.",
            rich_help_panel=PARTIAL,
        ),
    ] = None,
    partial_scale: Annotated[
        float,
        typer.Option(
            metavar="FACTOR",
            help="Multiply the partial shape's lengths by this to bring them to the full one's units.",
            rich_help_panel=PARTIAL,
        ),
    ] = 1.0,
    pre_aligned: PreAligned = False,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for the result.", rich_help_panel=OUTPUT)
    ] = Path("match"),
    page: Page = None,
    picture: Picture = None,
    lines: Lines = 0,
    picture_width: PictureWidth = PICTURE_WIDTH,
    device: DeviceOption = "auto",
    no_cache: NoCache = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Match two shapes: for every point of each, the corresponding point of the other.

    Writes DIR/correspondence.npz (point indices both ways and confidences), DIR/source.ply and DIR/target.ply (the same
    colours on corresponding points) and DIR/report.json.

    Examples:
      homolog match cat.off lion.obj -o result --weights animals.safetensors

      homolog match scan.ply template.obj -o result --partial source --source-up z

      homolog match part.stl full.glb -o result --partial source --partial-scale 0.001

      homolog match a.ply b.xyz -o result --method axiomatic

      homolog match dancer.ply statue.ply -o result --html both.html --picture both.png --lines 20

      homolog match old.ply new.ply -o result --weights people.safetensors --adapt 15
    """
    set_verbosity(quiet=quiet, verbose=verbose)
    check_inputs(source, target, weights=weights)
    check_folder(output, inputs=(source, target), names=homolog.matching.RESULT_FILES)
    if page is not None:
        check_file(page)
    check_picture_file(picture, lines, picture_width)
    ups: dict[Side, Up] = {"source": source_up or up, "target": target_up or up}
    with progress_bar(quiet=quiet) as progress:
        timings = Timings(listener=counted(progress, STEPS + adapt + (adapt > 0), verbose=verbose))
        matcher = build_matcher(weights, method, device, no_cache=no_cache)
        job = Job({"source": source, "target": target}, ups, matcher, adapt)
        outcome = job.run(
            timings,
            as_cloud=as_cloud,
            partial=partial,
            partial_scale=partial_scale,
            pre_aligned=pre_aligned,
            strict=strict,
        )
        options = {
            "method": method,
            "adapt": adapt,
            "as_cloud": as_cloud,
            "partial": partial,
            "partial_scale": partial_scale,
            "pre_aligned": pre_aligned,
            "up": ups,
            "strict": strict,
        }
        paths = outcome.write(output, timings, {"options": options, **described(job.matcher, weights)})
    if page is not None:
        homolog.viewing.write_page(page, homolog.viewing.scene_of(homolog.matching.read_result(output)))
        paths.append(page)
    if picture is not None:
        scene = homolog.viewing.scene_of(homolog.matching.read_result(output))
        homolog.viewing.write_picture(picture, scene, width=picture_width, lines=lines)
        paths.append(picture)
    if not quiet:
        _summary(outcome, timings, paths, verbose=verbose)


@dataclass(frozen=True)
class Outcome:
    """What a job read and found, what is to be reported of its inputs, and how many points repair left out."""

    shapes: dict[Side, Shape]
    found: Correspondence
    inputs: dict[Side, dict[str, Any]]
    left_out: dict[Side, int]

    @property
    def matched(self) -> dict[Side, dict[str, int | float]]:
        """What became of the points of each shape."""
        found = self.found
        return {
            "source": _matched(found.source_to_target, found.source_confidence, self.left_out["source"]),
            "target": _matched(found.target_to_source, found.target_confidence, self.left_out["target"]),
        }

    def write(self, output: Path, timings: Timings, setup: dict[str, Any]) -> list[Path]:
        """Write the result, as one more step, and its report."""
        report = {
            "inputs": self.inputs,
            "route": self.found.route,
            "warnings": list(self.found.warnings),
            "quality": None if self.found.quality is None else self.found.quality.to_dict(),
            **setup,
            "matched": {f"{side}_{name}": n for side, matched in self.matched.items() for name, n in matched.items()},
            "versions": versions(),
        }
        return homolog.matching.write_result(
            output, self.shapes["source"], self.shapes["target"], self.found, report, timings=timings
        )


@dataclass(frozen=True)
class Job:
    """One match of two files."""

    files: dict[Side, Path]
    ups: dict[Side, Up]
    matcher: Matcher
    adapt: int = 0

    def run(
        self,
        timings: Timings,
        *,
        as_cloud: AsCloud | None = None,
        partial: Side | None = None,
        partial_scale: float = 1.0,
        pre_aligned: bool = False,
        strict: bool = False,
    ) -> Outcome:
        """Read and match; in strict mode anything repaired or warned of is an error."""
        shapes: dict[Side, Shape] = {}
        inputs: dict[Side, dict[str, Any]] = {}
        for side, file in self.files.items():
            with timings.measure(f"read {side}"):
                shapes[side], digest = homolog.shapes.read_hashed_shape(file)
            inputs[side] = {"file": str(file), "sha256": digest}
        source, target = self.matcher.prepare_pair(
            shapes["source"],
            shapes["target"],
            as_cloud=as_cloud,
            partial=partial,
            partial_scale=partial_scale,
            pre_aligned=pre_aligned,
            source_up=self.ups["source"],
            target_up=self.ups["target"],
            strict=strict,
            timings=timings,
        )
        inputs["source"] |= _described(source)
        inputs["target"] |= _described(target)
        matcher, source, target = self._adapted(source, target, partial, timings)
        found = matcher.match_checked(source, target, partial=partial, strict=strict, timings=timings)
        return Outcome(shapes, found, inputs, {"source": source.n_left_out, "target": target.n_left_out})

    def _adapted(
        self, source: Prepared, target: Prepared, partial: Side | None, timings: Timings
    ) -> tuple[Matcher, Prepared, Prepared]:
        if not self.adapt:
            return self.matcher, source, target
        settings = homolog.training.AdaptationSettings(steps=self.adapt)
        with timings.measure("adapt"):
            return homolog.training.adapt_to_pair(
                self.matcher, source, target, settings, partial=partial, listener=timings.listener
            )


def _described(prepared: Prepared) -> dict[str, Any]:
    """What was found in a shape and done about it, and how its eigenpairs were found."""
    operators = prepared.operators
    eigenpairs = {"number": operators.n_eigenpairs, "method": operators.method}
    return {**prepared.repaired.report.to_dict(), "eigenpairs": eigenpairs}


def _matched(
    indices: Int[np.ndarray, " n"], confidence: Float[np.ndarray, " n"], left_out: int
) -> dict[str, int | float]:
    return {
        "points": len(indices),
        "points_left_out": left_out,
        "points_without_counterpart": int((indices < 0).sum()) - left_out,
        "mean_confidence": float(confidence.mean()),
    }


def counted(progress: Report, total: int = STEPS, *, verbose: bool = False) -> Listener:
    """A listener for so many steps of a job that moves the progress bar on, and prints their names if ``verbose``."""
    count = 0

    def listen(name: str) -> None:
        nonlocal count
        progress(count, total, name)
        count += 1
        if verbose:
            say(f"{name} ...")

    return listen


def _summary(outcome: Outcome, timings: Timings, paths: list[Path], *, verbose: bool) -> None:
    for warning in outcome.found.warnings:
        say(f"Warning: {warning}")
    if verbose:
        for step in timings.finished:
            say(f"{step.name:<24} {step.seconds:8.2f} s   process peak {step.process_peak_mb:7.0f} MB")
    seconds = sum(step.seconds for step in timings.finished)
    sides = "; ".join(f"{side} {_in_words(matched)}" for side, matched in outcome.matched.items())
    say(f"Matched by {outcome.found.route} in {seconds:.1f} s (from reading to writing): {sides}.")
    for path in paths:
        typer.echo(path)


def _in_words(matched: dict[str, int | float]) -> str:
    reasons = {"points_left_out": "left out by repair", "points_without_counterpart": "without a counterpart"}
    missing = [f"{matched[name]} {reason}" for name, reason in reasons.items() if matched[name]] or ["all matched"]
    return f"{matched['points']} points, {', '.join(missing)}, mean confidence {matched['mean_confidence']:.2f}"
