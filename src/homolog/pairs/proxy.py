"""When a proxy is matched in place of a shape, and which one. New here."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
from jaxtyping import Int

from homolog.core.choices import UseProxy
from homolog.core.errors import MissingExtraError, ShapeError
from homolog.geometry.proxy import Proxy, proxy_for
from homolog.pairs.settings import ProxySettings
from homolog.shapes import Finding, Repaired, Shape, components, face_areas, repair
from homolog.volumes.wrapping import wrapping_surface

_PROXY, _LOOSE = "points of a proxy", "points in loose shells"
PROXY_RULES = (_PROXY, _LOOSE)
"""The rules of the findings that say what is matched in place of a shape, or why the shape is kept as it is."""

# Grids that are so many times as coarse are tried where shells do not grow together on the finest.
_COARSER = (1, 2, 4)


def with_proxy(repaired: Repaired, use: UseProxy, settings: ProxySettings, *, partial: bool = False) -> Repaired:
    """A proxy for a shape that needs one, or the very shape.

    Args:
        repaired: a clean shape.
        use: ``"auto"`` makes one for a mesh in loose shells, or of faces that do not hang together, ``"always"`` for
            any mesh.
        settings: when it is needed, and how it is made.
        partial: it is a part, whose openings are to stay: it has none by itself.

    Raises:
        ShapeError: if one is asked for, and no closed surface goes around the shape.
        MissingExtraError: if one is asked for, and the extra ``volumes`` is not installed.
    """
    shape, forced = repaired.shape, use == "always"
    if use == "never" or shape.faces is None or (partial and not forced):
        return repaired
    why = _why(shape, shape.faces, settings)
    if not (why or forced):
        return repaired
    try:
        return _wrapped(repaired, settings, why or "it was asked for")
    except (MissingExtraError, ShapeError) as error:
        if forced:
            raise
        note = Finding(_LOOSE, shape.n_points, "note", f"kept as they are: {error}")
        return replace(repaired, report=replace(repaired.report, findings=(*repaired.report.findings, note)))


def _why(shape: Shape, faces: Int[np.ndarray, "m 3"], settings: ProxySettings) -> str:
    """Why a mesh needs a proxy; empty if it does not."""
    label = components(faces[:, 0], faces[:, 1], shape.n_points, faces[:, 2])[faces[:, 0]]
    areas = np.bincount(label, face_areas(shape.points, faces))
    outside = 1 - areas.max() / areas.sum()
    if outside > settings.most_outside:
        return f"{100 * outside:.0f} % of its area is not on its largest component"
    ends = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    faces_of_edge = np.unique(ends[:, 0] * shape.n_points + ends[:, 1], return_counts=True)[1]
    broken = float((faces_of_edge != 2).mean())
    return f"{100 * broken:.0f} % of its edges do not join two faces" if broken > settings.most_broken else ""


def _wrapped(repaired: Repaired, settings: ProxySettings, why: str) -> Proxy:
    """The proxy on the finest grid on which all shells are one."""
    action = f"matched in place of the shape, as {why}; proxy='never' matches the shape itself"
    most = 0.0
    for coarser in _COARSER:
        with suppress(ShapeError):  # on coarse grids, faces may enclose nothing
            wrapping = wrapping_surface(
                repaired.shape, points=settings.points, resolution=settings.resolution // coarser
            )
            surface = repair(wrapping).shape
            finding = Finding(_PROXY, surface.n_points, "note", action)
            proxy = proxy_for(repaired, surface, finding=finding, reach=settings.reach)
            most = max(most, _covered(proxy))
            if most >= settings.least_covered:
                return proxy
    raise ShapeError(
        f"{repaired.shape.name}: one closed surface covers {100 * most:.0f} % of it; "
        "its shells lie apart, or enclose nothing"
    )


def _covered(proxy: Proxy) -> float:
    """The share of the area of what a proxy stands for that has a place on it."""
    shape = proxy.full.shape
    assert shape.faces is not None
    areas = face_areas(shape.points, shape.faces)
    return float(areas[proxy.places.valid[shape.faces].all(axis=1)].sum() / areas.sum())
