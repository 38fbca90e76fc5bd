"""What turns the operators of a shape into features per point: a network, a function, a module of one's own."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from os import PathLike, fspath
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from homolog.core.errors import ArgumentError
from homolog.core.plugins import blamed_on
from homolog.core.reprs import function_name, named_function
from homolog.features.diffusion_net import DiffusionNet
from homolog.features.info import FeatureInfo, NetworkInput
from homolog.features.orienter import Orienter
from homolog.geometry import Basis, Operators
from homolog.maps import heat_kernel_signature, wave_kernel_signature

M = TypeVar("M", bound=nn.Module)

# Published networks take signatures of the lowest eigenpairs, however many there are.
_SIGNATURE_EIGENPAIRS = 128


@runtime_checkable
class FeatureExtractor(Protocol):
    """Computes features per point from the operators of one shape.

    Features that follow from positions (``info.follows_pose``) are also asked for at other poses and at some of a
    shape's points, and are then given the ``Basis`` there: it has the same ``points``, ``mass``, ``eigenvalues`` and
    ``eigenvectors``.
    """

    @property
    def info(self) -> FeatureInfo:
        """What the extractor expects of shapes, and how its features are to be compared."""
        ...

    def __call__(self, operators: Operators | Basis, /) -> Float[Tensor, "n d"]:
        """Features of all points (n, d)."""
        ...


@dataclass(frozen=True, eq=False)
class NetworkFeatures:
    """Features of a DiffusionNet, as ``load_weights`` reads it.

    Args:
        network: the network.
        info: what its weights expect.
        orienter: tells how shapes are to be turned before their features are computed; None where nothing does.
        file: of one's own that the weights were read from; empty where there is none.

    Examples:
        >>> import homolog
        >>> extractor = homolog.load_weights("people")
        >>> extractor.info.name, extractor.network.settings.out_channels
        ('people', 128)
    """

    network: DiffusionNet
    info: FeatureInfo = field(default_factory=FeatureInfo)
    orienter: Orienter | None = None
    file: str = ""

    def __call__(self, operators: Operators | Basis, /) -> Float[Tensor, "n d"]:
        """Features of all points (n, d)."""
        inputs = network_input(operators, self.info.input, self.network.settings.in_channels)
        features: Tensor = self.network(inputs, operators)
        return features

    def to(self, device: torch.device) -> NetworkFeatures:
        """The same on a device, in evaluation mode; this one's network stays as it is."""
        orienter = None if self.orienter is None else self.orienter.to(device)
        return replace(self, network=_evaluating(self.network, device), orienter=orienter)

    def __repr__(self) -> str:
        settings = self.network.settings
        return f"NetworkFeatures({self.info.name!r}: {self.info.input}, {settings.out_channels} channels)"


def network_input(
    operators: Operators | Basis, kind: NetworkInput, n_channels: int, *, points: Float[Tensor, "n 3"] | None = None
) -> Float[Tensor, "n i"]:
    """What a network computes features from.

    Args:
        operators: of the shape, or its basis.
        kind: what it is.
        n_channels: how many channels there are, those of positions included.
        points: positions in place of the shape's own, such as turned ones.
    """
    positions = operators.points if points is None else points
    if kind == "xyz":
        return positions
    if kind == "xyz+wks":
        return torch.cat([positions, _unit_signature(operators, n_channels - positions.shape[1])], dim=1)
    if kind == "hks":
        k = _SIGNATURE_EIGENPAIRS
        return heat_kernel_signature(operators.eigenvalues[:k], operators.eigenvectors[:, :k], n_times=n_channels)
    return _unit_signature(operators, n_channels)


def _unit_signature(operators: Operators | Basis, n_channels: int) -> Float[Tensor, "n i"]:
    """Wave kernel signatures, each channel of unit norm on the surface, as the published networks were given it."""
    k = _SIGNATURE_EIGENPAIRS
    signature = wave_kernel_signature(operators.eigenvalues[:k], operators.eigenvectors[:, :k], n_energies=n_channels)
    return signature / (operators.mass[:, None] * signature.square()).sum(dim=0).sqrt()


@dataclass(frozen=True, eq=False)
class FunctionFeatures:
    """Features of a function of operators, or of any ``torch.nn.Module`` that is called with them.

    Args:
        function: takes ``Operators`` and gives a tensor or array (n, d).
        info: how the features are to be compared. By default they are taken not to follow the pose.
    """

    function: Callable[[Any], Any]
    info: FeatureInfo

    def __call__(self, operators: Operators | Basis, /) -> Float[Tensor, "n d"]:
        """Features of all points (n, d).

        Raises:
            ArgumentError: if the function fails, or does not give one finite row per point.
        """
        name = named_function(self.info.name, self.function)
        with blamed_on(f"features {name}", hint=_hint(self.function)):
            values = self.function(operators)
        return checked_features(name, values, operators.points, operators.n_points)


@dataclass(frozen=True)
class GivenFeatures:
    """Stands for features that are given with each pair, as arrays.

    Args:
        info: how they are to be compared.
    """

    info: FeatureInfo

    def __call__(self, operators: Operators | Basis, /) -> Float[Tensor, "n d"]:
        """There is nothing to compute."""
        raise ArgumentError(
            f"features {self.info.name!r} are given with each pair, but none are; give features=(of_source, of_target)"
        )


def computed_features(extractor: FeatureExtractor, operators: Operators | Basis) -> Float[Tensor, "n d"]:
    """What an extractor gives; one of another's that fails is named.

    Raises:
        ArgumentError: if it fails, from what it raised.
    """
    if isinstance(extractor, NetworkFeatures):  # what fails there is no mistake of a user's
        return extractor(operators)
    with blamed_on(f"features {named_function(extractor.info.name, extractor)}", hint=_hint(extractor)):
        return extractor(operators)


def checked_features(name: str, values: Any, points: Float[Tensor, "m 3"], n_points: int) -> Float[Tensor, "n d"]:
    """Features as a tensor, checked to be one row of finite numbers per point.

    Args:
        name: of the features or of what gave them, for errors.
        values: a tensor, an array, or rows of numbers.
        points: of the precision and on the device that the features get.
        n_points: how many rows there must be.

    Raises:
        ArgumentError: naming what was found.
    """
    wanted = f"but must have one row of numbers per point, ({n_points}, d)"
    try:
        given = values if isinstance(values, Tensor) else torch.as_tensor(_array(values))
    except (TypeError, ValueError, RuntimeError):
        raise ArgumentError(f"features {name} are a {type(values).__name__} without numbers, {wanted}") from None
    if given.is_complex():
        raise ArgumentError(f"features {name} are complex, but must be real; give their real and imaginary parts")
    features = given.to(points)
    if features.ndim != 2 or len(features) != n_points or not features.shape[1]:
        raise ArgumentError(f"features {name} have shape {tuple(features.shape)}, {wanted}")
    if not torch.isfinite(features).all():
        raise ArgumentError(f"features {name} hold NaN or infinite numbers, but must be finite")
    return features


def _array(values: Any) -> np.ndarray:
    """Rows of numbers, each of them a list, an array or a tensor, as an array that a tensor can be made of."""
    if isinstance(values, list | tuple):
        values = [row.detach().cpu() if isinstance(row, Tensor) else row for row in values]
    array = np.array(values)
    return array.astype(float) if array.dtype.kind in "biuf" else array


def _hint(function: Any) -> str:
    """What to know of a module that fails, as most take a tensor."""
    if not isinstance(function, nn.Module):
        return ""
    return "a module is called with Operators, not with a tensor; give lambda shape: module(shape.points), for example"


def as_extractor(features: object, info: FeatureInfo | None = None) -> FeatureExtractor:
    """Make a feature extractor of what a user has.

    Args:
        features: a ``FeatureExtractor``; a ``DiffusionNet``; a ``FeatureInfo`` of features that are given with each
            pair; or a function of ``Operators``, such as any ``torch.nn.Module`` that is called with them, which gives
            (n, d). A ``Matcher`` works with a copy of a module, in evaluation mode and on its own device.
        info: what it expects of shapes, in place of what an extractor says itself. By default a DiffusionNet is taken
            to be trained on upright shapes, and the features of a function not to follow the pose.

    Raises:
        ArgumentError: if it is nothing of the kind, or there are two ``FeatureInfo``.

    Examples:
        >>> import homolog
        >>> from homolog.maps import heat_kernel_signature, wave_kernel_signature
        >>> from homolog.features import as_extractor
        >>> wks = as_extractor(lambda shape: wave_kernel_signature(shape.eigenvalues, shape.eigenvectors))
        >>> matcher = homolog.Matcher(wks)
    """
    if isinstance(features, DiffusionNet):
        return NetworkFeatures(features, info or FeatureInfo())
    if isinstance(features, FeatureInfo):
        if info is not None:
            raise ArgumentError("features is a FeatureInfo, and info is another; leave info out")
        return GivenFeatures(features)
    if isinstance(features, FeatureExtractor) and info is None:
        return features
    if isinstance(features, NetworkFeatures | FunctionFeatures | GivenFeatures):
        return replace(features, info=info or features.info)
    if callable(features):
        name = function_name(features)
        return FunctionFeatures(features, info or FeatureInfo(name=name, input="operators", upright=False))
    if isinstance(features, str | PathLike):
        kind, name = type(features).__name__, fspath(features)
        raise ArgumentError(f"features is a {kind}, {name!r}, but must be no name; give Matcher.from_weights({name!r})")
    raise ArgumentError(
        f"features is a {type(features).__name__}, but must be a feature extractor, a network or a function of "
        "operators; homolog.load_weights reads one from a file"
    )


def on_device(extractor: FeatureExtractor, device: torch.device) -> FeatureExtractor:
    """The extractor with a copy of its network, if it has any, on a device and in evaluation mode."""
    if isinstance(extractor, NetworkFeatures):
        return extractor.to(device)
    if isinstance(extractor, FunctionFeatures) and isinstance(extractor.function, nn.Module):
        return replace(extractor, function=_evaluating(extractor.function, device))
    if isinstance(extractor, nn.Module):
        return _evaluating(extractor, device)
    return extractor


def _evaluating(network: M, device: torch.device) -> M:
    # A copy, as whoever gave the network may be training it, or hold it on another device.
    try:
        own = copy.deepcopy(network)
    except Exception as error:
        raise ArgumentError(
            f"a {type(network).__name__} cannot be copied ({' '.join(str(error).split())}); "
            "give a function that calls it, such as lambda shape: network(shape)"
        ) from error
    return own.to(device).eval()
