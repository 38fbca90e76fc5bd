"""Which way is up."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
from jaxtyping import Float

from homolog.core.arguments import check_choice, check_kind
from homolog.core.choices import Up
from homolog.shapes.shape import Shape


def stand_upright(shape: Shape, up: Up) -> Shape:
    """Turn a shape whose ``up`` axis points up so that +y does.

    A z-up shape that faces -y, as most software has it, then faces +z.

    Raises:
        ArgumentError: if it is no shape, or ``up`` not x, y or z.

    Examples:
        >>> import homolog
        >>> shape = homolog.Shape([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]])
        >>> homolog.stand_upright(shape, "z").points[3].tolist()
        [0.0, 3.0, 0.0]
    """
    check_kind("shape", shape, Shape)
    check_choice("up", up, get_args(Up))
    return shape if up == "y" else replace(shape, points=shape.points @ upright_rotation(up).T, space=None)


def mirrored(shape: Shape) -> Shape:
    """The mirror image of a shape, left for right (x); its faces keep their outside.

    Examples:
        >>> import homolog
        >>> from homolog.shapes import mirrored
        >>> shape = homolog.Shape([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], [[0, 1, 2], [0, 3, 1]])
        >>> mirrored(shape).points[1].tolist(), mirrored(shape).faces[0].tolist()
        ([-1.0, 0.0, 0.0], [2, 1, 0])
    """
    faces = None if shape.faces is None else shape.faces[:, ::-1]
    return replace(shape, points=shape.points * np.array([-1.0, 1.0, 1.0]), faces=faces, space=None)


def upright_rotation(up: Up) -> Float[np.ndarray, "3 3"]:
    """The turn that ``stand_upright`` makes."""
    return {"x": rotation_about(2, 90), "y": np.eye(3), "z": rotation_about(0, -90)}[up]


def rotation_about(axis: int, degrees: float) -> Float[np.ndarray, "3 3"]:
    """The right-handed rotation about coordinate axis 0, 1 or 2, by multiples of a quarter exact."""
    cosine, sine = np.round([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))], 15)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    rotation = np.eye(3)
    rotation[first, first] = rotation[second, second] = cosine
    rotation[first, second], rotation[second, first] = -sine, sine
    return rotation
