"""One synthetic body, of a person, an animal or a part of a person: its mesh and its ground truth on the template."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float, Int

from homolog.core.arguments import is_count, is_real
from homolog.core.errors import bad_value
from homolog.geometry.surface import BarycentricPoints, ReferenceSurface, Surface
from homolog.synthesis.ground_truth import project_mesh, vertices_at
from homolog.synthesis.remeshing import MeshSettings, is_one_closed_surface, remesh
from homolog.synthesis.self_intersections import self_intersection_share
from homolog.synthesis.template import Template, boundary_loops

MOST_CROSSING = 0.01
"""The largest share of self-intersecting triangles; a pose with more is scaled down, or another pose is sampled."""

POSE_SHARES = (1.0, 0.88, 0.75, 0.6, 0.45)
"""Factors by which a sampled pose is scaled down, one after the other, before another pose is sampled."""

POSES_OF_ONE = 4
"""How many bodies in a row are one individual, in kinds that have individuals."""

# The number of vertices varies by up to this share, so that it does not identify a body.
_COUNT_SPREAD = 0.04


class Kind(Protocol):
    """A kind of bodies that share one template: ``People``, ``Animals``, ``Hands``, ``Heads``, or a stand-in."""

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
        angles: of all joints, in degrees; for heads also the amounts of facial actions, from 0 to 1.
        pose_share: the factor by which the sampled pose was scaled down.
        opened: whether the lid of the template is taken away, so that the mesh has a boundary.
        mirrored: whether the finished mesh is reflected front to back (z), as right hands are.
    """

    build: Mapping[str, Any]
    family: str
    angles: Mapping[str, float]
    pose_share: float
    opened: bool = False
    mirrored: bool = False


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
        made = mesh_body(kind.template, points, body, mesh, generator, opened=character.opened)
        if made.self_intersection <= MOST_CROSSING and _is_sound(made.mesh, kind.template, opened=character.opened):
            return Body(character, _mirrored(made) if character.mirrored else made)
    raise AssertionError("characters never end")


def mesh_body(
    template: Template,
    points: BarycentricPoints,
    body: Surface,
    settings: MeshSettings,
    generator: np.random.Generator,
    *,
    opened: bool = False,
) -> MeshedBody:
    """Remesh a body, and compute the ground truth of the new mesh.

    Args:
        template: the closed surface that all bodies share.
        points: template points that carry the ground truth.
        body: the template in the body's shape and pose.
        settings: of the mesh.
        generator: of random numbers.
        opened: whether the template's lid is taken away.
    """
    reference = ReferenceSurface(body)
    mesh, barycentric = project_mesh(remesh(reference, template.detail, settings, generator), reference)
    if opened:
        mesh, barycentric = _without_lid(mesh, barycentric, body, template.lid)
    at_points = vertices_at(points, mesh, barycentric, body, template.rest)
    return MeshedBody(mesh, barycentric, at_points, self_intersection_share(mesh))


def _without_lid(
    mesh: Surface, barycentric: BarycentricPoints, body: Surface, lid: Int[np.ndarray, " l"]
) -> tuple[Surface, BarycentricPoints]:
    """A mesh without the triangles that lie on the lid; the vertices of its boundary move onto the rim of the lid."""
    on_lid = np.isin(barycentric.triangles, lid)
    used, faces = np.unique(mesh.faces[on_lid[mesh.faces].sum(axis=1) < 2], return_inverse=True)
    faces = faces.reshape(-1, 3)
    triangles, weights = barycentric.triangles[used], barycentric.weights[used]
    moved = np.unique(np.concatenate([*boundary_loops(faces), np.flatnonzero(on_lid[used])]))
    beside, corners = _rim(body, lid)
    ends = body.vertices[np.take_along_axis(body.faces[beside], corners, axis=1)]
    nearest, along = _nearest_on_segments(mesh.vertices[used[moved]], ends)
    triangles[moved], weights[moved] = beside[nearest], 0.0
    weights[moved, corners[nearest, 0]], weights[moved, corners[nearest, 1]] = 1.0 - along, along
    places = BarycentricPoints(triangles, weights)
    return Surface(places.positions(body), faces), places


def _rim(body: Surface, lid: Int[np.ndarray, " l"]) -> tuple[Int[np.ndarray, " r"], Int[np.ndarray, "r 2"]]:
    """The triangles beside a lid, and which two of their corners lie on its rim."""
    rim = {(a, b) for loop in boundary_loops(body.faces[lid]) for a, b in zip(loop, np.roll(loop, -1), strict=True)}
    sides = body.faces[:, [[0, 1], [1, 2], [2, 0]]]
    found = [(t, i, (i + 1) % 3) for t, of_one in enumerate(sides) for i, (a, b) in enumerate(of_one) if (b, a) in rim]
    beside, first, second = np.array(found).T
    return beside, np.stack([first, second], axis=1)


def _nearest_on_segments(
    points: Float[np.ndarray, "p 3"], ends: Float[np.ndarray, "s 2 3"]
) -> tuple[Int[np.ndarray, " p"], Float[np.ndarray, " p"]]:
    """The nearest of some segments for each point, and how far along it the nearest point lies, from 0 to 1."""
    sides = ends[:, 1] - ends[:, 0]
    offsets = points[:, None] - ends[:, 0]
    along = (np.einsum("psk,sk->ps", offsets, sides) / np.einsum("sk,sk->s", sides, sides)).clip(0, 1)
    nearest = np.linalg.norm(offsets - along[..., None] * sides, axis=2).argmin(axis=1)
    return nearest, along[np.arange(len(points)), nearest]


def _is_sound(mesh: Surface, template: Template, *, opened: bool) -> bool:
    """Whether a mesh is one closed surface like the template, or becomes one if its only boundary is closed."""
    euler_number = template.euler_number
    if not opened:
        return is_one_closed_surface(mesh, euler_number=euler_number)
    try:
        closed = Template.of_outer_faces(mesh.faces, mesh.vertices, np.ones(len(mesh.vertices)))
    except KeyError:  # a vertex where the boundary touches itself
        return False
    return len(closed.rims) == 1 and is_one_closed_surface(closed.rest, euler_number=euler_number)


def _mirrored(body: MeshedBody) -> MeshedBody:
    """Reflected front to back; triangles keep their outside, and vertices their places on the template."""
    mesh = Surface(body.mesh.vertices * [1.0, 1.0, -1.0], body.mesh.faces[:, [0, 2, 1]])
    return replace(body, mesh=mesh)
