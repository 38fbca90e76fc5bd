"""Render synthetic bodies of one or more folders as one contact sheet, coloured by position on their template.

Run from the root of the checkout::

    homolog synth people -n 64 -o people
    python tools/render_bodies.py people docs/images/people.png
    homolog synth animals -n 64 -o animals
    python tools/render_bodies.py animals docs/images/animals.png --from side
    homolog synth hands -n 64 -o hands
    python tools/render_bodies.py hands docs/images/hands.png --from near
    for bone in femur tibia fibula patella hip sacrum; do homolog synth bones --bone $bone -n 16 -o bones/$bone; done
    python tools/render_bodies.py bones/* docs/images/synthetic_bones.jpg --from near --count 16
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import pyvista

from homolog.datasets import ShapeFolder
from homolog.shapes import read_shape

# Where the camera is, and the size of a picture. From the front, bodies are drawn at one scale, so that children are
# small; from the side and from nearby, each fills its picture.
_VIEWS = {
    "front": (np.array([1.3, 0.6, 4.0]), (150, 200)),
    "side": (np.array([4.0, 0.9, 1.8]), (150, 128)),
    "near": (np.array([1.3, 0.3, 4.0]), (128, 150)),
}
_HALF_HEIGHT = 1.2


def colours(folder: ShapeFolder, name: str) -> np.ndarray:
    """Red, green and blue of each vertex: its position on the template, so that the same colour is the same point."""
    rest = read_shape(folder.root / "template" / "template.off")
    barycentric = np.load(folder.root / "barycentric" / f"{name}.npz", allow_pickle=False)
    assert rest.faces is not None
    at = np.einsum("vck,vc->vk", rest.points[rest.faces[barycentric["triangles"]]], barycentric["weights"])
    low, high = rest.points.min(axis=0), rest.points.max(axis=0)
    return np.asarray((50 + 200 * (at - low) / (high - low)).astype(np.uint8))


def render(folders: list[ShapeFolder], picture: Path, columns: int, count: int, view: str) -> None:
    """Draw the first bodies of each folder in rows."""
    drawn = [(folder, name) for folder in folders for name in folder.names[:count]]
    rows = -(-len(drawn) // columns)
    camera, (width, height) = _VIEWS[view]
    size = [columns * width, rows * height]
    # pyvista's own annotations mislead the type checker here.
    plotter: Any = pyvista.Plotter(off_screen=True, shape=(rows, columns), window_size=size, border=False)
    for i, (folder, name) in enumerate(drawn):
        plotter.subplot(i // columns, i % columns)
        shape = folder.shape(name)
        assert shape.faces is not None
        # From nearby, units do not matter; bones are in millimetres.
        points = shape.points if view == "front" else shape.points / np.ptp(shape.points, axis=0).max()
        mesh = pyvista.PolyData.from_regular_faces(points, shape.faces)
        plotter.add_mesh(mesh, scalars=colours(folder, name), rgb=True, smooth_shading=True, ambient=0.2)
        plotter.view_xy()
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        plotter.camera.focal_point = middle
        plotter.camera.position = middle + camera
        plotter.camera.up = (0.0, 1.0, 0.0)
        plotter.enable_parallel_projection()
        right = np.cross([0.0, 1.0, 0.0], camera) / np.linalg.norm(camera[[0, 2]])
        up = np.cross(camera, right) / np.linalg.norm(camera)
        tall = np.abs((points - middle) @ up).max() * 1.05
        wide = np.abs((points - middle) @ right).max() * 1.05 * height / width
        plotter.camera.parallel_scale = max(tall, _HALF_HEIGHT if view == "front" else wide)
        plotter.reset_camera_clipping_range()
    plotter.set_background("white")
    plotter.screenshot(picture)


def main() -> None:
    """Read the arguments and render."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("bodies", type=Path, nargs="+", help="folder that homolog synth wrote")
    parser.add_argument("picture", type=Path, help="PNG to write")
    parser.add_argument("--columns", type=int, default=16)
    parser.add_argument("--count", type=int, default=64, help="of each folder")
    parser.add_argument("--from", dest="view", choices=_VIEWS, default="front", help="where the camera is")
    arguments = parser.parse_args()
    folders = [ShapeFolder.open(folder) for folder in arguments.bodies]
    render(folders, arguments.picture, arguments.columns, arguments.count, arguments.view)


if __name__ == "__main__":
    main()
