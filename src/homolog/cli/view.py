"""``homolog view``: a match in the browser, as a page that is served or written, or as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import homolog
from homolog.cli.browsing import Host, NoOpen, Port, announce, interrupt_ends
from homolog.cli.options import (
    INPUT,
    PICTURE_WIDTH,
    Lines,
    Page,
    Picture,
    PictureWidth,
    Quiet,
    ResultFolder,
    build_matcher,
    check_page_file,
    check_picture_file,
)
from homolog.cli.progress import progress_bar
from homolog.core.errors import ArgumentError
from homolog.core.files import refuse_overwriting_inputs
from homolog.core.progress import Timings

if TYPE_CHECKING:
    from homolog.matching import Match
    from homolog.viewing import Layer, Scene

COLOURS = "Colours"
# repair, proxy, operators, orientation and features for each shape
_STEPS = 10


def view(
    result: ResultFolder,
    shape: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="RESULT is a collection: show the match of its template with this shape.",
            show_default=False,
            rich_help_panel=INPUT,
        ),
    ] = None,
    page: Page = None,
    picture: Picture = None,
    lines: Lines = 0,
    picture_width: PictureWidth = PICTURE_WIDTH,
    truth: Annotated[
        tuple[Path, Path] | None,
        typer.Option(
            metavar="SOURCE.vts TARGET.vts",
            help="Ground truth, to colour by error: line i of each file is the vertex of the i-th template point.",
            rich_help_panel=COLOURS,
        ),
    ] = None,
    weights: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="Weights, to colour by their features; these are computed again, which takes as long as a match.",
            rich_help_panel=COLOURS,
        ),
    ] = None,
    host: Host = "127.0.0.1",
    port: Port = 8080,
    no_open: NoOpen = False,
    quiet: Quiet = False,
) -> None:
    """Show a match in the browser: both shapes side by side, the same colours on corresponding points.

    Click a point to mark its counterpart. Colours show the correspondence, the confidence, with --truth the error, and
    with --weights the features. Sliders set the least confidence and the number of points. A menu offers the maps that
    --alternatives of homolog match wrote. Landmarks can be set by clicks, and saved for --landmarks. Of more than
    100,000 points as many are shown. Prints the address and serves until Ctrl-C; --html writes the same page to a
    file. --picture needs the extra `picture`.

    Examples:
      homolog view result

      homolog view result --html result.html

      homolog view collection --shape anna

      homolog view result --picture result.png --lines 20

      homolog view result --truth cat.vts lion.vts --weights animals.safetensors

    On a remote machine: run it there, run `ssh -L 8080:127.0.0.1:8080 MACHINE` here, and open the address here.
    """
    check_page_file(page)
    check_picture_file(picture, lines, picture_width)
    matches = _matches(result, shape)
    refuse_overwriting_inputs(filter(None, (page, picture)), homolog.matching.given_files(matches[0]))
    scene = homolog.viewing.scene_of_all(matches, _layers(matches, truth, weights, quiet=quiet))
    if picture is not None:
        homolog.viewing.write_picture(picture, scene, width=picture_width, lines=lines)
        typer.echo(picture)
    if page is None and picture is None:
        _serve(scene, host, port, open_browser=not no_open, quiet=quiet)
    if page is not None:
        homolog.viewing.write_page(page, scene)
        typer.echo(page)


def _matches(result: Path, shape: str | None) -> list[Match]:
    """The match of a result folder and its alternatives, or that of a shape of a collection."""
    folders = homolog.shape_models.ShapeModelFolder
    if shape is not None:
        return [folders.existing(result).match(shape)]
    if folders.is_one(result):
        raise ArgumentError(f"{result} is a collection; say which of its shapes is to be shown, by --shape NAME")
    match = homolog.Match.load(result)
    return [match, *homolog.matching.load_alternatives(result, match)]


def _layers(
    matches: list[Match], truth: tuple[Path, Path] | None, weights: str | None, *, quiet: bool
) -> list[list[Layer]]:
    """What each match can be coloured by besides what is in the result."""
    from homolog.cli.match import counted

    viewing, first = homolog.viewing, matches[0]
    layers: list[list[Layer]] = [[] for _ in matches]
    if truth is not None:
        known = homolog.datasets.read_truth(truth, (first.source, first.target))
        for match, own in zip(matches, layers, strict=True):
            own.append(viewing.error_layer(*viewing.map_errors(match, known)))
    if weights is not None:
        with progress_bar(quiet=quiet) as progress:
            timings = Timings(listener=counted(progress, _STEPS))
            matcher = build_matcher(weights, "auto", "auto", no_cache=False)
            features = viewing.feature_layer(*viewing.pair_features(first, matcher, timings=timings))
            layers = [[*own, features] for own in layers]
    return layers


def _serve(scene: Scene, host: str, port: int, *, open_browser: bool, quiet: bool) -> None:
    server = homolog.serving.PageServer(homolog.viewing.page_of(scene), host, port)
    try:
        announce(server.address, open_browser=open_browser, quiet=quiet)
        with interrupt_ends(server.end):
            server.serve()
    finally:
        server.close()
