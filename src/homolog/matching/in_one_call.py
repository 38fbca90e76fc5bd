"""Matching two shapes in one call."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from homolog.features import DEFAULT_WEIGHTS, FeatureInfo, load_weights
from homolog.geometry import OperatorCache
from homolog.matching.choice import needs_features
from homolog.matching.matcher import Matcher
from homolog.matching.result import Match
from homolog.methods import AUTO
from homolog.pairs import Device, MatcherSettings


def match(
    source: Any,
    target: Any,
    *,
    weights: str | Path | None = None,
    features: Any = None,
    method: Any = AUTO,
    settings: MatcherSettings | None = None,
    device: Device | torch.device = "auto",
    **options: Any,
) -> Match:
    """Match two shapes: for every point of each, the corresponding point of the other.

    Operators are kept in the user's cache, as by the command.

    Args:
        source: a path, a shape, or whatever ``as_shape`` takes.
        target: another.
        weights: pretrained weights by name, or a file; by default those for people, where the method needs any.
        features: features of one's own in their place: a function of operators, a module, or two arrays (n, d), one for
            each shape as given.
        method: name of a method, or one of one's own; see ``MatcherSettings``.
        settings: how maps are made; the method is the one given here.
        device: where to compute.
        **options: the fields of ``PairOptions``, such as ``partial="source"`` or ``as_cloud="both"``.

    Raises:
        ArgumentError: if something given is of another kind.
        ShapeError: if a shape cannot be read or used.

    Examples:
        >>> import homolog
        >>> source, target = homolog.demo_shapes()
        >>> match = homolog.match(source, target)
        >>> paths = match.save("result")
    """
    settings = replace(settings or MatcherSettings(), method=method)
    arrays = features if isinstance(features, tuple) else None
    if arrays is not None:
        extractor: Any = FeatureInfo(name="given", input="operators", upright=False)
    elif features is not None:
        extractor = features
    else:
        needs = method == AUTO or (method != "axiomatic" and needs_features(settings))
        extractor = load_weights(weights or DEFAULT_WEIGHTS) if needs or weights is not None else None
    matcher = Matcher(extractor, settings=settings, device=device, operators=OperatorCache.default().operators)
    return matcher.match(source, target, features=arrays, **options)
