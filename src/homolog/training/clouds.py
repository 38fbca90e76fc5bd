"""The clouds and parts of a mesh that the network is trained on beside it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy.sparse as sparse
from jaxtyping import Float, Int

from homolog.core.errors import ShapeError
from homolog.shapes import Shape, add_noise, face_areas
from homolog.synthesis import PartialShape, ViewSettings, cut, cut_holes, view
from homolog.training.settings import CloudSettings

Kind = Literal["clean", "noise", "subsampled", "resampled", "cut", "holes", "views"]

# What a depth camera sees of a triangle has no triangles of its own.
_MESH_PARTS = ("cut", "holes")
_NEED_NO_FACES = ("clean", "noise", "subsampled")


@dataclass(frozen=True)
class CloudVariant:
    """One way to make a cloud of a mesh.

    Args:
        kind: ``"clean"`` for the mesh's own points, or a key of a recipe's ``[clouds]``.
        amount: one of that key's values.
        hole_radius: the least and the greatest radius of holes.
        is_mesh: it keeps the triangles that are left.
    """

    kind: Kind = "clean"
    amount: float = 0.0
    hole_radius: tuple[float, float] = CloudSettings.hole_radius
    is_mesh: bool = False

    def __str__(self) -> str:
        return f"{self.kind} {self.amount:g}{' as a mesh' if self.is_mesh else ''}"

    @property
    def is_partial(self) -> bool:
        """Whether it lacks a piece of the surface."""
        return self.kind in ("cut", "holes", "views")


@dataclass(frozen=True, eq=False)
class Cloud:
    """A cloud, or a part with its triangles, and where its points lie on its mesh.

    Args:
        shape: in the mesh's own units.
        weights: barycentric weights of each cloud point at the mesh's points (n_cloud, n_mesh), or None where point i
            of the cloud comes from point i of the mesh.
    """

    shape: Shape
    weights: sparse.csr_array | None


def cloud_variants(settings: CloudSettings) -> tuple[CloudVariant, ...]:
    """The variants that a recipe asks for; the clean one comes first."""
    kinds: tuple[Kind, ...] = ("noise", "subsampled", "resampled", "cut", "holes", "views")
    variants = [
        CloudVariant(kind, amount, settings.hole_radius) for kind in kinds for amount in getattr(settings, kind)
    ]
    meshes = (replace(each, is_mesh=True) for each in variants if each.kind in _MESH_PARTS and settings.part_meshes)
    return (CloudVariant(), *variants, *meshes)


def make_cloud(mesh: Shape, variant: CloudVariant, *, seed: int) -> Cloud:
    """Make a cloud of a clean mesh of unit area, or of a clean cloud.

    Raises:
        ShapeError: if it has no faces, and the variant takes some.
    """
    if mesh.faces is None and variant.kind not in _NEED_NO_FACES:
        raise ShapeError("it has no faces; leave that out, or make a surface with homolog reconstruct")
    random = np.random.default_rng(seed)
    if variant.kind == "noise":
        return Cloud(add_noise(mesh.as_cloud(), variant.amount, seed=seed), None)
    if variant.kind == "subsampled":
        kept = np.sort(random.permutation(mesh.n_points)[: max(round(variant.amount * mesh.n_points), 1)])
        return _weighted(mesh, sparse.eye_array(mesh.n_points, format="csr")[kept])
    if variant.kind == "resampled":
        return _weighted(mesh, _resampled(mesh, round(variant.amount), random))
    if variant.kind == "cut":
        return _part(mesh, cut(mesh, removed=1 - variant.amount, seed=seed), variant)
    if variant.kind == "holes":
        holed = cut_holes(mesh, holes=round(variant.amount), radius=variant.hole_radius, seed=seed)
        return _part(mesh, holed, variant)
    if variant.kind == "views":
        # A depth camera's points lie within triangles or, with noise, before and behind them.
        seen = view(mesh, ViewSettings(noise=variant.amount), seed=seed).cloud
        assert seen.triangles is not None and seen.weights is not None
        return Cloud(seen.shape, _interpolation(mesh, seen.triangles, seen.weights))
    return Cloud(mesh.as_cloud(), None)


def _weighted(mesh: Shape, weights: sparse.csr_array) -> Cloud:
    return Cloud(Shape(weights @ mesh.points, name=mesh.name), weights)


def _part(mesh: Shape, part: PartialShape, variant: CloudVariant) -> Cloud:
    shape = part.shape if variant.is_mesh else part.shape.as_cloud()
    return Cloud(shape, sparse.eye_array(mesh.n_points, format="csr")[part.full_index])


def _resampled(mesh: Shape, number: int, random: np.random.Generator) -> sparse.csr_array:
    """Barycentric weights (number, n) of points drawn evenly from the surface."""
    areas = face_areas(mesh.points, mesh.faces)  # type: ignore[arg-type]
    triangles = random.choice(len(areas), size=number, p=areas / areas.sum())
    # Evenly distributed over a triangle: the square root makes up for its narrowing towards the first corner.
    far, across = np.sqrt(random.random(number)), random.random(number)
    return _interpolation(mesh, triangles, np.stack([1 - far, far * (1 - across), far * across], axis=1))


def _interpolation(
    mesh: Shape, triangles: Int[np.ndarray, " number"], weights: Float[np.ndarray, "number 3"]
) -> sparse.csr_array:
    """Barycentric weights at the corners of triangles as weights at all points of the mesh (number, n)."""
    corners = mesh.faces[triangles]  # type: ignore[index]
    rows = np.repeat(np.arange(len(triangles)), 3)
    return sparse.csr_array((weights.ravel(), (rows, corners.ravel())), shape=(len(triangles), mesh.n_points))
