"""Render synthetic people as one contact sheet, coloured by position on the common template.

Run from the root of the checkout::

    homolog synth people -n 64 -o people
    python tools/render_people.py people docs/images/people.png
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import pyvista

from homolog.datasets import ShapeFolder
from homolog.shapes import read_shape

_WIDTH, _HEIGHT = 150, 200
# Bodies are drawn at one scale, so that children are small.
_HALF_HEIGHT = 1.2


def colours(folder: ShapeFolder, name: str) -> np.ndarray:
    """Red, green and blue of each vertex: its position on the template, so that the same colour is the same point."""
    rest = read_shape(folder.root / "template" / "template.off")
    barycentric = np.load(folder.root / "places" / f"{name}.npz", allow_pickle=False)
    assert rest.faces is not None
    at = np.einsum("vck,vc->vk", rest.points[rest.faces[barycentric["triangles"]]], barycentric["weights"])
    low, high = rest.points.min(axis=0), rest.points.max(axis=0)
    return np.asarray((50 + 200 * (at - low) / (high - low)).astype(np.uint8))


def render(folder: ShapeFolder, picture: Path, columns: int, count: int) -> None:
    """Draw the first bodies in rows, a little from the side."""
    names = folder.names[:count]
    rows = -(-len(names) // columns)
    size = [columns * _WIDTH, rows * _HEIGHT]
    # pyvista's own annotations mislead the type checker here.
    plotter: Any = pyvista.Plotter(off_screen=True, shape=(rows, columns), window_size=size, border=False)
    for i, name in enumerate(names):
        plotter.subplot(i // columns, i % columns)
        shape = folder.shape(name)
        assert shape.faces is not None
        mesh = pyvista.PolyData.from_regular_faces(shape.points, shape.faces)
        plotter.add_mesh(mesh, scalars=colours(folder, name), rgb=True, smooth_shading=True, ambient=0.2)
        plotter.view_xy()
        middle = (shape.points.min(axis=0) + shape.points.max(axis=0)) / 2
        plotter.camera.focal_point = middle
        plotter.camera.position = middle + np.array([1.3, 0.6, 4.0])
        plotter.camera.up = (0.0, 1.0, 0.0)
        plotter.enable_parallel_projection()
        plotter.camera.parallel_scale = max(_HALF_HEIGHT, float(np.ptp(shape.points[:, 1])) / 2 * 1.05)
    plotter.set_background("white")
    plotter.screenshot(picture)


def main() -> None:
    """Read the arguments and render."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("people", type=Path, help="folder that homolog synth people wrote")
    parser.add_argument("picture", type=Path, help="PNG to write")
    parser.add_argument("--columns", type=int, default=16)
    parser.add_argument("--count", type=int, default=64)
    arguments = parser.parse_args()
    render(ShapeFolder.open(arguments.people), arguments.picture, arguments.columns, arguments.count)


if __name__ == "__main__":
    main()
