"""Checking a shape: what is unusual about it, how often, and what is done about it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from homolog.shapes.cleaning import Cleaning, clean
from homolog.shapes.finding import Finding
from homolog.shapes.shape import FEWEST_POINTS, Modality, Shape
from homolog.shapes.topology import Topology, face_areas, topology

# Beyond these sizes the fourth power of a length, which areas need, leaves the range of double precision.
_USABLE_SIZES = (1e-60, 1e60)
_USUAL_SIZES = (1e-6, 1e6)
# At this distance from the origin, in extents, single precision keeps less than four digits of a position.
_FAR = 1e3
# Below this ratio of a face's area to the square of its longest edge, its angles are noise.
_SLIVER = 1e-10
_LINE = 1e-10
_SPACES = {
    "RAS": "kept in RAS, as the file says: x to the right, y to the front, z up",
    "LPS": "kept in LPS, as the file says: x to the left, y to the back, z up",
}
_PIECES = "kept; those below 1 % of the largest one's area go where the nearest larger one goes"


@dataclass(frozen=True)
class Report:
    """What a shape is and what was found in it.

    Args:
        name: how the shape is called.
        modality: ``"mesh"`` or ``"cloud"``.
        n_points: points given.
        n_faces: faces given.
        n_clean_points: points left after repair.
        n_clean_faces: faces left after repair.
        extent: diagonal of the bounding box of the points left, in the shape's own units.
        area: surface area of the faces left, in the shape's own units squared; None for a cloud.
        n_components: pieces of the mesh left; None for a cloud or an unusable shape.
        n_boundary_loops: holes and rims of the mesh left; None for a cloud or an unusable shape.
        findings: everything unusual, the most serious first.

    Examples:
        >>> import homolog
        >>> report = homolog.check(homolog.demo_shapes()[0])
        >>> report.n_points, report.n_components, report.is_clean
        (4918, 1, True)
    """

    name: str
    modality: Modality
    n_points: int
    n_faces: int
    n_clean_points: int
    n_clean_faces: int
    extent: float
    area: float | None
    n_components: int | None
    n_boundary_loops: int | None
    findings: tuple[Finding, ...]

    @property
    def usable(self) -> bool:
        """Whether ``repair`` gives a shape."""
        return not any(f.severity == "unusable" for f in self.findings)

    @property
    def is_clean(self) -> bool:
        """Whether ``repair`` would change nothing."""
        return all(f.severity == "note" for f in self.findings)

    def to_dict(self) -> dict[str, Any]:
        """The report as numbers, words and lists for JSON; an extent that is not finite becomes None."""
        values = asdict(self)
        values["findings"] = [asdict(finding) for finding in self.findings]
        if not np.isfinite(self.extent):
            values["extent"] = None
        return values | {"usable": self.usable}

    def __repr__(self) -> str:
        size = f"{self.n_points} points, {self.n_faces} faces"
        return f"Report({self.name!r}: {self.modality}, {size}, {len(self.findings)} findings)"

    def __str__(self) -> str:
        faces = f", {self.n_faces} faces" if self.modality == "mesh" else ""
        head = f"{self.name}: {self.modality}, {self.n_points} points{faces}, extent {self.extent:.6g}"
        return "\n".join([head, *(f"  {f.severity}: {f}" for f in self.findings)])


def check(shape: Shape) -> Report:
    """Find, count and explain everything unusual about a shape; the shape is not changed.

    Args:
        shape: a mesh or a point cloud in any state.

    Returns:
        What the shape is, what was found, and what ``repair`` does about it. Never raises for a bad shape.

    Raises:
        ArgumentError: if it is no ``Shape`` at all.

    Examples:
        >>> import homolog
        >>> body, _ = homolog.shapes.demo_shapes()
        >>> report = homolog.check(body)
        >>> report.usable, report.is_clean, report.n_components
        (True, True, 1)
    """
    return report_on(shape, clean(shape))


def report_on(shape: Shape, cleaning: Cleaning) -> Report:
    """Describe a shape whose clean arrays are known."""
    extent = _extent(cleaning.points)
    findings = [*_unusable(cleaning, extent)]
    described = None
    area = None
    if not findings and cleaning.faces is not None:
        described = topology(cleaning.faces, len(cleaning.points))
        areas, slivers = _areas(cleaning.points, cleaning.faces)
        area = float(areas.sum())
        if area == 0:
            action = "every face is a line; use the points alone, as a cloud"
            findings.append(Finding("total area", 0, "unusable", action))
    findings += _repaired(cleaning)
    findings += _scale(cleaning.points, extent)
    if described is not None:
        findings += _surface(described, int(np.sum(slivers)))
    findings += shape.notes
    if shape.space is not None:
        findings.append(Finding("points in anatomical axes", shape.n_points, "note", _SPACES[shape.space]))
    return Report(
        name=shape.name,
        modality=shape.modality,
        n_points=shape.n_points,
        n_faces=shape.n_faces,
        n_clean_points=len(cleaning.points),
        n_clean_faces=0 if cleaning.faces is None else len(cleaning.faces),
        extent=extent,
        area=area,
        n_components=None if described is None else described.n_components,
        n_boundary_loops=None if described is None else described.n_boundary_loops,
        findings=tuple(findings),
    )


def _extent(points: Float[np.ndarray, "n 3"]) -> float:
    if not len(points):
        return 0.0
    with np.errstate(over="ignore"):
        sides = points.max(axis=0) - points.min(axis=0)
    longest = float(sides.max())
    # Scaled, because the squares of very long or short sides leave the range of numbers.
    return longest * float(np.linalg.norm(sides / longest)) if 0 < longest < np.inf else longest


def _unusable(cleaning: Cleaning, extent: float) -> Iterator[Finding]:
    """At most one reason why no repair helps; each one makes the later questions meaningless."""
    n_points, low, high = len(cleaning.points), *_USABLE_SIZES
    if cleaning.faces is not None and not len(cleaning.faces):
        yield Finding("usable faces", 0, "unusable", "no face is left; use the points alone, as a cloud")
    elif n_points < FEWEST_POINTS:
        yield Finding("usable points", n_points, "unusable", f"at least {FEWEST_POINTS} different points are needed")
    elif not low < extent < high or np.abs(cleaning.points).max() > high:
        action = f"the extent {extent:.3g} leaves the range of numbers; give the shape in other units"
        yield Finding("points too close or too far", n_points, "unusable", action)
    elif _on_a_line(cleaning.points, extent):
        yield Finding("points on one line", n_points, "unusable", "a surface is needed; export the shape again")


def _on_a_line(points: Float[np.ndarray, "n 3"], extent: float) -> bool:
    arms = (points - points[0]) / extent
    longest = arms[np.argmax(np.sum(arms**2, axis=1))]
    direction = longest / np.linalg.norm(longest)
    return bool(np.abs(arms - np.outer(arms @ direction, direction)).max() < _LINE)


def _areas(
    points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> tuple[Float[np.ndarray, " m"], np.ndarray]:
    """The area of each face, and whether it is so thin that its angles are noise."""
    a, b, c = points[faces[:, 0]], points[faces[:, 1]], points[faces[:, 2]]
    areas = face_areas(points, faces)
    longest = np.max([np.sum((p - q) ** 2, axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    return areas, areas <= _SLIVER * longest


def _repaired(cleaning: Cleaning) -> Iterator[Finding]:
    counts = {
        ("NaN or infinite points", "left out"): cleaning.n_not_finite,
        ("duplicate points", "merged with the first of them"): cleaning.n_duplicates,
        ("unreferenced points", "left out, no face uses them"): cleaning.n_unreferenced,
        ("faces out of range", "dropped, a corner does not exist"): cleaning.n_out_of_range,
        ("faces at NaN or infinite points", "dropped"): cleaning.n_broken,
        ("faces with a repeated corner", "dropped, they have no area"): cleaning.n_repeated,
        ("folded faces", "dropped, two neighbours that lie on each other"): cleaning.n_folded,
        ("duplicate faces", "dropped, the first stays"): cleaning.n_duplicate_faces,
    }
    for (rule, action), count in counts.items():
        if count:
            yield Finding(rule, count, "repaired", action)


def _scale(points: Float[np.ndarray, "n 3"], extent: float) -> Iterator[Finding]:
    if not 0 < extent < np.inf:
        return
    low, high = _USUAL_SIZES
    centre = (points.max(axis=0) / 2 + points.min(axis=0) / 2) / extent
    action = "kept; centred and scaled in double precision before anything is computed"
    if not low <= extent <= high:
        yield Finding(f"points with an extent of {extent:.3g}", len(points), "note", action)
    if np.abs(centre).max() > _FAR:
        yield Finding("points far from the origin", len(points), "note", action)


def _surface(found: Topology, n_slivers: int) -> Iterator[Finding]:
    if n_slivers:
        yield Finding("zero-area slivers", n_slivers, "note", "kept, dropping them opens holes; lengths are mollified")
    if found.n_nonmanifold_edges:
        yield Finding("non-manifold edges", found.n_nonmanifold_edges, "note", "kept; operators use a tufted cover")
    if found.n_nonmanifold_points:
        yield Finding("non-manifold points", found.n_nonmanifold_points, "note", "kept; operators use a tufted cover")
    if found.n_components > 1:
        yield Finding("components", found.n_components, "note", _PIECES)
    if found.n_boundary_loops:
        yield Finding("boundary loops", found.n_boundary_loops, "note", "kept; holes are not filled")
