"""Which method matches, and which features it compares."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import torch

from homolog.core.arguments import check_kind, given_or_default
from homolog.core.errors import ArgumentError
from homolog.core.pretrained import AUTO_WEIGHTS, KINDS, OF_PARTS, pretrained_weights
from homolog.features import FeatureExtractor, FeatureInfo, as_extractor, load_weights, on_device
from homolog.geometry import OperatorSettings
from homolog.methods import AUTO, as_method, find_method
from homolog.pairs import MatcherSettings, Method
from homolog.shapes import Modality


def chosen_method(settings: MatcherSettings, extractor: FeatureExtractor | None) -> Method:
    """The method that was asked for; of ``"auto"`` the one for meshes, or ``axiomatic`` without features."""
    if settings.method == AUTO:
        return as_method(find_method("axiomatic" if extractor is None else "functional-map"))
    return _named(settings.method)


def _named(method: Any) -> Method:
    return as_method(find_method(method) if isinstance(method, str) else method)


def extractors_of(features: Any, info: FeatureInfo | None) -> tuple[FeatureExtractor, ...]:
    """What computes the features that were given: one extractor, several to choose from, or none.

    Raises:
        ArgumentError: if something given computes none, or one of several has no orienter, which tells what it knows.
    """
    if info is not None:
        check_kind("info", info, FeatureInfo)
    if features is None:
        return ()
    several = tuple(features) if isinstance(features, list | tuple) else (features,)
    found = tuple(as_extractor(each, info) for each in several)
    for extractor in found if len(found) > 1 else ():
        if getattr(extractor, "orienter", None) is None:
            raise ArgumentError(
                f"the features {extractor.info.name!r} have no orienter, which tells whether they know a shape; "
                "give them alone, or weights of homolog train with orienter steps"
            )
    return found


def operators_expected(extractors: Iterable[FeatureExtractor | None]) -> OperatorSettings:
    """The operators that features were trained with; without any, the usual ones.

    Raises:
        ArgumentError: if they were trained with different ones.
    """
    infos = {extractor.info.name: extractor.info for extractor in extractors if extractor is not None}
    expected = {
        name: OperatorSettings(info.n_eigenpairs, info.laplacian, info.n_neighbours) for name, info in infos.items()
    }
    if len(set(expected.values())) > 1:
        raise ArgumentError(
            f"the features {', '.join(map(repr, expected))} expect different operators; give them alone"
        )
    return next(iter(expected.values()), OperatorSettings())


def extractor_for(
    method: Method, given: FeatureExtractor | None, settings: MatcherSettings, device: torch.device
) -> FeatureExtractor | None:
    """The features that the method compares."""
    if not _compares_given_features(method):
        own = getattr(method, "features", None)
        return None if own is None else own(settings)
    if given is None:
        raise ArgumentError(f"method {method.name!r} needs weights; give some, or use 'axiomatic' or 'registration'")
    return on_device(given, device)


def left_aside_warnings(method: Method, given: FeatureExtractor | None) -> tuple[str, ...]:
    """Say if features are given that the method does not compare."""
    if given is None or _compares_given_features(method):
        return ()
    return (
        f"the weights or features {given.info.name!r} are left aside, as the method {method.name!r} does not use any; "
        "leave them out, or choose another method",
    )


def needs_features(settings: MatcherSettings) -> bool:
    """Whether the method compares features that it does not bring itself."""
    return settings.method == AUTO or _compares_given_features(_named(settings.method))


def _compares_given_features(method: Method) -> bool:
    return method.supports.needs_features and getattr(method, "features", None) is None


def features_of_weights(
    weights: str | Path | None, settings: MatcherSettings | None = None
) -> FeatureExtractor | tuple[FeatureExtractor, ...] | None:
    """The features of the weights that were given; by default of all kinds of shapes, where the method needs any.

    Raises:
        ArgumentError: if something given is of another kind.
        WeightsError: if there are no such weights, or the file does not hold any.
    """
    settings = given_or_default("settings", settings, MatcherSettings)
    if weights is not None and str(weights) != AUTO_WEIGHTS:
        return load_weights(weights)
    if not needs_features(settings):
        return None
    return tuple(load_weights(name) for name in (*KINDS, *OF_PARTS) if name in pretrained_weights())


def method_between(
    source: Modality,
    target: Modality,
    method: Method,
    settings: MatcherSettings,
    extractor: FeatureExtractor | None,
    *,
    parts: bool = False,
) -> Method:
    """The method for two shapes of these modalities, or for two parts.

    The one that was chosen; of ``"auto"`` ``axiomatic`` without features, ``functional-map`` for two meshes of
    near-isometric kind, unless both are parts, and ``nearest-features`` otherwise.
    """
    if settings.method != AUTO or extractor is None or method.name == "axiomatic":
        return method
    spectral = source == target == "mesh" and extractor.info.near_isometric and not parts
    return as_method(find_method("functional-map" if spectral else "nearest-features"))
