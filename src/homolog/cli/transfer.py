"""``homolog transfer``: carry textures, colours, labels, landmarks, skins and arrays along a match."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, get_args

import typer

from homolog.cli.options import Quiet, check_folder
from homolog.cli.progress import progress_bar, say
from homolog.core.errors import ArgumentError
from homolog.core.versions import versions
from homolog.matching import Match
from homolog.pairs import Side
from homolog.transfer import (
    OUTPUT_NAMES,
    TEXTURE_SIZE,
    Delivery,
    Kind,
    System,
    Transfer,
    check_output_names,
    read_original,
)

_Files = list[Path] | None


def transfer(
    result: Annotated[
        Path, typer.Argument(metavar="OUT", help="A folder that homolog match wrote.", show_default=False)
    ],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Where the files go.")] = Path(
        "transfer"
    ),
    texture: Annotated[bool, typer.Option("--texture", help="Carry the texture of the source's file.")] = False,
    colours: Annotated[bool, typer.Option("--colours", help="Carry the colours of its points.")] = False,
    skin: Annotated[bool, typer.Option("--skin", help="Carry the skeleton and weights of a GLB or glTF.")] = False,
    checker: Annotated[
        bool, typer.Option("--checker", help="Paint squares on the source, and carry these: to look at a match.")
    ] = False,
    array: Annotated[
        _Files, typer.Option(metavar="NPY", help="Carry numbers, a row per source point; more than once if need be.")
    ] = None,
    labels: Annotated[
        _Files, typer.Option(metavar="NPY", help="Carry whole numbers, of which no two are ever mixed, likewise.")
    ] = None,
    landmarks: Annotated[
        _Files, typer.Option(metavar="FILE", help="Carry points on the source: .csv, .mrk.json or .fcsv, likewise.")
    ] = None,
    reverse: Annotated[bool, typer.Option("--reverse", help="Carry from the target to the source.")] = False,
    origin: Annotated[
        Path | None,
        typer.Option("--from", metavar="FILE", help="Where the file that is carried from is, if it was moved since."),
    ] = None,
    texture_size: Annotated[
        int, typer.Option(metavar="TEXELS", help="Width of the new texture.", min=16, max=16384)
    ] = TEXTURE_SIZE,
    axes: Annotated[System, typer.Option(help="The shapes' coordinates, for landmarks that have a system.")] = "LPS",
    quiet: Quiet = False,
) -> None:
    """Carry what the source of a match has to its target, along a smooth map between their surfaces.

    Without options: the texture, colours and skin that the source's file holds. Writes into DIR textured.obj, .mtl and
    .png (the target with an atlas of its own), coloured.ply, carried.glb (texture or colours, and skin), arrays and
    landmarks under their files' names, and transfer.json. Textures need the extra `transfer`.

    What has no counterpart gets NaN, the label -1, or grey; as a landmark nan in tables, the status undefined in
    .mrk.json and no row in .fcsv; in a skin it moves with its nearest neighbour that has one.

    Examples:
      homolog transfer result -o carried

      homolog transfer result --checker

      homolog transfer result --labels organs.npy --array thickness.npy

      homolog transfer result --landmarks template.mrk.json -o subject

      homolog transfer result --reverse --texture --from scans/textured.obj
    """
    kinds = _asked(texture=texture, colours=colours, skin=skin)
    files = [*(array or []), *(labels or []), *(landmarks or [])]
    check_output_names(files)
    side: Side = "target" if reverse else "source"
    match = Match.load(result)
    match = match.inverse() if reverse else match
    if checker and kinds:
        raise ArgumentError(f"--checker and --{kinds[0]} write the same files; give one at a time")
    contents = bool(kinds) or not (files or checker)
    original = read_original(match, side, origin) if contents or origin is not None else None
    inputs = files if original is None else [*files, *original.files]
    check_folder(output, inputs=inputs, names=[*OUTPUT_NAMES, *(file.name for file in files)])
    along = Transfer(match, source=None if original is None else original.shape)
    delivery = Delivery(along, axes=axes, texture_size=texture_size)
    for paths, add in (
        (array, delivery.add_array),
        (labels, delivery.add_labels),
        (landmarks, delivery.add_landmarks),
    ):
        for path in paths or []:
            add(path)
    if contents and original is not None:
        delivery.add_contents(original, kinds)
    if checker:
        delivery.add_checkerboard()
    with progress_bar(quiet=quiet) as progress:
        progress(0, 1, "carry")
        written = delivery.write(output, {"result": str(result), "from": side, "versions": versions()})
    if not quiet:
        _tell(delivery, written)


def _asked(**flags: bool) -> list[Kind]:
    return [kind for kind in get_args(Kind) if flags[kind]]


def _tell(delivery: Delivery, written: list[Path]) -> None:
    for note in delivery.notes:
        say(note)
    for path in written:
        typer.echo(path)
