"""The losses of a training, one function each. To add one, write it here under ``@_builtin``; nothing else changes."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from typing import TypeVar

import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog.core.errors import ArgumentError, DataError, bad_choice, bad_value
from homolog.core.plugins import blamed_on, offered
from homolog.maps import losses as formulas
from homolog.maps import normalised
from homolog.maps import soft_losses as soft_formulas
from homolog.training.quantities import QUANTITIES, PairQuantities, QuantitySettings, TrainingShape

TOTAL = "total"
"""The name under which the sum of all losses is reported."""
_GROUP = "homolog.losses"
# Points of a shape in the benchmarks that the paper's weights were chosen on.
_USUAL_POINTS = 5000

LossFunction = Callable[..., Float[Tensor, ""]]
F = TypeVar("F", bound=LossFunction)


@dataclass(frozen=True)
class Loss:
    """One term of what a training minimises.

    Args:
        name: under which it is logged.
        weight: its factor in the total.
        requires: the quantities of a pair that it is computed from; see ``PairQuantities``.
        function: takes these quantities as keyword arguments and returns a scalar tensor.

    Raises:
        ArgumentError: if the weight is no number of at least 0, there is no such quantity, or the function does not
            take them.

    Examples:
        >>> from homolog.training import Loss
        >>> def small_maps(c_xy, c_yx):
        ...     return c_xy.square().mean() + c_yx.square().mean()
        >>> Loss("small_maps", 0.5, requires={"c_xy", "c_yx"}, function=small_maps).weight
        0.5
    """

    name: str
    weight: float
    requires: frozenset[str] | set[str]
    function: LossFunction

    def __post_init__(self) -> None:
        if self.name == TOTAL or not self.name.isidentifier():
            raise bad_value("name", self.name, f"a word of letters, digits and _ other than {TOTAL}")
        if not (math.isfinite(self.weight) and self.weight >= 0):
            raise bad_value(f"weight of {self.name}", self.weight, "a number of at least 0")
        if not callable(self.function):
            raise bad_value(f"function of {self.name}", self.function, "a function of the quantities that it requires")
        for quantity in sorted(self.requires - set(QUANTITIES)):
            raise bad_choice(f"what the loss {self.name} requires", quantity, QUANTITIES)
        try:
            inspect.signature(self.function).bind(**dict.fromkeys(self.requires))
        except TypeError as error:
            raise ArgumentError(
                f"the function of the loss {self.name} does not take what it requires, "
                f"{', '.join(sorted(self.requires))}: {error}"
            ) from None

    @classmethod
    def of(cls, name: str, weight: float, function: LossFunction) -> Loss:
        """A loss that requires what the parameters of its function are called, those with a default left out."""
        parameters = inspect.signature(function).parameters.values()
        return cls(name, weight, frozenset(p.name for p in parameters if p.default is p.empty), function)

    def weighted(self, pair: PairQuantities) -> Float[Tensor, ""]:
        """Its weight times its value for a pair.

        Raises:
            ArgumentError: if the function fails, or returns something other than a scalar tensor.
        """
        quantities = pair.of(self.requires)
        with blamed_on(f"the loss {self.name}", pair.names):
            value = self.function(**quantities)
        if not (isinstance(value, Tensor) and value.ndim == 0):
            found = f"shape {tuple(value.shape)}" if isinstance(value, Tensor) else type(value).__name__
            raise ArgumentError(f"the loss {self.name} returned {found}, but must return a scalar tensor")
        return self.weight * value


def _there_and_back(
    loss: LossFunction, there: Sequence[Tensor], back: Sequence[Tensor], *, partial: bool, **words: float
) -> Float[Tensor, ""]:
    """A loss of what leads from x to y, and back: not of a part's, whose functions lack a counterpart on the rest."""
    found: Tensor = loss(*there, **words)
    return found if partial else found + loss(*back, **words)


BUILTIN_LOSSES: dict[str, Loss] = {}
"""The losses that every recipe can name, with their default weights."""


def _builtin(weight: float) -> Callable[[F], F]:
    """Make a function a built-in loss, by its name and those of its parameters, with a default weight."""

    def register(function: F) -> F:
        BUILTIN_LOSSES[function.__name__] = Loss.of(function.__name__, weight, function)
        return function

    return register


@_builtin(weight=1.0)
def bijectivity(c_xy: Float[Tensor, "k_y k_x"], c_yx: Float[Tensor, "k_x k_y"], rank: int | None) -> Float[Tensor, ""]:
    """The functional maps are each other's inverse."""
    if rank is None:
        return formulas.bijectivity_loss(c_xy, c_yx)
    return formulas.partial_bijectivity_loss(c_xy, c_yx, rank=rank)


@_builtin(weight=1.0)
def orthogonality(
    c_xy: Float[Tensor, "k_y k_x"], c_yx: Float[Tensor, "k_x k_y"], rank: int | None
) -> Float[Tensor, ""]:
    """The functional maps preserve areas."""
    if rank is None:
        return formulas.orthogonality_loss(c_xy, c_yx)
    return formulas.partial_orthogonality_loss(c_xy, rank=rank)


@_builtin(weight=1e-3)
def alignment(
    c_xy: Float[Tensor, "k_y k_x"],
    cloud_eigenvectors_x: Float[Tensor, "m_x k_x"],
    cloud_eigenvectors_y: Float[Tensor, "m_y k_y"],
    soft_features_x: Float[Tensor, "m_x d"],
    soft_features_y: Float[Tensor, "m_y d"],
    shape_x: TrainingShape,
    shape_y: TrainingShape,
    partial: bool,
    settings: QuantitySettings,
) -> Float[Tensor, ""]:
    """The soft map of the clouds agrees with the functional map of the meshes ("coupling" in other papers).

    The paper sums over the points of full meshes: with fewer samples each stands for more of them.
    """
    if shape_x.cloud_is_partial:
        return soft_features_x.new_zeros(())  # functions on what the cloud lacks cannot be mapped from it
    maps = c_xy, cloud_eigenvectors_x, cloud_eigenvectors_y, soft_features_x, soft_features_y
    share, temperature = _USUAL_POINTS / len(soft_features_y), settings.soft_temperature
    if partial or shape_y.cloud_is_partial:
        return share * formulas.partial_alignment_loss(*maps, temperature=temperature)
    return share * formulas.alignment_loss(*maps, temperature=temperature, iterations=settings.soft_iterations)


@_builtin(weight=10.0)
def infonce(
    features_x: Float[Tensor, "n_x d"],
    features_y: Float[Tensor, "n_y d"],
    cloud_features_x: Float[Tensor, "m_x d"],
    cloud_features_y: Float[Tensor, "m_y d"],
    shape_x: TrainingShape,
    shape_y: TrainingShape,
    settings: QuantitySettings,
) -> Float[Tensor, ""]:
    """A cloud's features resemble those of its own mesh at the same points."""

    def of_one(shape: TrainingShape, mesh: Tensor, cloud: Tensor) -> Tensor:
        own, temperature = shape.at_cloud(mesh), settings.infonce_temperature
        return formulas.infonce_loss(normalised(cloud), normalised(own), temperature=temperature)

    return of_one(shape_x, features_x, cloud_features_x) + of_one(shape_y, features_y, cloud_features_y)


@_builtin(weight=0.0)
def commutativity(
    c_xy: Float[Tensor, "k_y k_x"],
    c_yx: Float[Tensor, "k_x k_y"],
    eigenvalues_x: Float[Tensor, " k_x"],
    eigenvalues_y: Float[Tensor, " k_y"],
) -> Float[Tensor, ""]:
    """The functional maps commute with the Laplacians, as those of isometries do."""
    back = formulas.commutativity_loss(c_yx, eigenvalues_y, eigenvalues_x)
    return formulas.commutativity_loss(c_xy, eigenvalues_x, eigenvalues_y) + back


@_builtin(weight=0.0)
def descriptors(
    c_xy: Float[Tensor, "k_y k_x"],
    c_yx: Float[Tensor, "k_x k_y"],
    products_x: Float[Tensor, "k_x d k_x"],
    products_y: Float[Tensor, "k_y d k_y"],
    partial: bool,
) -> Float[Tensor, ""]:
    """The functional maps commute with multiplication by the features, as those of point maps do."""
    there, back = (c_xy, products_x, products_y), (c_yx, products_y, products_x)
    return _there_and_back(formulas.descriptor_loss, there, back, partial=partial)


@_builtin(weight=0.0)
def smoothness(
    c_xy: Float[Tensor, "k_y k_x"],
    c_yx: Float[Tensor, "k_x k_y"],
    positions_x: Float[Tensor, "k_x 3"],
    positions_y: Float[Tensor, "k_y 3"],
    eigenvalues_x: Float[Tensor, " k_x"],
    eigenvalues_y: Float[Tensor, " k_y"],
) -> Float[Tensor, ""]:
    """The displacement that the functional maps make of positions is smooth. For pre-aligned shapes, such as organs."""
    back = formulas.smoothness_loss(c_yx, positions_y, positions_x, eigenvalues_x)
    return formulas.smoothness_loss(c_xy, positions_x, positions_y, eigenvalues_y) + back


@_builtin(weight=0.0)
def registration(
    soft_features_x: Float[Tensor, "m_x d"],
    soft_features_y: Float[Tensor, "m_y d"],
    shape_x: TrainingShape,
    shape_y: TrainingShape,
    registration_targets: Float[Tensor, "m_y 3"],
    partial: bool,
    settings: QuantitySettings,
) -> Float[Tensor, ""]:
    """Points of the clouds resemble what lies where their registration takes them. For pre-aligned full shapes."""
    if partial or shape_x.cloud_is_partial or shape_y.cloud_is_partial:
        return soft_features_x.new_zeros(())  # a full surface cannot be registered to a partial one
    points, reach, temperature = shape_x.cloud.points, settings.registration_reach, settings.soft_temperature
    return formulas.registration_loss(
        soft_features_x, soft_features_y, points, registration_targets, reach=reach, temperature=temperature
    )


@_builtin(weight=0.0)
def supervised(
    features_x: Float[Tensor, "n_x d"],
    features_y: Float[Tensor, "n_y d"],
    shape_x: TrainingShape,
    shape_y: TrainingShape,
    settings: QuantitySettings,
) -> Float[Tensor, ""]:
    """Points that correspond, by the ground truth, resemble each other: not self-supervised."""
    rows_x, rows_y = shape_x.template_rows, shape_y.template_rows
    if rows_x is None or rows_y is None or len(rows_x) != len(rows_y):
        raise DataError(f"{shape_x.name} and {shape_y.name} have no common template, which the loss supervised needs")
    pairs = torch.stack([rows_x, rows_y], dim=1)
    pairs = torch.unique(pairs[(pairs >= 0).all(dim=1)], dim=0)
    if not len(pairs):
        return features_x.new_zeros(())
    x, y = normalised(features_x[pairs[:, 0]]), normalised(features_y[pairs[:, 1]])
    return formulas.infonce_loss(x, y, temperature=settings.infonce_temperature)


@_builtin(weight=0.0)
def coupling(
    c_xy: Float[Tensor, "k_y k_x"],
    c_yx: Float[Tensor, "k_x k_y"],
    mapped_to_x: Float[Tensor, "n_x k_y"],
    mapped_to_y: Float[Tensor, "n_y k_x"],
    pseudo_inverse_x: Float[Tensor, "k_x n_x"],
    pseudo_inverse_y: Float[Tensor, "k_y n_y"],
    partial: bool,
) -> Float[Tensor, ""]:
    """The functional maps of the meshes are those of their soft maps; both learn from it."""
    there, back = (c_xy, mapped_to_y, pseudo_inverse_y), (c_yx, mapped_to_x, pseudo_inverse_x)
    return _there_and_back(soft_formulas.coupling_loss, there, back, partial=partial)


@_builtin(weight=0.0)
def true_maps(
    c_xy: Float[Tensor, "k_y k_x"],
    c_yx: Float[Tensor, "k_x k_y"],
    true_c_xy: Float[Tensor, "k_y k_x"],
    true_c_yx: Float[Tensor, "k_x k_y"],
    partial: bool,
) -> Float[Tensor, ""]:
    """The functional maps are those of the ground truth; not self-supervised."""
    return _there_and_back(soft_formulas.true_map_loss, (c_xy, true_c_xy), (c_yx, true_c_yx), partial=partial)


@_builtin(weight=0.0)
def teacher(
    unit_features_x: Float[Tensor, "n_x d"],
    unit_features_y: Float[Tensor, "n_y d"],
    refined_x_to_y: Int[Tensor, " n_x"],
    refined_y_to_x: Int[Tensor, " n_y"],
    partial: bool,
    settings: QuantitySettings,
) -> Float[Tensor, ""]:
    """The soft maps of the meshes resemble the refined point maps, which get no gradient."""
    x, y, temperature = unit_features_x, unit_features_y, settings.coupling_temperature
    there, back = (y, x, refined_y_to_x), (x, y, refined_x_to_y)
    return _there_and_back(soft_formulas.teacher_loss, there, back, partial=partial, temperature=temperature)


@_builtin(weight=0.0)
def diffusion(
    unit_features_x: Float[Tensor, "n_x d"],
    unit_features_y: Float[Tensor, "n_y d"],
    shape_x: TrainingShape,
    shape_y: TrainingShape,
    random_coefficients: Float[Tensor, "k c"],
    random_times: Float[Tensor, " c"],
    settings: QuantitySettings,
) -> Float[Tensor, ""]:
    """The soft map of the meshes commutes with the diffusion of random functions."""
    return soft_formulas.diffusion_loss(
        unit_features_y,
        unit_features_x,
        shape_y.mesh,
        shape_x.mesh,
        random_coefficients,
        random_times,
        temperature=settings.coupling_temperature,
    )


@_builtin(weight=0.0)
def damped_spectrum(
    unit_features_x: Float[Tensor, "n_x d"],
    unit_features_y: Float[Tensor, "n_y d"],
    shape_x: TrainingShape,
    shape_y: TrainingShape,
    settings: QuantitySettings,
) -> Float[Tensor, ""]:
    """The soft map of the meshes takes the 100, 150 and 200 lowest eigenfunctions, damped, to each other."""
    damping, temperature = settings.damping, settings.coupling_temperature
    return soft_formulas.damped_spectrum_loss(
        unit_features_y, unit_features_x, shape_y.mesh, shape_x.mesh, damping=damping, temperature=temperature
    )


NEED_TRUTH = ("supervised", "true_maps")
"""The losses that need ground truth."""


def installed_losses() -> dict[str, EntryPoint]:
    """The losses that installed packages offer under the entry-point group ``homolog.losses``. None is imported."""
    return offered(_GROUP, tuple(BUILTIN_LOSSES))
