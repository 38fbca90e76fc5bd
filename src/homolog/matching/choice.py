"""Which method matches, and which features it compares."""

from __future__ import annotations

import logging
from typing import Any

import torch

from homolog.core.errors import ArgumentError
from homolog.features import FeatureExtractor, on_device
from homolog.methods import AUTO, as_method, find_method
from homolog.pairs import MatcherSettings, Method
from homolog.shapes import Modality

_log = logging.getLogger(__name__)


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
    own = getattr(method, "features", None)
    if own is not None or not method.supports.needs_features:
        if given is not None:
            _log.warning(
                "The %s method does not use weights; the given ones, %s, are left aside.", method.name, given.info.name
            )
        return None if own is None else own(settings)
    if given is None:
        raise ArgumentError(f"method {method.name!r} needs weights; give some, or use 'axiomatic' or 'registration'")
    return on_device(given, device)


def method_name(settings: MatcherSettings) -> str:
    """What the method is called that settings ask for."""
    return settings.method if isinstance(settings.method, str) else _named(settings.method).name


def needs_features(settings: MatcherSettings) -> bool:
    """Whether the method compares features that it does not bring itself."""
    if settings.method == AUTO:
        return True
    method = _named(settings.method)
    return method.supports.needs_features and getattr(method, "features", None) is None


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
