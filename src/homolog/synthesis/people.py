"""One synthetic body: build, pose, a mesh of its own, and its ground truth on the common template."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from jaxtyping import Float, Int

from homolog.core.arguments import is_count, is_real
from homolog.core.errors import bad_value
from homolog.geometry.surface import BarycentricPoints, ReferenceSurface, Surface
from homolog.synthesis.builds import draw_build, toward_mean
from homolog.synthesis.ground_truth import project_mesh, vertices_at
from homolog.synthesis.joints import Rotations, Skeleton, bone_rotations
from homolog.synthesis.poses import FAMILIES, draw_pose, scaled_pose
from homolog.synthesis.remeshing import MeshSettings, is_one_closed_surface, remesh
from homolog.synthesis.self_intersections import self_intersection_share
from homolog.synthesis.template import Template

MOST_CROSSING = 0.01
"""The largest share of self-intersecting triangles; a pose with more is scaled down, or another pose is sampled."""

# Factors by which a sampled pose is scaled down, one after the other, before another pose is sampled.
_SHARES = (1.0, 0.88, 0.75, 0.6, 0.45)
# After this many poses the build moves towards the mean with every further pose.
_POSES_PER_BUILD = 6
_LESS_EXTREME = 0.85
# The number of vertices varies by up to this share, so that it does not identify a body.
_COUNT_SPREAD = 0.04


class Bodies(Protocol):
    """A body model: ``BodyModel``, or a stand-in in tests."""

    @property
    def template(self) -> Template:
        """The closed surface that all bodies share."""

    @property
    def skeleton(self) -> Skeleton:
        """The origin of each bone in the rest pose."""

    def vertices(self, build: Mapping[str, float], rotations: Rotations) -> Float[np.ndarray, "v 3"]:
        """All vertices of the model for a body."""


@dataclass(frozen=True)
class PeopleSettings:
    """Settings of a dataset of synthetic people.

    Args:
        seed: of all random choices; body i depends only on the seed and on i.
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
    """The build and pose of a body.

    Args:
        build: Anny's body parameters.
        family: of poses, such as "striding".
        angles: of all joints, in degrees.
        pose_share: the factor by which the sampled pose was scaled down.
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
        barycentric: its vertices on the template.
        at_points: its vertex at each template point.
        self_intersection: the share of its triangles that intersect others.
    """

    mesh: Surface
    barycentric: BarycentricPoints
    at_points: Int[np.ndarray, " p"]
    self_intersection: float


@dataclass(frozen=True)
class Person:
    """A finished body of a dataset."""

    character: Character
    body: MeshedBody


def make_person(bodies: Bodies, points: BarycentricPoints, settings: PeopleSettings, index: int) -> Person:
    """Make one body of a dataset; the same settings and index always give the same body.

    Args:
        bodies: the body model.
        points: the template points.
        settings: of the dataset.
        index: of the body in the endless sequence, from 0.
    """
    generator = np.random.default_rng([settings.seed, index])
    for character in _characters(settings.seed, index, generator):
        body = bodies.template.surface(
            bodies.vertices(character.build, bone_rotations(character.angles, bodies.skeleton))
        )
        if self_intersection_share(body, by_area=True) > MOST_CROSSING:
            continue
        spread = 1.0 + _COUNT_SPREAD * generator.uniform(-1.0, 1.0)
        mesh = MeshSettings(round(settings.mesh.vertices * spread), settings.mesh.stretch)
        made = mesh_body(bodies.template, points, body, mesh, generator)
        if made.self_intersection <= MOST_CROSSING and is_one_closed_surface(made.mesh):
            return Person(character, made)
    raise AssertionError("characters never end")


def mesh_body(
    template: Template, points: BarycentricPoints, body: Surface, settings: MeshSettings, generator: np.random.Generator
) -> MeshedBody:
    """Remesh a body, and compute the ground truth of the new mesh.

    Args:
        template: the closed surface that all bodies share.
        points: template points that carry the ground truth.
        body: the template in the body's shape and pose.
        settings: of the mesh.
        generator: of random numbers.
    """
    reference = ReferenceSurface(body)
    mesh, barycentric = project_mesh(remesh(reference, template.detail, settings, generator), reference)
    at_points = vertices_at(points, mesh, barycentric, body, template.rest)
    return MeshedBody(mesh, barycentric, at_points, self_intersection_share(mesh))


def _characters(seed: int, index: int, generator: np.random.Generator) -> Iterator[Character]:
    """Ever smaller poses of ever new samples, with a build that in the end moves towards the mean."""
    build, family = draw_build(seed, index), tuple(FAMILIES)[(seed + index) % len(FAMILIES)]
    draws = 0
    while True:
        pose = draw_pose(family, generator)
        for share in _SHARES:
            angles = {name: round(angle, 3) for name, angle in scaled_pose(pose, share).items()}
            yield Character(build, family, angles, share)
        draws += 1
        if draws >= _POSES_PER_BUILD:
            build = toward_mean(build, _LESS_EXTREME)
