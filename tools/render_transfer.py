"""Render the checkerboard that ``homolog transfer --checker`` transferred, source and target side by side, as one PNG.

Run from the root of the checkout::

    homolog demo -o homolog-demo
    homolog transfer homolog-demo --checker --texture-size 2048 -o homolog-demo/carried
    python tools/render_transfer.py homolog-demo/carried docs/images/transfer.png
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import pyvista
import trimesh

_SIZE = (1600, 900)
# Only partly typed.
_PYVISTA: Any = pyvista


def render(folder: Path, picture: Path) -> None:
    """Draw ``checkered.glb`` and ``carried.glb`` of a folder from the front, with soft shading."""
    # pyvista's own annotations mislead the type checker here.
    plotter: Any = pyvista.Plotter(off_screen=True, shape=(1, 2), window_size=list(_SIZE), border=False)
    plotter.enable_anti_aliasing("ssaa")
    for column, name in enumerate(("checkered.glb", "carried.glb")):
        plotter.subplot(0, column)
        mesh: Any = next(iter(trimesh.load_scene(folder / name).geometry.values()))
        drawn: Any = pyvista.PolyData.from_regular_faces(mesh.vertices, mesh.faces)
        drawn.active_texture_coordinates = np.asarray(mesh.visual.uv)
        # Not computed anew: at seams, where points are repeated, these would show.
        drawn.point_data.active_normals = np.asarray(mesh.vertex_normals)
        image = np.asarray(mesh.visual.material.baseColorTexture.convert("RGB"))
        texture: Any = _PYVISTA.Texture(np.ascontiguousarray(image))
        texture.interpolate = True
        plotter.add_mesh(drawn, texture=texture, smooth_shading=True, ambient=0.3, specular=0.05)
        plotter.view_xy()
        plotter.camera.azimuth = 20
        plotter.camera.elevation = 8
        plotter.camera.zoom(1.25)
    plotter.set_background("white")
    plotter.screenshot(picture)


def main() -> None:
    """Read the arguments and render."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="folder that homolog transfer --checker wrote")
    parser.add_argument("picture", type=Path, help="PNG to write")
    arguments = parser.parse_args()
    render(arguments.folder, arguments.picture)


if __name__ == "__main__":
    main()
