"""``homolog track``: one shape through time."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

import homolog
from homolog.cli.options import (
    INPUT,
    METHOD,
    DeviceOption,
    MethodOption,
    NoCache,
    OrientOption,
    Quiet,
    ResumedOutput,
    UpOfAll,
    Verbose,
    Weights,
    build_matcher,
    check_folder,
    check_inputs,
    set_verbosity,
)
from homolog.cli.progress import progress_bar, say, say_error, tell_files
from homolog.cli.wording import in_options
from homolog.core.errors import ArgumentError

if TYPE_CHECKING:
    pass


def track(
    frames: Annotated[
        list[Path],
        typer.Argument(
            metavar="FRAMES...",
            help="Shapes in the order of time, or one folder of them, which are taken in the order of their numbers.",
            show_default=False,
        ),
    ],
    up: UpOfAll = "y",
    as_cloud: Annotated[
        bool, typer.Option("--as-cloud", help="Use only the points of the frames.", rich_help_panel=INPUT)
    ] = False,
    orient: OrientOption = "auto",
    follow: Annotated[
        Literal["first", "previous"],
        typer.Option(
            help="first: points come from the map of the first frame to each, whose errors do not add up. previous: "
            "from the maps of frame to frame.",
            rich_help_panel=METHOD,
        ),
    ] = "first",
    method: MethodOption = "auto",
    weights: Weights = None,
    output: ResumedOutput = Path("track"),
    device: DeviceOption = "auto",
    no_cache: NoCache = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Follow the points of a shape through time: the first frame's mesh in the pose of every frame.

    Each frame is matched to the first one and to the one before it. Their drift, how far both ways to the same point
    lead apart, tells where a map has lost its way.

    Writes DIR/frames/NAME.ply (the first frame's points and faces on each frame), DIR/points.npy (their trajectories,
    frames x points x 3), DIR/drift.csv (a row per frame), DIR/drift.ply (the mean drift of each point) and
    DIR/track.json. A frame that cannot be matched is one line on stderr and NaN in points.npy; the others are still
    written, and the exit code is 2.

    The same command resumes where it was stopped, and redoes frames that changed, with those after them; more frames
    can be given then, and another --follow.

    Examples:
      homolog track scans -o motion

      homolog track heart0.ply heart1.ply heart2.ply -o beat --method registration --follow previous
    """
    set_verbosity(quiet=quiet, verbose=verbose)
    files = _files(frames)
    check_inputs(files[0], weights=weights)
    models = homolog.shape_models
    check_folder(output, names=[*models.TRACK_FILES, *(f"frames/{file.stem}.ply" for file in files)])
    with progress_bar(quiet=quiet) as progress:
        matcher = build_matcher(weights, method, device, no_cache=no_cache)
        found = models.track(
            files,
            matcher,
            follow=follow,
            up=up,
            as_cloud=as_cloud,
            orient=orient,
            output=output,
            progress=progress,
            listener=say_error,
        )
        paths = models.write_track(output, found, files=files)
    if not quiet:
        for frame in found.frames:
            for warning in frame.warnings:
                say(f"Warning: {frame.subject.name}: {in_options(warning)}")
        shares = [share for frame in found.frames if (share := frame.figures()["drift_of_size"]) is not None]
        told = f" Drift: {100 * sum(shares) / len(shares):.1f} % of sqrt(area) on average." if shares else ""
        failed = sum(bool(frame.error) for frame in found.frames)
        say(f"Followed {found.first.n_points} points through {len(files) - failed} of {len(files)} frames.{told}")
        tell_files(paths)
    if any(frame.error for frame in found.frames):
        raise typer.Exit(2)


def _files(frames: list[Path]) -> list[Path]:
    """The frames, or those in a folder, in the order of the numbers in their names."""
    if len(frames) != 1 or not frames[0].is_dir():
        return frames
    suffixes = homolog.shapes.folder_suffixes(clouds=True)
    files = [path for path in frames[0].iterdir() if path.suffix.lower() in suffixes]
    if len(files) < 2:
        raise ArgumentError(f"{frames[0]} holds {len(files)} shapes, but a track needs two frames or more")
    return sorted(
        files, key=lambda path: [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", path.name)]
    )
