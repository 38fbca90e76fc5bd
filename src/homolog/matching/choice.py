"""Which method matches, and which features it compares."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from homolog.core.errors import ArgumentError
from homolog.features import DEFAULT_WEIGHTS, FeatureExtractor, load_weights, on_device
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


def features_of_weights(weights: str | Path | None, settings: MatcherSettings) -> FeatureExtractor | None:
    """The features of the weights that were given; by default of those for people, where the method needs any."""
    if weights is None and not needs_features(settings):
        return None
    return load_weights(DEFAULT_WEIGHTS if weights is None else weights)


def method_between(
    source: Modality, target: Modality, method: Method, settings: MatcherSettings, extractor: FeatureExtractor | None
) -> Method:
    """The method for two shapes of these modalities.

    The one that was chosen; of ``"auto"`` ``axiomatic`` without features, ``functional-map`` for two meshes of
    near-isometric kind, and ``nearest-features`` otherwise.
    """
    if settings.method != AUTO or extractor is None or method.name == "axiomatic":
        return method
    spectral = source == target == "mesh" and extractor.info.near_isometric
    return as_method(find_method("functional-map" if spectral else "nearest-features"))
