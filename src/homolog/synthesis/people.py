"""One body: who it is, how it stands, its own mesh and where this lies on the surface that all bodies share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from jaxtyping import Float, Int

from homolog.core.arguments import is_count, is_real
from homolog.core.errors import bad_value
from homolog.geometry.surface import Ground, Places, Surface
from homolog.synthesis.builds import draw_build, nearer_the_mean
from homolog.synthesis.crossings import crossing_share
from homolog.synthesis.ground_truth import settled, vertices_at
from homolog.synthesis.joints import Rotations, Skeleton, bone_rotations
from homolog.synthesis.poses import FAMILIES, draw_pose, drawn_back
from homolog.synthesis.remeshing import MeshSettings, is_one_closed_surface, remesh
from homolog.synthesis.template import Template

MOST_CROSSING = 0.01
"""A pose in which a larger share of the body's triangles cross others is drawn back, or another one is drawn."""

# How much of a drawn pose is tried, one share after the other, before another pose is drawn.
_SHARES = (1.0, 0.88, 0.75, 0.6, 0.45)
# After so many poses the build itself comes nearer to the mean one with every further pose.
_POSES_PER_BUILD = 6
_LESS_EXTREME = 0.85
# Meshes differ in their numbers of vertices by up to this much, so that no size is told from another by counting.
_COUNT_SPREAD = 0.04


class Bodies(Protocol):
    """What makes bodies: ``BodyModel``, or a stand-in for tests."""

    @property
    def template(self) -> Template:
        """The surface that all bodies share."""

    @property
    def skeleton(self) -> Skeleton:
        """Where each bone begins at rest."""

    def vertices(self, build: Mapping[str, float], rotations: Rotations) -> Float[np.ndarray, "v 3"]:
        """All the model's vertices of a body."""


@dataclass(frozen=True)
class PeopleSettings:
    """What a set of people depends on, besides how many they are.

    Args:
        seed: of everything drawn; body i depends on it and on i alone.
        mesh: how bodies are meshed.

    Raises:
        ArgumentError: if a value is out of range.
    """

    seed: int = 0
    mesh: MeshSettings = field(default_factory=MeshSettings)

    def __post_init__(self) -> None:
        if not is_count(self.seed, least=0):
            raise bad_value("seed", self.seed, "a whole number of at least 0")
        if not is_count(self.mesh.vertices, least=500):
            raise bad_value("vertices", self.mesh.vertices, "a whole number of at least 500")
        if not is_real(self.mesh.stretch) or not 1.0 <= self.mesh.stretch <= 5.0:
            raise bad_value("stretch", self.mesh.stretch, "a number from 1 to 5")


@dataclass(frozen=True)
class Character:
    """Who a body is and how it stands.

    Args:
        build: Anny's body parameters.
        family: what kind of pose it is.
        angles: of all joints, in degrees.
        pose_share: how much of the drawn pose is left, where it was drawn back.
    """

    build: Mapping[str, float]
    family: str
    angles: Mapping[str, float]
    pose_share: float


@dataclass(frozen=True)
class MeshedBody:
    """A body with a mesh of its own.

    Args:
        mesh: the mesh.
        places: where its vertices lie on the common surface.
        at_points: its vertex at each point of the template.
        crossing: the share of its triangles that cross others.
    """

    mesh: Surface
    places: Places
    at_points: Int[np.ndarray, " p"]
    crossing: float


@dataclass(frozen=True)
class Person:
    """A finished body of a set."""

    character: Character
    body: MeshedBody


def make_person(bodies: Bodies, points: Places, settings: PeopleSettings, index: int) -> Person:
    """Make one body of a set, always the same one for the same settings and index.

    Args:
        bodies: the body model.
        points: the template's points.
        settings: of the set.
        index: which body of the endless set, from 0.
    """
    generator = np.random.default_rng([settings.seed, index])
    for character in _characters(settings.seed, index, generator):
        body = bodies.template.surface(
            bodies.vertices(character.build, bone_rotations(character.angles, bodies.skeleton))
        )
        if crossing_share(body, by_area=True) > MOST_CROSSING:
            continue
        spread = 1.0 + _COUNT_SPREAD * generator.uniform(-1.0, 1.0)
        mesh = MeshSettings(round(settings.mesh.vertices * spread), settings.mesh.stretch)
        made = meshed(bodies.template, points, body, mesh, generator)
        if made.crossing <= MOST_CROSSING and is_one_closed_surface(made.mesh):
            return Person(character, made)
    raise AssertionError("characters never end")


def meshed(
    template: Template, points: Places, body: Surface, settings: MeshSettings, generator: np.random.Generator
) -> MeshedBody:
    """Give a body its own mesh, and the ground truth on it.

    Args:
        template: the surface that all bodies share.
        points: points of it that carry the ground truth.
        body: the same surface as the body stands.
        settings: how it is meshed.
        generator: the body's own source of random numbers.
    """
    ground = Ground(body)
    mesh, places = settled(remesh(ground, template.detail, settings, generator), ground)
    at_points = vertices_at(points, mesh, places, body, template.rest)
    return MeshedBody(mesh, places, at_points, crossing_share(mesh))


def _characters(seed: int, index: int, generator: np.random.Generator) -> Iterator[Character]:
    """Ever calmer poses of ever new draws, of a build that in the end comes nearer to the mean."""
    build, family = draw_build(seed, index), tuple(FAMILIES)[(seed + index) % len(FAMILIES)]
    draws = 0
    while True:
        drawn = draw_pose(family, generator)
        for share in _SHARES:
            angles = {name: round(angle, 3) for name, angle in drawn_back(drawn, share).items()}
            yield Character(build, family, angles, share)
        draws += 1
        if draws >= _POSES_PER_BUILD:
            build = nearer_the_mean(build, _LESS_EXTREME)
