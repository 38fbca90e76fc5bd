"""Fitting the body model to a scan: along the map from its template first, then to the nearest surface. New here."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, Protocol, get_args

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from homolog.core.arguments import check_choice, check_kind
from homolog.core.errors import ArgumentError, ShapeError
from homolog.core.progress import Progress, ignore
from homolog.fitting.articulated import ArticulatedModel, Fit, Goal, fitted
from homolog.fitting.body import PeopleModel
from homolog.geometry import Surface, outward
from homolog.geometry.projection import SurfaceProjector
from homolog.maps import rigid_motion
from homolog.matching import Match, match
from homolog.shapes import Shape

Unit = Literal["auto", "m", "cm", "mm", "free"]
"""The unit of a scan's coordinates: told by its size, given, or none, so that the scale is fitted."""

UNITS = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
"""How many of each are a metre."""

# By how much a body in metres may be smaller or larger than the mean body, in sqrt(area): babies of whom half is seen,
# and people who are tall.
_SIZES = (0.16, 1.6)
_FEWEST = 100
# At most so many pairs and points take part in a step.
_MOST_PAIRS = 4000
# Along the map: what a point may be off to count a quarter, in metres, and how stiff bones are.
_ALONG_MAP = ((0.5, 1e-3, 6), (0.2, 1e-4, 6), (0.1, 1e-5, 8))
# To the nearest surface: the same, the share of distances along it, and how many steps.
_TO_SURFACE = (
    (0.05, 3e-6, 0.3, 3),
    (0.03, 1e-6, 0.2, 3),
    (0.02, 3e-7, 0.1, 3),
    (0.02, 1e-7, 0.1, 3),
    (0.01, 3e-8, 0.05, 3),
    (0.01, 3e-8, 0.03, 3),
    (0.01, 3e-8, 0.03, 3),
)
# In so many of these rounds the model's points are drawn to the scan as well, and not the scan's to the model alone.
_BOTH_WAYS = 2
# Among so many of the model's nearest points is one whose normal agrees.
_NEAR = 12
# Cosine of the angle between normals of points that may correspond.
_SAME_SIDE = 0.5
# The weight of a pair that does not count.
_NONE = 1e-9
_FAR = 0.02
"""A mean distance in metres above which a fit gets a warning."""


class BodyTemplate(ArticulatedModel, Protocol):
    """An articulated model with a template to match."""

    @property
    def name(self) -> str:
        """As on the command line."""

    @property
    def template(self) -> Shape:
        """The mean shape at rest, +y up, facing +z, in metres; its triangles face outward."""


@dataclass(frozen=True, eq=False, repr=False)
class BodyFit:
    """A body model fitted to a scan.

    Args:
        model: its name.
        fit: the parameters; lengths are metres.
        unit: of the scan: ``m``, ``cm``, ``mm``, or ``free`` where the scale was fitted.
        units_per_metre: how many of the scan's units are a metre.
        registered: the model's surface in the scan's coordinates and units.
        distances: of each of its points from the scan's surface, in the scan's units (n,).
        seen: which of its points have a counterpart on the scan; all others follow from the model (n,).
        match: of the template with the scan.
        parameters: the shape parameters by name.
        bones: the rotation of each bone that is turned, as a matrix, by name.

    Examples:
        >>> found = homolog.fitting.fit_body("scan.ply")  # doctest: +SKIP
        >>> found.parameters["height"], found.registered.points  # doctest: +SKIP
    """

    model: str
    fit: Fit
    unit: str
    units_per_metre: float
    registered: Shape
    distances: Float[np.ndarray, " n"]
    seen: Bool[np.ndarray, " n"]
    match: Match
    parameters: dict[str, float]
    bones: dict[str, Float[np.ndarray, "3 3"]]

    @property
    def mean_distance(self) -> float:
        """Of the points that are seen, in metres."""
        return float(self.distances[self.seen].mean()) / self.units_per_metre

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know, a line each."""
        if self.mean_distance <= _FAR:
            return self.match.warnings
        told = (
            f"the fitted body lies {100 * self.mean_distance:.1f} cm from the scan on average; look at it, at the "
            "scan's unit, and at the map, which may be wrong"
        )
        return (*self.match.warnings, told)

    def __repr__(self) -> str:
        return f"BodyFit({self.model!r}: {1000 * self.mean_distance:.1f} mm from {self.match.target.name!r} on average)"


def fit_to_match(found: Match, model: BodyTemplate, *, unit: Unit = "auto", progress: Progress = ignore) -> BodyFit:
    """Fit a body model to a scan along a match of its template with the scan.

    Shape parameters, rotations of bones and the place of the whole are fitted to the pairs of both directions, by
    confidence; points without a counterpart are left out, on the scan, and on the model where the scan is partial.
    Then, round by round, points of the model are drawn to the nearest points of the scan's surface whose normals agree,
    more and more along the normals alone.

    Args:
        found: the match; its source is the model's template.
        model: the model.
        unit: of the scan's coordinates.
        progress: called before each round.

    Raises:
        ArgumentError: if the match is that of another shape, or a word is none of those.
        ShapeError: if too few points have a counterpart.
    """
    check_kind("found", found, Match)
    check_choice("unit", unit, get_args(Unit))
    if not np.array_equal(found.source.points, model.template.points):
        raise ArgumentError("found is no match of the model's template; give homolog.match(model.template, scan)")
    scan = SurfaceProjector(found.target)
    name, per_metre = _unit_of(found, scan, unit)
    pairs = _pairs(found, per_metre)
    seen = np.asarray(found.source_to_target >= 0)
    if seen.sum() < _FEWEST:  # the map tells nothing of what is seen
        seen = np.ones(len(seen), dtype=bool)
    rounds = len(_ALONG_MAP) + len(_TO_SURFACE)
    now = _placed(model, pairs)
    for number, (reach, stiffness, steps) in enumerate(_ALONG_MAP):
        progress(number, rounds, "fit along the map")
        goal = Goal(*pairs, reach=reach, stiffness=stiffness)
        now = fitted(model, now, goal, steps=steps, free_scale=name == "free")
    side = _side(model, now, scan, per_metre)
    for number, (reach, stiffness, sliding, steps) in enumerate(_TO_SURFACE, len(_ALONG_MAP)):
        progress(number, rounds, "fit to the surface")
        goal = _from_scan(model, now, scan, found, per_metre, side)
        if number < len(_ALONG_MAP) + _BOTH_WAYS:
            goal = _joined(goal, _to_scan(model, now, scan, seen, per_metre, side or 1))
        goal = goal._replace(reach=reach, stiffness=stiffness, sliding=sliding)
        now = fitted(model, now, goal, steps=steps, free_scale=name == "free")
    points = per_metre * now.points(model)
    distances = np.linalg.norm(scan.positions(scan.project(points)) - points, axis=1)
    registered = Shape(points, model.template.faces, name=f"{model.name} on {found.target.name}")
    build = dict(zip(model.parameters, now.build.tolist(), strict=True))
    bones = {model.bones[number]: now.rotations[number] for number in model.turning.tolist()}
    return BodyFit(model.name, now, name, per_metre, registered, distances, seen, found, build, bones)


class _Pairs(NamedTuple):
    """Points of the model, where they belong, in metres, and the trust in it."""

    rows: Int[np.ndarray, " p"]
    positions: Float[np.ndarray, "p 3"]
    weights: Float[np.ndarray, " p"]


def _pairs(found: Match, per_metre: float) -> _Pairs:
    """The pairs of both directions, each of which has half of the weight; some of them where there are many."""
    (leave,) = np.nonzero(found.source_to_target >= 0)
    finite = np.isfinite(found.target.points).all(axis=1)
    (arrive,) = np.nonzero((found.target_to_source >= 0) & finite)
    taken = np.union1d(found.source_to_target[leave], arrive)
    if len(taken) < _FEWEST:
        raise ShapeError(
            f"{found.target.name} cannot be fitted: {len(taken)} of its points have a counterpart on the body model, "
            f"but at least {_FEWEST} must; give a scan with more points"
        )
    leave, arrive = (each[:: max(1, 2 * len(each) // _MOST_PAIRS)] for each in (leave, arrive))
    weights = [
        found.source_confidence[leave] / max(len(leave), 1),
        found.target_confidence[arrive] / max(len(arrive), 1),
    ]
    places = np.concatenate([found.source_to_target[leave], arrive])
    rows = np.concatenate([leave, found.target_to_source[arrive]])
    return _Pairs(rows, found.target.points[places] / per_metre, np.concatenate(weights) + 1e-9)


def _unit_of(found: Match, scan: SurfaceProjector, unit: Unit) -> tuple[str, float]:
    """The name of a scan's unit, and how many are a metre; by its size where it is not given."""
    size = scan.unit / SurfaceProjector(found.source).unit
    if unit in UNITS:
        return unit, UNITS[unit]
    if unit == "auto":
        for name, per_metre in UNITS.items():
            if _SIZES[0] <= size / per_metre <= _SIZES[1]:
                return name, per_metre
    return "free", size


def _placed(model: ArticulatedModel, pairs: _Pairs) -> Fit:
    """The mean body at rest, turned and moved as a whole to where its points belong."""
    rest = Fit.at_rest(model)
    points = model.pose(rest.build, rest.rotations, pairs.rows).points
    rotation, _ = rigid_motion(points, pairs.positions)
    turned = rest.rotations.copy()
    turned[model.parents < 0] = rotation
    points = model.pose(rest.build, turned, pairs.rows).points
    shift = np.average(pairs.positions - points, axis=0, weights=pairs.weights)
    return replace(rest, rotations=turned, shift=shift)


def _side(model: BodyTemplate, now: Fit, scan: SurfaceProjector, per_metre: float) -> int:
    """1 or -1 where a scan's triangles face outward or inward, of an open one by the model's nearest points; or 0."""
    if scan.surface is None or (side := outward(scan.surface)):
        return 0 if scan.surface is None else side
    points, faces = now.points(model), model.template.faces
    assert faces is not None
    _, near = cKDTree(points).query(scan.shape.points / per_metre)
    agreement = (Surface(points, faces).vertex_normals[near] * scan.surface.vertex_normals).sum(axis=1)
    return int(np.sign(np.sign(agreement).mean()))


def _from_scan(
    model: BodyTemplate, now: Fit, scan: SurfaceProjector, found: Match, per_metre: float, side: int
) -> Goal:
    """The scan's points that have a counterpart, and the model's nearest ones, whose normals agree.

    A scan's points lie on the body, but its triangles within it.
    """
    points, faces = now.points(model), model.template.faces
    assert faces is not None
    normals = Surface(points, faces).vertex_normals
    (taken,) = np.nonzero(found.target_to_source[scan.repaired.kept] >= 0)
    if len(taken) < _FEWEST:  # the map tells nothing of what belongs to the body
        taken = np.arange(scan.shape.n_points)
    taken = taken[:: max(1, len(taken) // _MOST_PAIRS)]
    positions = scan.shape.points[taken] / per_metre
    _, near = cKDTree(points).query(positions, k=_NEAR)
    agree = np.ones(near.shape, dtype=bool)
    if scan.surface is not None and side:
        own = side * scan.surface.vertex_normals[taken]
        agree = np.einsum("rnk,rk->rn", normals[near], own) > _SAME_SIDE
    rows = near[np.arange(len(near)), agree.argmax(axis=1)]
    return Goal(rows, positions, np.where(agree.any(axis=1), 1.0, _NONE), normals=normals[rows])


def _to_scan(
    model: BodyTemplate, now: Fit, scan: SurfaceProjector, seen: Bool[np.ndarray, " n"], per_metre: float, side: int
) -> Goal:
    """Points of the model that are seen, and the nearest ones of the scan's surface, whose normals agree."""
    points, faces = now.points(model), model.template.faces
    assert faces is not None
    rows = np.flatnonzero(seen)
    rows = rows[:: max(1, len(rows) // _MOST_PAIRS)]
    normals = Surface(points, faces).vertex_normals[rows]
    below = scan.project(per_metre * points[rows], side * normals)
    found = scan.normals(below)
    agree = np.ones(len(rows), dtype=bool)
    if found is not None:
        agree = np.einsum("nk,nk->n", side * found, normals) > _SAME_SIDE
    return Goal(rows, scan.positions(below) / per_metre, np.where(agree, 1.0, _NONE), normals=normals)


def _joined(one: Goal, other: Goal) -> Goal:
    assert one.normals is not None and other.normals is not None
    return Goal(
        np.concatenate([one.rows, other.rows]),
        np.concatenate([one.positions, other.positions]),
        np.concatenate([one.weights, other.weights]),
        np.concatenate([one.normals, other.normals]),
    )


def fit_body(
    scan: Any, *, model: BodyTemplate | None = None, unit: Unit = "auto", progress: Progress = ignore, **words: Any
) -> BodyFit:
    """Fit the body model of ``homolog synth people`` to a scan of a person, in any pose and any way round.

    Args:
        scan: a path, a shape, or whatever ``as_shape`` takes: a mesh or a cloud of a person; of a part of one, such as
            what one camera sees, with ``partial="target"``.
        model: the body model; by default ``PeopleModel()``, whose first use on a machine takes minutes.
        unit: of the scan's coordinates.
        progress: called before each round.
        **words: those of ``homolog.match`` for its target.

    Raises:
        ArgumentError: if a word is not allowed.
        MissingExtraError: if anny is not installed.
        ShapeError: if the scan cannot be read or used.

    Examples:
        >>> found = homolog.fitting.fit_body("scan.ply")  # doctest: +SKIP
        >>> found.parameters["height"]  # doctest: +SKIP
        0.61
    """
    check_choice("unit", unit, get_args(Unit))
    body = PeopleModel() if model is None else model
    return fit_to_match(match(body.template, scan, **words), body, unit=unit, progress=progress)
