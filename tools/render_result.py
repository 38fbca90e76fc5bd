"""Render the two coloured shapes of a result side by side, as one PNG.

Run from the root of the checkout::

    homolog demo -o homolog-demo
    python tools/render_result.py homolog-demo docs/images/demo.png
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import pyvista

_SIZE = (1600, 900)


def render(result: Path, picture: Path) -> None:
    """Draw ``source.ply`` and ``target.ply`` of a result folder from the front, with soft shading."""
    # pyvista's own annotations mislead the type checker here.
    plotter: Any = pyvista.Plotter(off_screen=True, shape=(1, 2), window_size=list(_SIZE), border=False)
    for column, side in enumerate(("source", "target")):
        plotter.subplot(0, column)
        shape = pyvista.read(result / f"{side}.ply")
        as_points = shape.n_cells == shape.n_points or not shape.is_all_triangles
        plotter.add_mesh(
            shape,
            scalars="RGB",
            rgb=True,
            smooth_shading=not as_points,
            style="points" if as_points else "surface",
            point_size=7,
            render_points_as_spheres=as_points,
            ambient=0.25,
            specular=0.1,
        )
        plotter.view_xy()
        plotter.camera.azimuth = 20
        plotter.camera.elevation = 8
        plotter.camera.zoom(1.25)
    plotter.set_background("white")
    plotter.screenshot(picture)


def main() -> None:
    """Read the arguments and render."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("result", type=Path, help="folder that homolog match or demo wrote")
    parser.add_argument("picture", type=Path, help="PNG to write")
    arguments = parser.parse_args()
    render(arguments.result, arguments.picture)


if __name__ == "__main__":
    main()
