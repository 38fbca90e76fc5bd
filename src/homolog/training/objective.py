"""What one pair of shapes teaches the network, without any correspondence between them."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.core.errors import ArgumentError, TrainingError, bad_value
from homolog.features import AugmentationSettings, DiffusionNet, augmented
from homolog.geometry import Basis
from homolog.maps import functional_map, normalised, registered_positions, resolvent_mask
from homolog.maps.losses import (
    INFONCE_TEMPERATURE,
    REGISTRATION_REACH,
    alignment_loss,
    bijectivity_loss,
    commutativity_loss,
    infonce_loss,
    orthogonality_loss,
    partial_alignment_loss,
    partial_bijectivity_loss,
    partial_orthogonality_loss,
    partial_rank,
    registration_loss,
    smoothness_loss,
)

# Points of a shape in the benchmarks that the paper's weights were chosen on.
_USUAL_POINTS = 5000


@dataclass(frozen=True)
class LossSettings:
    """Weights and sizes of the losses; the defaults are the paper's but for the similarity of features.

    Args:
        bijectivity: weight of the functional maps being each other's inverse.
        orthogonality: weight of their keeping areas. With 0, the weights are for shapes that are not nearly isometric:
            see ``near_isometric`` of ``homolog.features.FeatureInfo``.
        alignment: weight of the soft map of the clouds agreeing with the functional map of the meshes, per sample as
            if there were 5,000 of them.
        infonce: weight of a cloud's features resembling those of its own mesh.
        commutativity: weight of functional maps commuting with the Laplacians.
        smoothness: weight of what functional maps do to positions being smooth; for organs and the like, which stand
            alike and keep neither lengths nor areas.
        registration: weight of points of the clouds resembling what lies where their registration takes them; for the same
            shapes, and not for parts, which lack what would have to go somewhere.
        registration_reach: how far around, in units of sqrt(area).
        map_eigenpairs: size of the functional maps.
        regularisation: of the functional maps.
        soft_temperature: of the soft map.
        soft_iterations: of Sinkhorn's algorithm.
        raw_products: make the soft map of features as they come, as the published code does, not of unit ones.
        infonce_temperature: of the contrastive loss.
    """

    bijectivity: float = 1.0
    orthogonality: float = 1.0
    alignment: float = 1e-3
    infonce: float = 10.0
    commutativity: float = 0.0
    smoothness: float = 0.0
    registration: float = 0.0
    map_eigenpairs: int = 80
    regularisation: float = 100.0
    soft_temperature: float = 0.1
    soft_iterations: int = 10
    raw_products: bool = False
    infonce_temperature: float = INFONCE_TEMPERATURE
    registration_reach: float = REGISTRATION_REACH

    def __post_init__(self) -> None:
        for name in (*(f.name for f in fields(Losses)), "regularisation"):
            if not 0 <= getattr(self, name) < float("inf"):
                raise bad_value(name, getattr(self, name), "a finite number of at least 0")
        for name in ("soft_temperature", "infonce_temperature", "registration_reach"):
            if not 0 < getattr(self, name) < float("inf"):
                raise bad_value(name, getattr(self, name), "a positive finite number")
        for name in ("map_eigenpairs", "soft_iterations"):
            if getattr(self, name) < 1:
                raise bad_value(name, getattr(self, name), "at least 1")


@dataclass(frozen=True, eq=False)
class TrainingShape:
    """A mesh and a cloud of one shape, both as bases.

    Args:
        name: for messages.
        mesh: of the mesh, at all of its points or at samples.
        cloud: of a cloud of the same surface.
        pairing: takes functions at the mesh's points to the cloud's, sparse (n_cloud, n_mesh); None where both have the
            same points in the same order.
        cloud_is_part: the cloud lacks a piece of the mesh's surface.
    """

    name: str
    mesh: Basis
    cloud: Basis
    pairing: Tensor | None = None
    cloud_is_part: bool = False

    def at_cloud(self, functions: Float[Tensor, "n_mesh c"]) -> Float[Tensor, "n_cloud c"]:
        """Functions on the mesh at the cloud's points."""
        return functions if self.pairing is None else self.pairing @ functions


@dataclass(frozen=True)
class Losses:
    """The weighted losses of a pair, and their sum."""

    bijectivity: Float[Tensor, ""]
    orthogonality: Float[Tensor, ""]
    alignment: Float[Tensor, ""]
    infonce: Float[Tensor, ""]
    commutativity: Float[Tensor, ""]
    smoothness: Float[Tensor, ""]
    registration: Float[Tensor, ""]

    @property
    def total(self) -> Float[Tensor, ""]:
        """The sum of all, what is minimised."""
        known = self.bijectivity + self.orthogonality + self.alignment + self.infonce
        return known + self.commutativity + self.smoothness + self.registration

    def as_dict(self) -> dict[str, float]:
        """All of them as numbers, ``total`` included."""
        values = {f.name: float(getattr(self, f.name).detach()) for f in fields(self)}
        return {**values, "total": sum(values.values())}


def pair_losses(
    network: DiffusionNet,
    x: TrainingShape,
    y: TrainingShape,
    *,
    settings: LossSettings,
    augmentation: AugmentationSettings | None = None,
    generator: torch.Generator | None = None,
    partial: bool = False,
    registration_targets: Float[Tensor, "n_y 3"] | None = None,
) -> Losses:
    """The losses of a pair of shapes, from four passes of the network.

    Args:
        network: in training or evaluation mode.
        x: a shape; the complete one if ``partial``.
        y: another; a part of one like x if ``partial``, at the same scale.
        settings: weights and sizes.
        augmentation: how to vary the input of each pass; None to leave it.
        generator: of all that is random, dropout included; torch's own by default.
        partial: use the losses for a part of a shape.
        registration_targets: where y's cloud lies once it is registered to x's, see ``homolog.maps.registered_positions``;
            by default that of the samples.
    """
    bases = [x.mesh, y.mesh, x.cloud, y.cloud]
    inputs = [basis.points for basis in bases]
    with _full_precision(inputs[0].device):
        if augmentation is not None:
            inputs = [augmented(points, augmentation, generator) for points in inputs]
    mesh_x, mesh_y, *clouds = network.several(inputs, bases, generator=generator)
    with _full_precision(inputs[0].device):
        meshes = _Side(x, mesh_x, settings), _Side(y, mesh_y, settings)
        return _losses(*meshes, *clouds, settings=settings, partial=partial, registration_targets=registration_targets)


def _full_precision(device: torch.device) -> torch.autocast:
    """In bfloat16, positions would be off by as much as their jitter, and the logits of the losses by a twentieth."""
    return torch.autocast(device.type, enabled=False)


class _Side:
    """What the losses need of one shape's mesh."""

    def __init__(self, shape: TrainingShape, features: Float[Tensor, "n d"], settings: LossSettings) -> None:
        k = settings.map_eigenpairs
        self.shape, self.features = shape, features
        self.coefficients = shape.mesh.pseudo_inverse[:k] @ features
        self.positions = shape.mesh.pseudo_inverse[:k] @ shape.mesh.points
        self.eigenvalues = shape.mesh.eigenvalues[:k]
        self.eigenvectors = shape.at_cloud(shape.mesh.eigenvectors[:, :k].contiguous())

    def infonce(self, cloud: Float[Tensor, "n d"], settings: LossSettings) -> Float[Tensor, ""]:
        own = self.shape.at_cloud(self.features)
        return infonce_loss(normalised(cloud), normalised(own), temperature=settings.infonce_temperature)


def _losses(
    x: _Side,
    y: _Side,
    cloud_x: Float[Tensor, "n_x d"],
    cloud_y: Float[Tensor, "n_y d"],
    *,
    settings: LossSettings,
    partial: bool,
    registration_targets: Float[Tensor, "n_y 3"] | None,
) -> Losses:
    c_xy, c_yx = _functional_maps(x, y, settings)
    compared = (cloud_x, cloud_y) if settings.raw_products else (normalised(cloud_x), normalised(cloud_y))
    if partial:
        rank = partial_rank(x.eigenvalues, y.eigenvalues)
        bijectivity = partial_bijectivity_loss(c_xy, c_yx, rank=rank)
        orthogonality = partial_orthogonality_loss(c_xy, rank=rank)
    else:
        bijectivity, orthogonality = bijectivity_loss(c_xy, c_yx), orthogonality_loss(c_xy, c_yx)
    commutativity = (
        commutativity_loss(c_xy, x.eigenvalues, y.eigenvalues) + commutativity_loss(c_yx, y.eigenvalues, x.eigenvalues)
        if settings.commutativity
        else torch.zeros_like(bijectivity)
    )
    smoothness = (
        smoothness_loss(c_xy, x.positions, y.positions, y.eigenvalues)
        + smoothness_loss(c_yx, y.positions, x.positions, x.eigenvalues)
        if settings.smoothness
        else torch.zeros_like(bijectivity)
    )
    return Losses(
        bijectivity=settings.bijectivity * bijectivity,
        orthogonality=settings.orthogonality * orthogonality,
        alignment=settings.alignment * _alignment(c_xy, x, y, *compared, settings, partial=partial),
        infonce=settings.infonce * (x.infonce(cloud_x, settings) + y.infonce(cloud_y, settings)),
        commutativity=settings.commutativity * commutativity,
        smoothness=settings.smoothness * smoothness,
        registration=settings.registration
        * _registration(x, y, *compared, settings, registration_targets=registration_targets, partial=partial),
    )


def _functional_maps(
    x: _Side, y: _Side, settings: LossSettings
) -> tuple[Float[Tensor, "k_y k_x"], Float[Tensor, "k_x k_y"]]:
    mask, weight = resolvent_mask(x.eigenvalues, y.eigenvalues), settings.regularisation
    try:
        return (
            functional_map(x.coefficients, y.coefficients, mask, regularisation=weight),
            functional_map(y.coefficients, x.coefficients, mask.mT, regularisation=weight),
        )
    except ArgumentError:
        raise TrainingError(
            f"the features of {x.shape.name} and {y.shape.name} are not finite, or give no functional map; "
            "lower learning_rate, raise regularisation, or look at these shapes with homolog info"
        ) from None


def _alignment(
    c_xy: Float[Tensor, "k_y k_x"],
    x: _Side,
    y: _Side,
    cloud_x: Float[Tensor, "n_x d"],
    cloud_y: Float[Tensor, "n_y d"],
    settings: LossSettings,
    *,
    partial: bool,
) -> Float[Tensor, ""]:
    if x.shape.cloud_is_part:
        return torch.zeros_like(c_xy.sum())  # what it lacks cannot be carried over from it
    shapes = c_xy, x.eigenvectors, y.eigenvectors, cloud_x, cloud_y
    # The paper sums over the points of full meshes: with fewer samples each stands for more of them.
    share = _USUAL_POINTS / len(cloud_y)
    if partial or y.shape.cloud_is_part:
        return share * partial_alignment_loss(*shapes, temperature=settings.soft_temperature)
    temperature, iterations = settings.soft_temperature, settings.soft_iterations
    return share * alignment_loss(*shapes, temperature=temperature, iterations=iterations)


def _registration(
    x: _Side,
    y: _Side,
    cloud_x: Float[Tensor, "n_x d"],
    cloud_y: Float[Tensor, "n_y d"],
    settings: LossSettings,
    *,
    registration_targets: Float[Tensor, "n_y 3"] | None,
    partial: bool,
) -> Float[Tensor, ""]:
    if not settings.registration or partial or x.shape.cloud_is_part or y.shape.cloud_is_part:
        return torch.zeros_like(cloud_x.sum())
    points, others = x.shape.cloud.points, y.shape.cloud.points
    wanted = registered_positions(points, others)[1] if registration_targets is None else registration_targets
    reach, temperature = settings.registration_reach, settings.soft_temperature
    return registration_loss(cloud_x, cloud_y, points, wanted, reach=reach, temperature=temperature)
