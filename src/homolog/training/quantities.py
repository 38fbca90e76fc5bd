"""What losses can ask for of a pair of shapes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog.core.errors import ArgumentError, DataError, TrainingError
from homolog.core.settings import Count, NotNegative, Positive, Settings
from homolog.geometry import Basis
from homolog.maps import (
    functional_map,
    normalised,
    point_map_from_functional_map,
    registered_positions,
    resolvent_mask,
    zoomout,
)
from homolog.maps.losses import (
    INFONCE_TEMPERATURE,
    REGISTRATION_REACH,
    multiplication_operators,
    partial_rank,
    softly_mapped,
)
from homolog.maps.soft_losses import (
    DAMPING,
    DIFFUSION_FUNCTIONS,
    DIFFUSION_TIME,
    SOFT_TEMPERATURE,
    map_from_common_points,
)


@dataclass(frozen=True, kw_only=True)
class QuantitySettings(Settings):
    """What the quantities of a pair, and the losses, are computed with. In a recipe they are keys of ``[loss]``.

    Args:
        map_eigenpairs: size of the functional maps.
        regularisation: weight of the resolvent mask in the functional maps.
        soft_temperature: temperature of the soft map. The weights remember it, and matching uses it as well.
        soft_iterations: iterations of Sinkhorn's algorithm.
        raw_products: compute the soft map from features of any length, as the published code does, not from unit ones.
        infonce_temperature: temperature of the contrastive loss.
        registration_reach: width of the registration loss's target distribution, in units of sqrt(area).
        coupling_temperature: temperature of the soft map of the meshes' features, in the losses that compare it.
        diffusion_time: the longest time of the loss ``diffusion``, in units of the area.
        diffusion_functions: how many random functions it takes.
        damping: of the loss ``damped_spectrum``: the exponent by which the highest eigenfunction is damped.
    """

    map_eigenpairs: Count = 80
    regularisation: NotNegative = 100.0
    soft_temperature: Positive = 0.1
    soft_iterations: Count = 10
    raw_products: bool = False
    infonce_temperature: Positive = INFONCE_TEMPERATURE
    registration_reach: Positive = REGISTRATION_REACH
    coupling_temperature: Positive = SOFT_TEMPERATURE
    diffusion_time: Positive = DIFFUSION_TIME
    diffusion_functions: Count = DIFFUSION_FUNCTIONS
    damping: NotNegative = DAMPING


@dataclass(frozen=True, eq=False)
class TrainingShape:
    """A mesh and a cloud of one shape, both as bases.

    Args:
        name: for messages.
        mesh: of the mesh, at all of its points or at samples.
        cloud: of a cloud of the same surface.
        pairing: takes functions at the mesh's points to the cloud's, sparse (n_cloud, n_mesh); None where both have the
            same points in the same order.
        cloud_is_partial: the cloud lacks a piece of the mesh's surface.
        template_rows: for each point of the template the row of the mesh's basis at which it lies, or -1 for none;
            None where no loss asks for ground truth.
        template_eigenvectors: the mesh's eigenvectors at each point of the template, NaN where it has none; None
            likewise. They are those of all points, not of the samples.
    """

    name: str
    mesh: Basis
    cloud: Basis
    pairing: Tensor | None = None
    cloud_is_partial: bool = False
    template_rows: Int[Tensor, " t"] | None = None
    template_eigenvectors: Float[Tensor, "t k"] | None = None

    def at_cloud(self, functions: Float[Tensor, "n_mesh c"]) -> Float[Tensor, "n_cloud c"]:
        """Functions on the mesh at the cloud's points."""
        return functions if self.pairing is None else self.pairing @ functions


class _Side:
    """Quantities of one of the two shapes."""

    def __init__(self, shape: TrainingShape, mesh: Tensor, cloud: Tensor | None, settings: QuantitySettings) -> None:
        self.shape, self.features, self.cloud_features, self._settings = shape, mesh, cloud, settings

    @cached_property
    def soft_features(self) -> Float[Tensor, "n_cloud d"]:
        assert self.cloud_features is not None
        return self.cloud_features if self._settings.raw_products else normalised(self.cloud_features)

    @cached_property
    def unit_features(self) -> Float[Tensor, "n d"]:
        return normalised(self.features)

    @cached_property
    def eigenvectors(self) -> Float[Tensor, "n k"]:
        return self.shape.mesh.eigenvectors[:, : self._settings.map_eigenpairs]

    @cached_property
    def pseudo_inverse(self) -> Float[Tensor, "k n"]:
        return self.shape.mesh.pseudo_inverse[: self._settings.map_eigenpairs]

    @cached_property
    def coefficients(self) -> Float[Tensor, "k d"]:
        return self.pseudo_inverse @ self.features

    @cached_property
    def products(self) -> Float[Tensor, "k d k"]:
        return multiplication_operators(self.unit_features, self.eigenvectors, self.pseudo_inverse)

    @cached_property
    def positions(self) -> Float[Tensor, "k 3"]:
        return self.pseudo_inverse @ self.shape.mesh.points

    @cached_property
    def eigenvalues(self) -> Float[Tensor, " k"]:
        return self.shape.mesh.eigenvalues[: self._settings.map_eigenpairs]

    @cached_property
    def cloud_eigenvectors(self) -> Float[Tensor, "n_cloud k"]:
        return self.shape.at_cloud(self.eigenvectors.contiguous())


_SIDED = (
    *("shape", "features", "unit_features", "cloud_features", "soft_features", "pseudo_inverse"),
    *("coefficients", "products", "positions", "eigenvalues", "cloud_eigenvectors"),
)
_SHARED = (
    *("c_xy", "c_yx", "rank", "registration_targets", "partial", "settings"),
    *("mapped_to_x", "mapped_to_y", "refined_x_to_y", "refined_y_to_x", "true_c_xy", "true_c_yx"),
    *("random_coefficients", "random_times"),
)
QUANTITIES = (*(f"{name}_{side}" for name in _SIDED for side in "xy"), *_SHARED)
"""The names of all quantities that losses can ask for."""
CLOUD_FEATURES = frozenset(f"{name}_{side}" for name in ("cloud_features", "soft_features") for side in "xy")
"""Those that need the features of clouds."""


class PairQuantities:
    """What losses can ask for of a pair, each computed when the first loss asks for it, and once.

    Of both shapes, with n points of the mesh, m of the cloud, and k map eigenpairs:

    | name, and with `_y` | what |
    |---|---|
    | `shape_x` | the `TrainingShape`: mesh and cloud as bases |
    | `features_x` | features of the mesh's points (n, d) |
    | `unit_features_x` | the same, of unit length (n, d) |
    | `cloud_features_x` | features of the cloud's points (m, d) |
    | `soft_features_x` | those as the soft map compares them: of unit length, unless `raw_products` |
    | `pseudo_inverse_x` | of the mesh's eigenvectors (k, n) |
    | `coefficients_x` | of the mesh's features (k, d) |
    | `products_x` | multiplication with each of the mesh's unit features, in coefficients (k, d, k) |
    | `positions_x` | coefficients of the mesh's positions, in units of sqrt(area) (k, 3) |
    | `eigenvalues_x` | of the mesh (k,) |
    | `cloud_eigenvectors_x` | of the mesh, at the cloud's points (m, k) |

    Of the pair:

    | name | what |
    |---|---|
    | `c_xy`, `c_yx` | functional maps of the meshes (k, k); `c_xy` takes coefficients on x to those on y |
    | `rank` | where y is a part of x: the rank of `c_xy`, see `partial_rank`; otherwise None |
    | `registration_targets` | where y's cloud lies once it is registered to x's (m_y, 3) |
    | `mapped_to_y`, `mapped_to_x` | eigenvectors of x at the points of y by the soft map (n_y, k), and back |
    | `refined_y_to_x`, `refined_x_to_y` | the point maps of the functional maps, refined by ZoomOut, without gradient |
    | `true_c_xy`, `true_c_yx` | functional maps by the ground truth |
    | `random_coefficients` | of random functions on x, of mean square one; as many as `diffusion_functions` (all, c) |
    | `random_times` | for each of them how long it diffuses (c,) |
    | `partial` | whether y is a part of x |
    | `settings` | the `QuantitySettings`, of which a recipe's `LossSettings` are some |

    Args:
        x: a shape; the full one if ``partial``.
        y: another; a part of one like x if ``partial``.
        features: of the meshes of x and y, and of their clouds, unless nothing asks for ``CLOUD_FEATURES``.
        settings: of the losses.
        partial: whether y is a part of x.
        registration_targets: where they are known; by default they are computed for the samples.
        generator: of random functions; by default torch's own.
    """

    def __init__(
        self,
        x: TrainingShape,
        y: TrainingShape,
        features: Sequence[Float[Tensor, "n d"]],
        settings: QuantitySettings,
        *,
        partial: bool = False,
        registration_targets: Float[Tensor, "m_y 3"] | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        self._generator = generator
        mesh_x, mesh_y = features[:2]
        cloud_x, cloud_y = features[2:] or (None, None)
        self.settings, self.partial, self._known_targets = settings, partial, registration_targets
        self._x, self._y = _Side(x, mesh_x, cloud_x, settings), _Side(y, mesh_y, cloud_y, settings)

    def of(self, names: Iterable[str]) -> dict[str, Any]:
        """The quantities of these names."""
        return {name: self._of(name) for name in names}

    def _of(self, name: str) -> Any:
        stem, _, side = name.rpartition("_")
        if stem in _SIDED:
            return getattr(self._x if side == "x" else self._y, stem)
        return getattr(self, name)

    @property
    def names(self) -> str:
        """What messages call the pair."""
        return f"{self._x.shape.name} -> {self._y.shape.name}"

    @property
    def c_xy(self) -> Float[Tensor, "k_y k_x"]:
        """The functional map from x to y."""
        return self._functional_maps[0]

    @property
    def c_yx(self) -> Float[Tensor, "k_x k_y"]:
        """The functional map from y to x."""
        return self._functional_maps[1]

    @cached_property
    def rank(self) -> int | None:
        """The rank of c_xy, if y is a part of x."""
        return partial_rank(self._x.eigenvalues, self._y.eigenvalues) if self.partial else None

    @cached_property
    def registration_targets(self) -> Float[Tensor, "m_y 3"]:
        """Where y's cloud lies once it is registered to x's."""
        if self._known_targets is not None:
            return self._known_targets
        return registered_positions(self._x.shape.cloud.points, self._y.shape.cloud.points)[1]

    @cached_property
    def mapped_to_y(self) -> Float[Tensor, "n_y k_x"]:
        """The eigenvectors of x at the points of y, by the soft map."""
        return self._softly_mapped(self._y, self._x)

    @cached_property
    def mapped_to_x(self) -> Float[Tensor, "n_x k_y"]:
        """The eigenvectors of y at the points of x, by the soft map the other way."""
        return self._softly_mapped(self._x, self._y)

    def _softly_mapped(self, to: _Side, of: _Side) -> Tensor:
        temperature = self.settings.coupling_temperature
        return softly_mapped(to.unit_features, of.unit_features, of.eigenvectors, temperature=temperature)

    @property
    def refined_y_to_x(self) -> Int[Tensor, " n_y"]:
        """For each point of y its point of x, refined."""
        return self._refined[0]

    @property
    def refined_x_to_y(self) -> Int[Tensor, " n_x"]:
        """For each point of x its point of y, refined."""
        return self._refined[1]

    @cached_property
    def _refined(self) -> tuple[Int[Tensor, " n_y"], Int[Tensor, " n_x"]]:
        phi_x, phi_y = self._x.shape.mesh.eigenvectors, self._y.shape.mesh.eigenvectors
        y_to_x = point_map_from_functional_map(self.c_xy.detach(), phi_x, phi_y)
        x_to_y = point_map_from_functional_map(self.c_yx.detach(), phi_y, phi_x)
        return zoomout(y_to_x, x_to_y, phi_x, phi_y, self._x.unit_features.detach(), self._y.unit_features.detach())

    @cached_property
    def true_c_xy(self) -> Float[Tensor, "k_y k_x"]:
        """The functional map from x to y by the ground truth."""
        return self._true_map(self._x, self._y)

    @cached_property
    def true_c_yx(self) -> Float[Tensor, "k_x k_y"]:
        """The functional map from y to x by the ground truth."""
        return self._true_map(self._y, self._x)

    def _true_map(self, of: _Side, to: _Side) -> Tensor:
        both = of.shape.template_eigenvectors, to.shape.template_eigenvectors
        if both[0] is None or both[1] is None or len(both[0]) != len(both[1]):
            raise DataError(f"{self.names} have no common template, which losses by ground truth need")
        source, target = (each[:, : self.settings.map_eigenpairs] for each in both if each is not None)
        known = ~(source.isnan().any(dim=1) | target.isnan().any(dim=1))
        return map_from_common_points(source[known], target[known])

    @cached_property
    def random_coefficients(self) -> Float[Tensor, "k c"]:
        """Coefficients of random functions on x: white noise in all of its eigenfunctions, of mean square one."""
        basis, count = self._x.shape.mesh, self.settings.diffusion_functions
        drawn = torch.randn(len(basis.eigenvalues), count, generator=self._generator, device=self._drawn_on)
        return drawn.to(basis.eigenvectors) * (basis.mass.sum() / len(drawn)).sqrt()

    @cached_property
    def random_times(self) -> Float[Tensor, " c"]:
        """For each random function a time, all up to the longest as likely."""
        drawn = torch.rand(self.settings.diffusion_functions, generator=self._generator, device=self._drawn_on)
        return self.settings.diffusion_time * drawn.to(self._x.shape.mesh.eigenvectors)

    @property
    def _drawn_on(self) -> torch.device:
        return torch.device("cpu") if self._generator is None else self._generator.device

    @cached_property
    def _functional_maps(self) -> tuple[Float[Tensor, "k_y k_x"], Float[Tensor, "k_x k_y"]]:
        x, y, weight = self._x, self._y, self.settings.regularisation
        mask = resolvent_mask(x.eigenvalues, y.eigenvalues)
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
