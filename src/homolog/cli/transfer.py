"""``homolog transfer``: transfer textures, colours, labels, landmarks, skins, blend shapes and arrays along a match."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import homolog
from homolog.cli.options import INPUT, OUTPUT, Quiet, ResultFolder, check_folder
from homolog.cli.progress import progress_bar, say, tell_files
from homolog.core.choices import TEXTURE_SIZE, Side, System
from homolog.core.errors import ArgumentError, HomologError
from homolog.core.files import refuse_overwriting_inputs
from homolog.core.versions import versions

if TYPE_CHECKING:
    from homolog.transfer import Kind, Original

_WHAT = "What to transfer"

_Files = list[Path] | None


def transfer(
    result: ResultFolder,
    texture: Annotated[
        bool, typer.Option("--texture", help="The texture of the source's file.", rich_help_panel=_WHAT)
    ] = False,
    colours: Annotated[
        bool, typer.Option("--colours", help="The colours of its points.", rich_help_panel=_WHAT)
    ] = False,
    skin: Annotated[
        bool,
        typer.Option(
            "--skin",
            help="The skeleton and skinning weights of a GLB or glTF, with its animations.",
            rich_help_panel=_WHAT,
        ),
    ] = False,
    blend_shapes: Annotated[
        bool,
        typer.Option(
            "--blend-shapes",
            help="The blend shapes (morph targets) of a GLB or glTF, with their animations.",
            rich_help_panel=_WHAT,
        ),
    ] = False,
    checker: Annotated[
        bool,
        typer.Option("--checker", help="A checkerboard that is painted on the source.", rich_help_panel=_WHAT),
    ] = False,
    array: Annotated[
        _Files,
        typer.Option(
            metavar="FILE.npy",
            help="Numbers, a row per source point; they are interpolated. Can be repeated.",
            rich_help_panel=_WHAT,
        ),
    ] = None,
    labels: Annotated[
        _Files,
        typer.Option(
            metavar="FILE.npy",
            help="Whole numbers, one per source point; they are never interpolated. Can be repeated.",
            rich_help_panel=_WHAT,
        ),
    ] = None,
    landmarks: Annotated[
        _Files,
        typer.Option(
            metavar="FILE",
            help="Points on the source: .csv, .mrk.json, .fcsv, or scalismo's .json. Can be repeated.",
            rich_help_panel=_WHAT,
        ),
    ] = None,
    reverse: Annotated[
        bool, typer.Option("--reverse", help="Transfer from the target to the source.", rich_help_panel=INPUT)
    ] = False,
    origin: Annotated[
        Path | None,
        typer.Option(
            "--from",
            metavar="FILE",
            help="The source's file (with --reverse, the target's), if it was moved since the match.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    axes: Annotated[
        System | None,
        typer.Option(
            help="The shapes' coordinate system, for landmark files that have one.",
            show_default="as the shapes' files say, or LPS",
            rich_help_panel=INPUT,
        ),
    ] = None,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for the files.", rich_help_panel=OUTPUT)
    ] = Path("transfer"),
    texture_size: Annotated[
        int,
        typer.Option(metavar="TEXELS", help="Width of the new texture.", min=16, max=16384, rich_help_panel=OUTPUT),
    ] = TEXTURE_SIZE,
    quiet: Quiet = False,
) -> None:
    """Transfer textures, colours, skins, blend shapes, landmarks and arrays from the source of a match to its target.

    They follow a smooth map between the surfaces. Without options: the texture, colours, skin and blend shapes that the
    source's file holds. Writes into DIR textured.obj, .mtl and .png (the target with an atlas of its own),
    coloured.ply, carried.glb (texture or colours, skin, blend shapes and animations), arrays and landmarks under their
    files' names, and transfer.json. Textures need the extra `transfer`.

    Points without a counterpart get NaN, the label -1, or grey; landmarks are nan in tables, undefined in .mrk.json and
    left out in .fcsv; in a skin such points move with the nearest point that has a counterpart.

    Examples:
      homolog transfer result -o transferred

      homolog transfer result --checker

      homolog transfer result --blend-shapes -o face

      homolog transfer result --labels organs.npy --array thickness.npy

      homolog transfer result --landmarks template.mrk.json -o subject

      homolog transfer result --reverse --texture --from scans/textured.obj
    """
    given: dict[Kind, bool] = {"texture": texture, "colours": colours, "skin": skin, "blend-shapes": blend_shapes}
    kinds = [kind for kind, asked in given.items() if asked]
    files = [*(array or []), *(labels or []), *(landmarks or [])]
    transfers = homolog.transfer
    transfers.check_output_names(files)
    side: Side = "target" if reverse else "source"
    match = homolog.Match.load(result)
    if checker and kinds:
        raise ArgumentError(f"--checker and --{kinds[0]} write the same files; give one at a time")
    contents = bool(kinds) or not (files or checker)
    original = transfers.read_original(match, side, origin) if contents or origin is not None else None
    names = [*transfers.OUTPUT_NAMES, *(file.name for file in files)]
    refuse_overwriting_inputs([output / name for name in names], () if original is None else original.files)
    check_folder(output, names=names)
    forth = match.inverse() if reverse else match
    along = transfers.Transfer(forth, source=None if original is None else original.shape)
    target = _target(match, "source" if reverse else "target") if contents else None
    delivery = transfers.Delivery(along, axes=axes, texture_size=texture_size, target=target)
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
        progress(0, 1, "transfer")
        written = delivery.write(output, {"result": str(result), "from": side, "versions": versions()}, progress)
    if not quiet:
        tell_files(written, delivery.notes)


def _target(match: homolog.Match, side: Side) -> Original | None:
    """The target's own file, whose look and skin are kept where no other is transferred; None if it is not there."""
    try:
        return homolog.transfer.read_original(match, side)
    except HomologError as error:
        say(f"Note: the target's own look, skin and blend shapes are left out: {error}")
        return None
