"""When a proxy is matched in place of a shape, and which one. New here."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from homolog.core.choices import UseProxy
from homolog.core.errors import HomologError, MissingExtraError, ShapeError
from homolog.geometry.proxy import Proxy, proxy_for
from homolog.pairs.settings import ProxySettings
from homolog.shapes import Finding, Repaired, Shape, face_areas, farthest_points, half_edges, mesh_components, repair
from homolog.volumes.surface import simplified
from homolog.volumes.wrapping import wrapping_surface

_PROXY, _NONE = "points of a proxy", "points without a proxy"
PROXY_RULES = (_PROXY, _NONE)
"""The rules of the findings that say what is matched in place of a shape, or why the shape is kept as it is."""

# Grids that are so many times as coarse are tried where shells do not grow together on the finest.
_COARSER = (1, 2, 4)
# Evenly spread points of a cloud are chosen among so many times as many.
_CHOSEN_FROM = 4


def with_proxy(
    repaired: Repaired, use: UseProxy, settings: ProxySettings, *, as_cloud: bool = False, partial: bool = False
) -> Repaired:
    """A proxy for a shape that needs one, or the very shape.

    Args:
        repaired: a clean shape.
        use: ``"auto"`` makes one for a mesh in loose shells, or of faces that do not hang together, and for a large
            shape; ``"always"`` for any mesh.
        settings: when it is needed, and how it is made.
        as_cloud: its faces are left out.
        partial: it is a part, whose openings are to stay: it has none by itself.

    Raises:
        ShapeError: if one is asked for, and no closed surface goes around the shape.
        MissingExtraError: if one is asked for, and the extra ``volumes`` is not installed.
    """
    shape, forced = repaired.shape, use == "always"
    if use == "never":
        return repaired
    if shape.faces is not None and not as_cloud and (forced or not partial):
        why = _why(shape, shape.faces, settings)
        if why or forced:
            try:
                return _wrapped(repaired, settings, why or "it was asked for")
            except (MissingExtraError, ShapeError) as error:
                if forced:
                    raise
                repaired = _noted(repaired, error)
    try:
        return _reduced(repaired, settings, as_cloud=as_cloud)
    except MissingExtraError as error:
        return _noted(repaired, error)


def _noted(repaired: Repaired, error: HomologError) -> Repaired:
    """The shape itself, with a note why there is no proxy."""
    note = Finding(_NONE, repaired.shape.n_points, "note", f"kept as they are: {error}")
    return replace(repaired, report=replace(repaired.report, findings=(*repaired.report.findings, note)))


def _reduced(repaired: Repaired, settings: ProxySettings, *, as_cloud: bool) -> Repaired:
    """A proxy of fewer points for a large shape; the very shape where it is not large."""
    shape = repaired.shape
    if settings.largest is None or shape.n_points <= settings.largest:
        return repaired
    if shape.faces is None or as_cloud:
        found = Shape(_sampled(shape.points, settings.points), name=shape.name)
    else:
        found = repair(Shape(*simplified(shape.points, shape.faces, settings.points), name=shape.name)).shape
    action = f"matched in place of the shape, as it has more than {settings.largest}; proxy='never' matches all of them"
    return proxy_for(repaired, found, finding=Finding(_PROXY, found.n_points, "note", action), reach=settings.reach)


def _sampled(points: Float[np.ndarray, "n 3"], count: int) -> Float[np.ndarray, "count 3"]:
    """Points of a cloud, evenly spread."""
    some = points[np.sort(np.random.default_rng(0).permutation(len(points))[: _CHOSEN_FROM * count])]
    found: np.ndarray = some[farthest_points(some, count, seed=0)]
    return found


def _why(shape: Shape, faces: Int[np.ndarray, "m 3"], settings: ProxySettings) -> str:
    """Why a mesh needs a proxy; empty if it does not."""
    areas = mesh_components(shape.points, faces)[1]
    outside = 1 - areas.max() / areas.sum()
    if outside > settings.most_outside:
        return f"{100 * outside:.0f} % of its area is not on its largest component"
    ends = np.sort(half_edges(faces), axis=1)
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
