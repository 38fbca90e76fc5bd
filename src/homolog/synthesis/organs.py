"""Variants of one shape of one's own, such as an organ or a bone: smooth warps of it that stretch it unevenly."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from homolog.core.choices import Turn
from homolog.core.errors import ShapeError
from homolog.core.files import expanded, sha256
from homolog.geometry.components import main_component, main_points
from homolog.geometry.scale import surface_area
from homolog.geometry.surface import Surface
from homolog.shapes import Shape, read_shape, repair
from homolog.synthesis.bodies import POSE_SHARES, Character
from homolog.synthesis.remeshing import is_one_closed_surface
from homolog.synthesis.sheets import separated_sheets
from homolog.synthesis.template import Template
from homolog.synthesis.turns import drawn_turn, turned
from homolog.synthesis.warping import Warp

# A version, increased whenever the same settings give other variants.
_MAKING = 1
# The stream of random numbers of warps.
_STREAM = 3


class Organs:
    """Variants of a shape, each warped and turned in its own way, in the units of its file.

    Args:
        file: a mesh that is one closed surface; it may have holes through it.
        strength: how much they differ from the shape; 0 for not at all.
        turn: how they are turned: not at all, about the vertical (y), or any way round.

    Raises:
        ShapeError: if the file holds anything else.
    """

    name = "organs"
    stem = "organ"

    def __init__(self, file: str | Path, *, strength: float = 1.0, turn: Turn = "any") -> None:
        self._file, self._strength, self._turn = expanded(file), strength, turn
        self._sha256 = sha256(self._file)
        self._rest = _one_closed_surface(read_shape(self._file))
        self._size = float(np.sqrt(surface_area(Shape(self._rest.vertices, self._rest.faces))))

    @property
    def assets(self) -> Sequence[Mapping[str, str]]:
        """The file; its terms are those of all variants."""
        terms = f"the terms of {self._file.name}"
        return ({"asset": self._file.name, "package": "", "version": self._sha256, "licence": terms, "source": ""},)

    @property
    def making(self) -> Mapping[str, Any]:
        """The version of the way in which variants are made, the hash of the file, and how much they differ."""
        how = {"strength": self._strength, "turn": self._turn}
        return {"kind": self.name, "way": _MAKING, "shape": self._sha256, **how}

    @cached_property
    def template(self) -> Template:
        """The shape itself, about its centre."""
        return Template.of_closed(self._rest)

    def surface(self, character: Character) -> Surface:
        """The shape after a warp, and turned."""
        build = character.build
        drawn = np.random.default_rng([build["seed"], build["individual"], build["attempt"], _STREAM])
        vertices = Warp.drawn(self._size, drawn)(self._rest.vertices, self._strength * character.pose_share)
        return Surface(turned(vertices, build["turn"]), self._rest.faces)

    def characters(self, seed: int, index: int, generator: np.random.Generator) -> Iterator[Character]:
        """Ever new warps, each weakened until the shape does not pass through itself."""
        turn = drawn_turn(self._turn, generator)
        for attempt in count():
            build = {"seed": seed, "individual": index, "attempt": attempt, "turn": turn}
            for share in POSE_SHARES:
                yield Character(build, "warped", {}, share)


def _one_closed_surface(shape: Shape) -> Surface:
    """The main component of the shape as repair leaves it, about the middle of its points.

    Raises:
        ShapeError: if it is not one closed surface.
    """
    repaired = repair(shape).shape
    if repaired.faces is None:
        raise ShapeError(f"{shape.name} is a point cloud; give a closed mesh, such as one of homolog reconstruct")
    apart, _ = separated_sheets(Surface(repaired.points, repaired.faces), shape.name)
    whole = Shape(apart.vertices, apart.faces)
    main = main_component(whole, main_points(whole))
    assert main.faces is not None
    surface = Surface(main.points - main.points.mean(axis=0), main.faces)
    if np.einsum("mk,mk->", surface.face_vectors, surface.vertices[surface.faces[:, 0]]) < 0:
        surface = Surface(surface.vertices, surface.faces[:, ::-1])
    template = Template.of_closed(surface)
    if not is_one_closed_surface(surface, euler_number=template.euler_number):
        raise ShapeError(f"{shape.name} is several closed surfaces; give one alone, without triangles inside it")
    return surface
