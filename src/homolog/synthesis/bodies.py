"""One synthetic body, of a person or an animal: a mesh of its own, and its ground truth on the common template."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from jaxtyping import Int

from homolog.core.arguments import is_count, is_real
from homolog.core.errors import bad_value
from homolog.geometry.surface import BarycentricPoints, ReferenceSurface, Surface
from homolog.synthesis.ground_truth import project_mesh, vertices_at
from homolog.synthesis.remeshing import MeshSettings, is_one_closed_surface, remesh
from homolog.synthesis.self_intersections import self_intersection_share
from homolog.synthesis.template import Template

MOST_CROSSING = 0.01
"""The largest share of self-intersecting triangles; a pose with more is scaled down, or another pose is sampled."""

POSE_SHARES = (1.0, 0.88, 0.75, 0.6, 0.45)
"""Factors by which a sampled pose is scaled down, one after the other, before another pose is sampled."""

# The number of vertices varies by up to this share, so that it does not identify a body.
_COUNT_SPREAD = 0.04


class Kind(Protocol):
    """A kind of bodies that share one template: ``People``, ``Animals``, or a stand-in in tests."""

    @property
    def name(self) -> str:
        """The plural, as in the name of the command."""

    @property
    def stem(self) -> str:
        """The singular, with which the names of bodies begin."""

    @property
    def assets(self) -> Sequence[Mapping[str, str]]:
        """Everything that the bodies are made from: asset, package, licence and source."""

    @property
    def making(self) -> Mapping[str, Any]:
        """Versions of all that the same settings depend on."""

    @property
    def template(self) -> Template:
        """The closed surface that all bodies share."""

    def characters(self, seed: int, index: int, generator: np.random.Generator) -> Iterator[Character]:
        """Endless candidates for a body of the sequence, from the wanted one to ever tamer ones."""

    def surface(self, character: Character) -> Surface:
        """The template in the shape and pose of a character."""


@dataclass(frozen=True)
class BodySettings:
    """Settings of a dataset of synthetic bodies.

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
        build: the parameters of its shape.
        family: of poses, such as "striding".
        angles: of all joints, in degrees.
        pose_share: the factor by which the sampled pose was scaled down.
    """

    build: Mapping[str, Any]
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
class Body:
    """A finished body of a dataset."""

    character: Character
    meshed: MeshedBody


def make_body(kind: Kind, points: BarycentricPoints, settings: BodySettings, index: int) -> Body:
    """Make one body of a dataset; the same settings and index always give the same body.

    Args:
        kind: of bodies.
        points: the template points.
        settings: of the dataset.
        index: of the body in the endless sequence, from 0.
    """
    generator = np.random.default_rng([settings.seed, index])
    for character in kind.characters(settings.seed, index, generator):
        body = kind.surface(character)
        if self_intersection_share(body, by_area=True) > MOST_CROSSING:
            continue
        spread = 1.0 + _COUNT_SPREAD * generator.uniform(-1.0, 1.0)
        mesh = MeshSettings(round(settings.mesh.vertices * spread), settings.mesh.stretch)
        made = mesh_body(kind.template, points, body, mesh, generator)
        if made.self_intersection <= MOST_CROSSING and is_one_closed_surface(made.mesh):
            return Body(character, made)
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
