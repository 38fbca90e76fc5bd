"""Options that several commands share."""

from __future__ import annotations

import logging
import os
import stat
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from homolog.core.errors import ArgumentError
from homolog.core.files import expanded
from homolog.features import DEFAULT_WEIGHTS
from homolog.geometry import OperatorCache, compute_operators
from homolog.matching import NEED_NO_WEIGHTS, Device, Matcher, MatcherSettings, Method
from homolog.viewing import WIDTHS, check_picture

Weights = Annotated[
    str | None,
    typer.Option(
        "--weights",
        metavar="NAME|FILE",
        help="Trained weights: a name that ships with the package, a .safetensors file, or a .pth that the paper's "
        "authors released. Those for people know no other shapes.",
        show_default=DEFAULT_WEIGHTS,
    ),
]
MethodOption = Annotated[
    Method,
    typer.Option(
        help="How maps are found. auto: functional maps between meshes, features wherever a cloud takes part or the "
        "weights are for shapes that stretch. elastic draws shapes that stand alike onto each other, such as organs, "
        "and axiomatic goes by form alone: they need no weights."
    ),
]
DeviceOption = Annotated[Device, typer.Option(help="Where to compute.")]
Adapt = Annotated[
    int,
    typer.Option(
        metavar="STEPS",
        help="Go on training a copy of the weights on each pair for so many steps, before it is matched; 0 for none.",
        min=0,
    ),
]
PreAligned = Annotated[
    bool,
    typer.Option(
        "--pre-aligned",
        help="The partial shape lies in the complete one's coordinates, about where it belongs, as a scan that was "
        "registered does. Without it only its form counts.",
    ),
]
SetOption = Annotated[
    str | None,
    typer.Option(
        "--dataset",
        metavar="NAME|FILE",
        help="Which set the folder holds: a name that homolog data list knows, or a TOML file. "
        "Without it the folder is one's own.",
        show_default=False,
    ),
]
Processes = Annotated[int, typer.Option(help="Processes that share the work.", min=1, show_default="one per core")]
Page = Annotated[
    Path | None,
    typer.Option("--html", metavar="FILE", help="Write one page of both shapes; it opens from disk, without network."),
]
Picture = Annotated[
    Path | None,
    typer.Option("--picture", metavar="FILE.png", help="Write one image of both shapes; no screen needed."),
]
PICTURE_WIDTH = 2000
Lines = Annotated[int, typer.Option(metavar="N", help="Lines between counterparts in the picture.", min=0)]
PictureWidth = Annotated[
    int,
    typer.Option(
        "--picture-width", metavar="PIXELS", help="Of the picture, twice its height.", min=WIDTHS[0], max=WIDTHS[1]
    ),
]
ONE_PER_CORE = os.cpu_count() or 1
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Also print each step, its time and memory.")]
NoCache = Annotated[bool, typer.Option("--no-cache", help="Neither read nor write cached operators.")]


def build_matcher(weights: str | None, method: Method, device: Device, *, no_cache: bool) -> Matcher:
    """The matcher that the shared options ask for; some methods need no weights."""
    operators = compute_operators if no_cache else OperatorCache.default().operators
    settings = MatcherSettings(method=method)
    if weights is None and method in NEED_NO_WEIGHTS:
        return Matcher(settings=settings, device=device, operators=operators)
    return Matcher.from_weights(weights or DEFAULT_WEIGHTS, settings=settings, device=device, operators=operators)


def described(matcher: Matcher, weights: str | None) -> dict[str, Any]:
    """Weights, settings and device, for reports."""
    info = None if matcher.network is None else {"given": weights or DEFAULT_WEIGHTS, **asdict(matcher.info)}
    settings = {**asdict(matcher.settings), "operators": asdict(matcher.operator_settings)}
    return {"weights": info, "settings": settings, "device": str(matcher.device)}


def set_verbosity(*, quiet: bool, verbose: bool) -> None:
    """Let the library's log through as the options ask."""
    level = logging.ERROR if quiet else logging.INFO if verbose else logging.WARNING
    logging.getLogger("homolog").setLevel(level)


def check_folder(output: Path, *, inputs: Iterable[Path] = (), names: Iterable[str] = ()) -> None:
    """Refuse a result folder that cannot be made, or where a file of such a name would replace an input or is a folder.

    Before any work is done; nothing is made or changed.
    """
    place = expanded(output)
    nearest = next(path for path in (place, *place.absolute().parents) if path.exists())
    if not nearest.is_dir():
        raise ArgumentError(f"{output} cannot be made a folder, {nearest} is a file; give another -o")
    if not os.access(nearest, os.W_OK):
        raise ArgumentError(f"{output} cannot be written to: {nearest} is read-only; give another -o")
    given = {expanded(path).resolve() for path in inputs}
    for name in names:
        if (place / name).resolve() in given:
            raise ArgumentError(f"{place / name} is an input and would be replaced by the result; give another -o")
        if (place / name).is_dir():
            raise ArgumentError(f"{place / name} is a folder, where a result file belongs; give another -o")


def check_file(output: Path) -> None:
    """Refuse a result file that cannot be written, before any work is done for it; nothing is made or changed."""
    if fault := _fault(expanded(output).resolve()):
        raise ArgumentError(f"{output} cannot be written: {fault}")


def check_picture_file(output: Path | None, lines: int, width: int) -> None:
    """Refuse a picture that cannot be written, or what says how to draw one that is not wanted, before any work."""
    if output is not None:
        check_picture(output)
        check_file(output)
    elif lines or width != PICTURE_WIDTH:
        option = "--lines" if lines else "--picture-width"
        raise ArgumentError(f"{option} is about a picture, but none is to be written; add --picture FILE.png")


def _fault(place: Path) -> str:
    """What is against writing a file to a place, if anything."""
    if not place.parent.is_dir():
        return f"the folder {place.parent} does not exist; create it first"
    if not os.access(place.parent, os.W_OK | os.X_OK):
        return f"{place.parent} is read-only; give a file in another folder"
    try:
        return "" if stat.S_ISREG(place.stat().st_mode) else "it is no ordinary file; give a file name"
    except FileNotFoundError:
        return ""
    except OSError as error:
        return str(error.strerror)
