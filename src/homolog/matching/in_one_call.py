"""Matching two shapes in one call."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from homolog.core.arguments import given_or_default
from homolog.core.errors import ArgumentError
from homolog.features import FeatureInfo
from homolog.geometry import OperatorCache
from homolog.matching.choice import features_of_weights
from homolog.matching.matcher import Matcher
from homolog.matching.result import Match
from homolog.pairs import Device, MatcherSettings


def match(
    source: Any,
    target: Any,
    *,
    weights: str | Path | None = None,
    features: Any = None,
    method: Any = None,
    settings: MatcherSettings | None = None,
    device: Device | torch.device = "auto",
    **options: Any,
) -> Match:
    """Match two shapes: for every point of each, the corresponding point of the other.

    Operators are kept in the user's cache, as by the command.

    Args:
        source: a path, a shape, or whatever ``as_shape`` takes.
        target: another.
        weights: pretrained weights by name, or a file; by default those that know the pair best, where the method needs
            any.
        features: features of one's own in their place: a function of operators, a module, or two arrays (n, d), one for
            each shape as given.
        method: name of a method, or one of one's own, in place of that of the settings; see ``MatcherSettings``.
        settings: how maps are made.
        device: where to compute.
        **options: the fields of ``PairOptions``, such as ``partial="source"`` or ``as_cloud="both"``.

    Raises:
        ArgumentError: if something given is of another kind, or both weights and features are given.
        ShapeError: if a shape cannot be read or used.

    Examples:
        >>> import homolog
        >>> source, target = homolog.demo_shapes()
        >>> match = homolog.match(source, target)
        >>> paths = match.save("result")
    """
    if weights is not None and features is not None:
        raise ArgumentError("both weights and features are given, but only one of them can be compared; leave one out")
    settings = given_or_default("settings", settings, MatcherSettings)
    if method is not None:
        settings = replace(settings, method=method)
    arrays = None if callable(features) else features
    if arrays is not None:
        extractor: Any = FeatureInfo(name="given", input="operators", upright=False)
    elif features is not None:
        extractor = features
    else:
        extractor = features_of_weights(weights, settings)
    matcher = Matcher(extractor, settings=settings, device=device, operators=OperatorCache.default().operators)
    return matcher.match(source, target, features=arrays, **options)
