"""Writing a shape to a file of any format that can hold it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from os import PathLike
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from homolog.core.arguments import check_kind
from homolog.core.errors import ArgumentError, ShapeError
from homolog.core.files import atomic_path, expanded
from homolog.shapes.formats import Format, formats, imports_of, writable_suffixes
from homolog.shapes.shape import Shape

Colours = UInt8[np.ndarray, "n 3"]


def write_shape(
    path: str | Path,
    shape: Shape,
    *,
    colours: Colours | None = None,
    numbers: Mapping[str, Float[np.ndarray, " n"]] | None = None,
) -> None:
    """Write a shape; the suffix says in which format.

    Coordinates keep double precision, except in STL and GLB, which hold single precision. The file appears
    only once it is complete. STL has no points of its own: those no face uses are lost, and reading numbers
    the rest anew.

    Args:
        path: a file with one of the suffixes in ``writable_suffixes()``; ``~`` is expanded, an existing file is
            replaced.
        shape: what to write. Formats of points alone take no mesh: write ``shape.as_cloud()``. STL takes no
            cloud.
        colours: red, green and blue of each point, 0 to 255, shape (n, 3); PLY only.
        numbers: of each point, by the name of the property that holds them, each (n,); PLY only.

    Raises:
        ShapeError: if the format cannot hold the shape.
        ArgumentError: if it is no ``Shape``, the suffix is unknown, the colours do not fit, or the folder cannot be
            written to.
        MissingExtraError: if writing this format needs a package that is not installed.

    Examples:
        >>> import tempfile, homolog
        >>> from pathlib import Path
        >>> body, _ = homolog.shapes.demo_shapes()
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     homolog.write_shape(Path(folder) / "body.ply", body)
        ...     homolog.read_shape(Path(folder) / "body.ply")
        Shape('body.ply': mesh, 4918 points, 9832 faces)
    """
    check_kind("path", path, PathLike, str)
    check_kind("shape", shape, Shape)
    suffix = expanded(path).suffix.lower()
    form = formats().get(suffix)
    if form is None or form.write is None:
        allowed = ", ".join(writable_suffixes())
        raise ArgumentError(f"{path} has the suffix {suffix!r}, but must have one of {allowed} to be written")
    if form.clouds_only and shape.faces is not None:
        raise ShapeError(f"{path} cannot hold the faces of {shape.name}; choose .ply, or write shape.as_cloud()")
    if form.meshes_only and shape.faces is None:
        raise ShapeError(f"{path} cannot hold {shape.name}, a point cloud; choose .ply")
    write = form.write
    if colours is not None or numbers:
        write = partial(_writer_of_values(path, form, shape, colours, numbers or {}), colours=colours, numbers=numbers)
    with atomic_path(path) as temporary, imports_of(form):
        write(temporary, shape)


def _writer_of_values(
    path: str | Path,
    form: Format,
    shape: Shape,
    colours: Colours | None,
    numbers: Mapping[str, Float[np.ndarray, " n"]],
) -> Callable[..., None]:
    """What writes a shape with these colours and numbers."""
    if form.write_values is None:
        raise ArgumentError(f"{path} cannot hold {'numbers' if colours is None else 'colours'}; choose the suffix .ply")
    if colours is not None and (np.shape(colours) != (shape.n_points, 3) or np.asarray(colours).dtype != np.uint8):
        found = f"{np.asarray(colours).dtype} of shape {np.shape(colours)}"
        raise ArgumentError(f"colours are {found}, but must be uint8 of shape ({shape.n_points}, 3)")
    for name, values in numbers.items():
        if not name.isidentifier() or np.shape(values) != (shape.n_points,):
            raise ArgumentError(
                f"numbers {name!r} have shape {np.shape(values)}, but must be a word and one number for each of the "
                f"{shape.n_points} points"
            )
    return form.write_values
