"""``homolog synth part``: a part of one shape, with the way back."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer

from homolog.cli.options import Quiet
from homolog.core.errors import ArgumentError
from homolog.core.files import all_or_nothing, atomic_path, expanded, made_folder
from homolog.shapes import Repaired, Shape, read_shape, repair, write_shape
from homolog.synthesis import PartialShape, cut, cut_holes, view

Kind = Literal["cut", "holes", "view"]

# All that is ever written.
_FILES = ("part.ply", "part.npz", "cloud.ply", "cloud.npz")


def part(
    file: Annotated[Path, typer.Argument(help="A complete mesh in any format.", show_default=False)],
    kind: Annotated[Kind, typer.Option(help="What takes the rest away: a plane, discs, or what a camera cannot see.")],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="A folder.")] = Path("part"),
    seed: Annotated[int, typer.Option(help="Of all that is drawn.", min=0)] = 0,
    quiet: Quiet = False,
) -> None:
    """Make a part of a mesh, and the indices that lead back to it.

    Writes DIR/part.ply and DIR/part.npz, whose full_index holds for each point of the part the point of FILE that
    it is. A view (of a shape that stands +y up) also gives what a depth camera takes, DIR/cloud.ply and DIR/cloud.npz:
    there full_index is the nearest corner, and corners and weights tell the exact place. In Python,
    homolog.synthesis also takes how much is cut away, how many holes and which camera, and adds noise, outliers and
    uneven density.

    Examples:
      homolog synth part horse.ply --kind cut --seed 3 -o half_a_horse

      homolog synth part body.off --kind view -o scan
    """
    _check_folder(output)
    repaired = repair(read_shape(file))
    parts = _parts(repaired.shape, kind, seed)
    place = made_folder(output)
    with all_or_nothing():
        for name, made in parts.items():
            write_shape(place / f"{name}.ply", made.shape)
            with atomic_path(place / f"{name}.npz") as temporary:
                np.savez_compressed(temporary, allow_pickle=False, **_way_back(made, repaired))
    for name in _FILES:
        if Path(name).stem not in parts:  # of another part that was made here before
            (place / name).unlink(missing_ok=True)
    if not quiet:
        typer.echo(output)


def _check_folder(output: Path) -> None:
    place = expanded(output)
    if place.is_dir() and any(path.name not in _FILES for path in place.glob("[!.]*")):
        raise ArgumentError(f"{output} holds other things; give another folder with -o, a new or an empty one")


def _parts(shape: Shape, kind: Kind, seed: int) -> dict[str, PartialShape]:
    """What is to be written, by the names of the files."""
    if kind == "view":
        seen = view(shape, seed=seed)
        return {"part": seen.mesh, "cloud": seen.cloud}
    return {"part": cut(shape, seed=seed) if kind == "cut" else cut_holes(shape, seed=seed)}


def _way_back(made: PartialShape, repaired: Repaired) -> dict[str, np.ndarray]:
    """Indices of the file's own points, and where points were sampled anew also the corners around them."""
    arrays = {"full_index": repaired.original_index(made.full_index)}
    if made.triangles is None or made.weights is None or repaired.shape.faces is None:
        return arrays
    corners = repaired.original_index(repaired.shape.faces[made.triangles])
    return {**arrays, "corners": corners, "weights": made.weights}
