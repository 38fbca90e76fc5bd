"""``homolog export``: a match as displacement field, distances, particles, or a map of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

import homolog
from homolog.cli.options import INPUT, OUTPUT, Quiet, ResultFolder, check_files, check_folder
from homolog.cli.progress import progress_bar, tell_files
from homolog.core.choices import System
from homolog.core.errors import ArgumentError
from homolog.core.files import all_or_nothing

_FIELD = "Displacement field"
_MAP = "Map"
# Of the spacing of the nodes: counterparts that the field misses by more are told.
_COARSE = 0.1


def export(
    result: ResultFolder,
    reverse: Annotated[
        bool, typer.Option("--reverse", help="Exchange source and target.", rich_help_panel=INPUT)
    ] = False,
    axes: Annotated[
        System | None,
        typer.Option(
            help="The shapes' coordinate system, for the field, which is in LPS.",
            show_default="as the shapes' files say, or LPS",
            rich_help_panel=INPUT,
        ),
    ] = None,
    align: Annotated[
        Literal["none", "rigid", "similarity"],
        typer.Option(help="Bring the target onto the source before distances are measured.", rich_help_panel=INPUT),
    ] = "none",
    spacing: Annotated[
        float | None,
        typer.Option(
            metavar="LENGTH",
            help="Between the nodes of the field's grid, in units of the files.",
            show_default="64 nodes along the longest side",
            rich_help_panel=_FIELD,
        ),
    ] = None,
    margin: Annotated[
        float,
        typer.Option(
            metavar="SHARE", help="Around the target, as a share of its longest side.", min=0, rich_help_panel=_FIELD
        ),
    ] = 0.1,
    map_name: Annotated[
        str | None,
        typer.Option(
            metavar="WORD", help="What a .mat or .npz calls the map, which then stands alone.", rich_help_panel=_MAP
        ),
    ] = None,
    base: Annotated[
        int | None,
        typer.Option(
            metavar="0|1", help="The first index.", show_default="by the suffix", min=0, max=1, rich_help_panel=_MAP
        ),
    ] = None,
    field: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="A displacement field of the space around the target: .nrrd or .mha, an image of vectors; .h5, a "
            "transform of ITK.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    distances: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.ply",
            help="The source in a heat map of the distances to its counterparts, with the properties distance and "
            "along_normal.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    table: Annotated[
        Path | None, typer.Option(metavar="FILE.csv", help="The same as a table.", rich_help_panel=OUTPUT)
    ] = None,
    point_map: Annotated[
        Path | None,
        typer.Option(
            "--map",
            metavar="FILE",
            help="The map from the target to the source: .txt (from 0), .vts or .map (from 1), .mat or .npz.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    particles: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="source.particles and target.particles for ShapeWorks: corresponding points, one a line.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Write a match in forms that other programs read.

    The displacement field is in LPS coordinates around the target, and leads to the source: by it ITK and 3D Slicer
    draw a volume of the source around the target. It meets the smooth map between the surfaces exactly at the target's
    points, and is read between the nodes of its grid. The field needs the extra `volumes`.

    Examples:
      homolog export result --field field.nrrd --spacing 2

      homolog export result --distances change.ply --table change.csv --align rigid

      homolog export result --map p2p.mat --map-name p2p

      homolog export result --particles particles
    """
    wanted = (field, distances, table, point_map, particles)
    if not any(wanted):
        raise ArgumentError("nothing is to be written; give --field, --distances, --table, --map or --particles")
    _check(field, distances, table, point_map, particles, map_name=map_name, base=base)
    match = homolog.Match.load(result)
    match = match.inverse() if reverse else match
    written, notes = list[Path](), list[str]()
    with progress_bar(quiet=quiet) as progress, all_or_nothing():
        if field is not None:
            found, errors = homolog.transfer.field_of_match(
                match, axes=axes, spacing=spacing, margin=margin, progress=progress
            )
            homolog.volumes.write_displacement_field(field, found)
            notes += _of_field(found, errors)
            written.append(field)
        if distances is not None or table is not None:
            progress(0, 1, "distances")
            written += _write_distances(match, distances, table, align)
        if point_map is not None:
            written += match.save(point_map, base=base, name=map_name)
        if particles is not None:
            written += homolog.transfer.write_particles(particles, match)
    if not quiet:
        tell_files(written, notes)


def _check(
    field: Path | None,
    distances: Path | None,
    table: Path | None,
    point_map: Path | None,
    particles: Path | None,
    *,
    map_name: str | None,
    base: int | None,
) -> None:
    """Refuse what cannot be written before any work is done."""
    check_files(field, distances, table, point_map)
    for name, path, suffixes in (("--distances", distances, (".ply",)), ("--table", table, (".csv",))):
        if path is not None and path.suffix.lower() not in suffixes:
            raise ArgumentError(f"{name} is {path}, but must end with {suffixes[0]}")
    if field is not None:
        homolog.volumes.check_field_file(field)
    if particles is not None:
        check_folder(particles, names=homolog.transfer.PARTICLES)
    if point_map is None and (map_name is not None or base is not None):
        raise ArgumentError("--map-name and --base are about a map, but none is to be written; add --map FILE")
    if point_map is not None and point_map.suffix.lower() not in homolog.matching.MAP_SUFFIXES:
        known = ", ".join(homolog.matching.MAP_SUFFIXES)
        raise ArgumentError(f"--map is {point_map}, but must end with one of {known}")


def _write_distances(
    match: homolog.Match, distances: Path | None, table: Path | None, align: Literal["none", "rigid", "similarity"]
) -> list[Path]:
    found = homolog.transfer.point_distances(match, align=align)
    if distances is not None:
        heat = homolog.viewing.heat_layer("Distance", "", {"source": found.distances}, "")
        homolog.transfer.write_distances(distances, match, found, heat.colours["source"])
    if table is not None:
        homolog.transfer.write_distance_table(table, match, found)
    return [path for path in (distances, table) if path is not None]


def _of_field(found: homolog.volumes.DisplacementField, errors: tuple[float, float]) -> list[str]:
    counts = " x ".join(map(str, found.values.shape[:3]))
    told = [
        f"Field: {counts} nodes {found.spacing:.4g} apart; between them it misses the counterparts of the target's "
        f"points by {errors[0]:.3g} on average, {errors[1]:.3g} at most."
    ]
    if errors[0] > _COARSE * found.spacing:
        told.append("Note: a finer grid would come nearer (--spacing).")
    if found.folded:
        told.append(f"Note: the field folds at {100 * found.folded:.2g} % of its nodes, and has no inverse there.")
    return told
