"""What does not belong to a shape: outliers, background planes, and other objects. New here."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from homolog.core.arguments import check_kind, given_or_default
from homolog.geometry.background import find_backgrounds
from homolog.geometry.clutter_settings import ClutterSettings
from homolog.geometry.components import cloud_components, in_large_components
from homolog.geometry.outliers import find_outliers
from homolog.geometry.scale import cloud_area
from homolog.shapes import FEWEST_POINTS, Finding, Repaired, Shape, check, half_edges, mesh_components, repair
from homolog.shapes.equal_rows import first_of_equal_rows

# The shape has at least this share of the area of all components.
_LEAST_OF_ALL = 0.25
# How far apart components are is told by some of their positions, none of which is farther from its next than this
# share of the gap.
_THINNED = 0.1

_PLANE, _OUTLIERS, _OBJECTS = "points of a plane", "outliers", "points of other objects"
EXTRA_PART = "points of a part that only this shape has"
"""The rule of the finding that says what has no counterpart on the other shape."""
CLUTTER_RULES = (_PLANE, _OUTLIERS, _OBJECTS, EXTRA_PART)
"""The rules of the findings that say what was set apart."""
MASKED = "points outside the mask"
"""The rule of the finding that says what a user left out."""


@dataclass(frozen=True, eq=False)
class Clutter:
    """Which points of a shape do not belong to it.

    Args:
        outliers: points off the surface, each by itself (n,).
        planes: points of each plane in the background, such as a floor (n,).
        objects: points of other objects, or of specks, at a distance from the shape (n,).
    """

    outliers: Bool[np.ndarray, " n"]
    planes: tuple[Bool[np.ndarray, " n"], ...]
    objects: Bool[np.ndarray, " n"]

    @property
    def points(self) -> Bool[np.ndarray, " n"]:
        """All of them (n,)."""
        every: np.ndarray = np.any([self.outliers, self.objects, *self.planes], axis=0)
        return every

    def findings(self) -> Iterator[Finding]:
        """What was found, for reports."""
        n, keep = len(self.outliers), "clutter='keep' keeps them"
        for plane in self.planes:
            action = "set apart, a plane in the background: a floor, a table or a wall; clutter='keep' keeps it"
            yield Finding(_PLANE, int(plane.sum()), "repaired", action)
        for rule, found, why in (
            (_OUTLIERS, self.outliers, "they lie off the surface"),
            (_OBJECTS, self.objects, "they lie at a distance from the shape"),
        ):
            if found.any():
                share = f"{100 * found.sum() / n:.2g} % of the points"
                yield Finding(rule, int(found.sum()), "repaired", f"set apart, {share}: {why}; {keep}")


def find_clutter(shape: Shape, settings: ClutterSettings | None = None, *, partial: bool = False) -> Clutter:
    """Tell what does not belong to a shape: its background, other objects, and outliers.

    A plane is background if all else lies on one side of it, and it reaches far beyond. A floor has the object above it
    (+y): the top of a table is none. Of a cloud, a point is an outlier if it lies farther from the surface through its
    neighbours than these do, or more thinly than on any surface; a surface with noise has wider bounds. Other objects
    are components at a distance that are smaller.

    Args:
        shape: a clean mesh or cloud, +y up.
        settings: where the bounds lie.
        partial: it is a part or a view, whose components may lie apart: none is another object.

    Examples:
        >>> import homolog
        >>> from homolog.geometry import find_clutter
        >>> bool(find_clutter(homolog.demo_shapes()[0]).points.any())
        False
    """
    check_kind("shape", shape, Shape)
    settings = given_or_default("settings", settings, ClutterSettings)
    planes = tuple(find_backgrounds(shape, settings))
    left = ~np.any([np.zeros(shape.n_points, dtype=bool), *planes], axis=0)
    outliers = np.zeros(shape.n_points, dtype=bool)
    if shape.faces is None:
        outliers[left] = find_outliers(shape.points[left], settings)
    left &= ~outliers
    objects = np.zeros(shape.n_points, dtype=bool)
    if not partial and left.sum() >= FEWEST_POINTS:
        is_cloud = shape.faces is None
        objects[left] = (
            _objects(_subset(shape, left), settings) if is_cloud else _mesh_objects(shape, left, settings)[left]
        )
    return Clutter(outliers, planes, objects)


def set_apart(repaired: Repaired, settings: ClutterSettings | None = None, *, partial: bool = False) -> Repaired:
    """Leave out of a repaired shape what does not belong to it, and say so in its report.

    Args:
        repaired: a clean shape, +y up, and the way back to the one it was made from.
        settings: as in ``find_clutter``.
        partial: as in ``find_clutter``.

    Returns:
        What is left, with the way back; the very same where everything belongs to the shape.

    Examples:
        >>> import homolog, numpy as np
        >>> from homolog.geometry import set_apart
        >>> body = homolog.demo_shapes()[0].points
        >>> strays = np.random.default_rng(0).uniform(body.min(axis=0), body.max(axis=0), (500, 3))
        >>> scan = homolog.repair(homolog.Shape(np.concatenate([body, strays])))
        >>> apart = set_apart(scan).clean_index == -1
        >>> int(apart[:4918].sum()) < 10, int(apart[4918:].sum()) > 400
        (True, True)
    """
    check_kind("repaired", repaired, Repaired)
    settings = given_or_default("settings", settings, ClutterSettings)
    shape = repaired.shape
    clutter = find_clutter(shape, settings, partial=partial)
    left = ~clutter.points
    if left.all() or left.sum() < max(FEWEST_POINTS, (1 - settings.most_apart) * shape.n_points):
        return repaired
    return restricted(repaired, left, clutter.findings())


def restricted(repaired: Repaired, left: Bool[np.ndarray, " n"], findings: Iterable[Finding]) -> Repaired:
    """A repaired shape with some of its points alone, and the faces between them.

    Args:
        repaired: a clean shape, and the way back to the one it was made from.
        left: which of its points stay (n,).
        findings: what to say of the others.

    Raises:
        ShapeError: if what stays is no shape.
    """
    shape = repaired.shape
    cleaned = repair(_subset(shape, left))
    (numbers,) = np.nonzero(left)
    new_number = np.full(shape.n_points + 1, -1)  # the last one is that of points which were left out before
    new_number[numbers] = cleaned.clean_index
    told = repaired.report.findings
    done = (finding for finding in told if finding.severity == "repaired" or finding.rule == MASKED)
    report = replace(
        check(cleaned.shape),
        n_points=repaired.report.n_points,
        n_faces=repaired.report.n_faces,
        findings=(*done, *findings, *cleaned.report.findings),
    )
    kept = repaired.kept[numbers[cleaned.kept]]
    return Repaired(cleaned.shape, report, kept, new_number[repaired.clean_index])


def _subset(shape: Shape, left: Bool[np.ndarray, " n"]) -> Shape:
    """The shape with some of its points, and the faces between them."""
    if shape.faces is None:
        return replace(shape, points=shape.points[left])
    new_index = np.cumsum(left) - 1
    return replace(shape, points=shape.points[left], faces=new_index[shape.faces[left[shape.faces].all(axis=1)]])


def _mesh_objects(shape: Shape, left: Bool[np.ndarray, " n"], settings: ClutterSettings) -> Bool[np.ndarray, " n"]:
    """Points on components of a mesh that lie apart from the largest, and are smaller."""
    assert shape.faces is not None
    faces = shape.faces[left[shape.faces].all(axis=1)]
    component, areas = mesh_components(shape.points, faces)
    if np.count_nonzero(areas) < 2:
        return np.zeros(shape.n_points, dtype=bool)
    used = np.zeros(shape.n_points, dtype=bool)
    used[faces] = True
    # Vertices of large faces lie far apart: the middles of sides tell how near two components are.
    one, other = half_edges(faces).T
    middles = (shape.points[one] + shape.points[other]) / 2
    positions = np.concatenate([shape.points[used], middles])
    component_of = np.concatenate([component[used], np.repeat(component[faces[:, 0]], 3)])
    # Where all is in small pieces, the largest tells nothing of the shape's size.
    size = max(areas.max(), _LEAST_OF_ALL * areas.sum())
    gap = settings.gap * float(np.sqrt(size))
    apart = _apart(positions, component_of, areas, gap, settings.smaller_object)
    found: np.ndarray = apart[component]
    return found


def _objects(cloud: Shape, settings: ClutterSettings) -> Bool[np.ndarray, " n"]:
    """Points on components of a cloud that lie apart from the largest, and are smaller, or are specks."""
    component, counts = cloud_components(cloud.points)
    if counts.max() < (1 - settings.smaller_object) * len(component):  # gaps mean nothing where density varies so much
        return np.zeros(len(component), dtype=bool)
    gap = settings.gap * float(np.sqrt(cloud_area(cloud.points[component == counts.argmax()])))
    apart = _apart(cloud.points, component, counts, gap, settings.smaller_object)[component]
    found: np.ndarray = apart | ~in_large_components(component, counts)
    return found


def _apart(
    positions: Float[np.ndarray, "q 3"],
    component: Int[np.ndarray, " q"],
    sizes: Float[np.ndarray, " p"],
    gap: float,
    smaller: float,
) -> Bool[np.ndarray, " p"]:
    """Which components are smaller than a share of the largest, and beyond a gap from it and all that hang on it."""
    joined = np.zeros(len(sizes), dtype=bool)
    joined[sizes.argmax()] = True
    newest, some = joined, _thinned(positions, component, _THINNED * gap)
    while newest.any() and not joined.all():
        newest = _reached(positions, component, newest, ~joined, gap, some)
        joined = joined | newest
    apart: np.ndarray = ~joined & (sizes < smaller * sizes.max())
    return apart


def _reached(
    positions: Float[np.ndarray, "q 3"],
    component: Int[np.ndarray, " q"],
    ones: Bool[np.ndarray, " p"],
    others: Bool[np.ndarray, " p"],
    gap: float,
    some: Int[np.ndarray, " s"],
) -> Bool[np.ndarray, " p"]:
    """Which of the other components have a position within the gap of one of these.

    Some of the positions tell it for nearly all components. All are looked at only where some are a little too far.
    """
    found = np.zeros(len(ones), dtype=bool)
    for reach, which in (((1 + 2 * _THINNED) * gap, some), (gap, np.arange(len(positions)))):
        own, rest = which[ones[component[which]]], which[others[component[which]]]
        away = KDTree(positions[own]).query(positions[rest], distance_upper_bound=reach)[0]
        found[component[rest[away <= gap]]] = True
        others = np.bincount(component[rest[away <= reach]], minlength=len(ones)).astype(bool) & ~found
        if not others.any():
            break
    return found


def _thinned(
    positions: Float[np.ndarray, "q 3"], component: Int[np.ndarray, " q"], away: float
) -> Int[np.ndarray, " s"]:
    """Some positions of each component, of which one is not farther than so much from any of its others."""
    side = away / np.sqrt(3)
    voxels = np.floor((positions - positions.min(axis=0)) / side)
    first = first_of_equal_rows(np.column_stack([voxels, component]))
    return np.flatnonzero(first == np.arange(len(first)))
