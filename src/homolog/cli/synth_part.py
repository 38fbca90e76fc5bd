"""``homolog synth part``: a partial shape, with the indices of its points in the full one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

import homolog
from homolog.cli.options import OUTPUT, Quiet, Seed, check_folder, check_inputs
from homolog.cli.progress import progress_bar
from homolog.core.errors import ArgumentError
from homolog.core.files import all_or_nothing, atomic_path, expanded, made_folder, remove

if TYPE_CHECKING:
    import numpy as np

    from homolog.shapes import Repaired, Shape
    from homolog.synthesis import PartialShape

Kind = Literal["cut", "holes", "view"]

# All that is ever written.
_FILES = ("part.ply", "part.npz", "cloud.ply", "cloud.npz")


def part(
    file: Annotated[Path, typer.Argument(metavar="SHAPE", help="A full mesh.", show_default=False)],
    kind: Annotated[
        Kind, typer.Option(help="cut: cut by a plane. holes: discs are removed. view: what a camera sees.")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for the files.", rich_help_panel=OUTPUT)
    ] = Path("part"),
    seed: Seed = 0,
    quiet: Quiet = False,
) -> None:
    """Make a partial shape from a full mesh, with the indices of its points in the full one.

    Writes DIR/part.ply and DIR/part.npz; full_index there holds for each point the index of the same point in
    SHAPE. A view (of a shape that stands +y up) also gives a depth camera's cloud, DIR/cloud.ply and DIR/cloud.npz:
    there full_index is the nearest vertex, and corners and weights are the exact barycentric coordinates. In
    Python, homolog.synthesis also takes how much is cut away, how many holes and which camera, and adds noise, outliers
    and uneven density.

    Examples:
      homolog synth part horse.ply --kind cut --seed 3 -o half_a_horse

      homolog synth part body.off --kind view -o scan
    """
    import numpy as np

    check_inputs(file)
    folder = expanded(output)
    if folder.is_dir() and any(path.name not in _FILES for path in folder.glob("[!.]*")):
        raise ArgumentError(f"{output} holds other things; give another folder with -o, a new or an empty one")
    check_folder(output, names=_FILES)
    with progress_bar(quiet=quiet) as progress:
        progress(0, 2, "read and repair")
        repaired = homolog.repair(homolog.read_shape(file))
        progress(1, 2, kind)
        parts = _parts(repaired.shape, kind, seed)
    folder = made_folder(output)
    with all_or_nothing():
        for name, made in parts.items():
            homolog.write_shape(folder / f"{name}.ply", made.shape)
            with atomic_path(folder / f"{name}.npz") as temporary:
                np.savez_compressed(temporary, allow_pickle=False, **_way_back(made, repaired))
    for name in _FILES:
        if Path(name).stem not in parts:  # of a view that was made here before
            remove(folder / name)
    if not quiet:
        typer.echo(output)


def _parts(shape: Shape, kind: Kind, seed: int) -> dict[str, PartialShape]:
    """What is to be written, by the names of the files."""
    if kind == "view":
        seen = homolog.synthesis.view(shape, seed=seed)
        return {"part": seen.mesh, "cloud": seen.cloud}
    make = homolog.synthesis.cut if kind == "cut" else homolog.synthesis.cut_holes
    return {"part": make(shape, seed=seed)}


def _way_back(made: PartialShape, repaired: Repaired) -> dict[str, np.ndarray]:
    """Indices of the file's own points, and where points were sampled anew also the corners around them."""
    arrays = {"full_index": repaired.original_index(made.full_index)}
    if made.triangles is None or made.weights is None or repaired.shape.faces is None:
        return arrays
    corners = repaired.original_index(repaired.shape.faces[made.triangles])
    return {**arrays, "corners": corners, "weights": made.weights}
