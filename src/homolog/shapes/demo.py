"""The two bodies that come with Homolog."""

from __future__ import annotations

from pathlib import Path

from homolog.shapes.reading import read_shape
from homolog.shapes.shape import Shape


def demo_shapes() -> tuple[Shape, Shape]:
    """The two demo bodies, CC0: meshes of people in different poses, upright and facing +z, of some 5,000 points.

    Examples:
        >>> import homolog
        >>> source, target = homolog.shapes.demo_shapes()
        >>> source
        Shape('amber.off': mesh, 4918 points, 9832 faces)
    """
    folder = Path(__file__).parents[1] / "demo_data" / "off"
    return read_shape(folder / "amber.off"), read_shape(folder / "boris.off")
