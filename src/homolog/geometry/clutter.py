"""What does not belong to a shape: outliers, background planes, and other objects. New here."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import ConvexHull, KDTree, QhullError

from homolog.core.arguments import check_kind
from homolog.geometry.components import cloud_components, in_large_components
from homolog.geometry.scale import cloud_area
from homolog.geometry.tangent import normals_of
from homolog.shapes import (
    FEWEST_POINTS,
    Finding,
    Repaired,
    Shape,
    check,
    components,
    face_areas,
    mesh_components,
    repair,
)

# Neighbours whose distance tells how dense a cloud is, to whom a plane is fitted, and among whom the densest is found.
_DENSITY, _FITTED, _AROUND = 8, 16, 30
# Share of the variance around a point that lies across its plane: more is no thin surface.
_THICK = 0.06
# Lengths are those of a point's neighbourhoods. Clean surfaces, also with noise, hold no points beyond the first row.
# They hold some beyond the others, though fewer than the share: those count only where more points are beyond them.
_CLEAR_RESIDUAL, _CLEAR_SPARSE, _EVER_SPARSE = 4.0, 4.0, 8.0
_SUSPICIOUS_SHARE = 0.006
_RESIDUAL, _RESIDUAL_NOISY, _RESIDUAL_ONCE_SURE = 0.3, 0.8, 0.1
_SPARSE, _SPARSE_NOISY, _SPARSE_ALONE = 2.0, 3.0, 3.5
_SPARSER_THAN_NEAR = 2.0
_ROUNDS = 10

# Noise of a surface is told by planes that half of a neighbourhood lies close to, so that outliers count for nothing:
# of how many points, through how many random triples of neighbours, and the least such distance that means noise.
_PLANE_SAMPLES, _TRIPLES, _LEAST_NOISE = 2000, 24, 0.05

# Clusters: neighbours hang together up to this distance. Where more than a few points hang on none of the large pieces,
# surfaces are grown from their thin parts alone: by so many steps, of such a length, to points so near to their planes.
_LINK, _LEAST_CLUSTERED, _THIN = 1.3, 0.004, 0.12
_GROWTH, _STEP, _NEAR_PLANE, _PLANE_THICKNESS = 5, 1.5, 0.8, 1.5

# Planes: how many positions of the surface are looked at, from how many of them planes start, how many are looked for.
_SAMPLES, _STARTS, _MOST_PLANES = 5000, 200, 6
# Half the thickness of a plane at first, and at most and least, as shares of the diagonal of the bounding box.
_BAND, _WIDEST_BAND, _NARROWEST_BAND = 0.005, 0.02, 0.0005
# Beside a plane, within as much again, are fewer points than this share of its own: a curved surface has as many there.
_MOST_BESIDE = 0.25
# A background holds at least this share of the positions, and lies beside all but few of the object's.
_LEAST_PLANE, _MOST_BEHIND = 0.15, 0.02
_FEWEST_OF_OBJECT = 100
# It is so many times as large as the object's shadow on it: a floor below, and planes in any other direction.
_FLOOR_BEYOND, _WALL_BEYOND = 1.5, 2.5
_UPRIGHT = 0.87

# Other objects: this far away, in units of sqrt(area), and of less than this share of the shape's size.
_APART, _SMALLER_OBJECT = 0.1, 1 / 3
# The shape has at least this share of the area of all components.
_LEAST_OF_ALL = 0.25
# Where more would be set apart than this share, it is not told what the object is.
_MOST_APART = 0.9


_PLANE, _OUTLIERS, _OBJECTS = "points of a plane", "outliers", "points of other objects"
CLUTTER_RULES = (_PLANE, _OUTLIERS, _OBJECTS)
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


def find_clutter(shape: Shape, *, partial: bool = False) -> Clutter:
    """Tell what does not belong to a shape: its background, other objects, and outliers.

    A plane is background if all else lies on one side of it, and it reaches far beyond. A floor has the object above it
    (+y): the top of a table is none. Of a cloud, a point is an outlier if it lies farther from the surface through its
    neighbours than these do, or more thinly than on any surface; a surface with noise has wider bounds. Other objects
    are components at a distance that are smaller.

    Args:
        shape: a clean mesh or cloud, +y up.
        partial: it is a part or a view, whose components may lie apart: none is another object.

    Examples:
        >>> import homolog
        >>> from homolog.geometry import find_clutter
        >>> bool(find_clutter(homolog.demo_shapes()[0]).points.any())
        False
    """
    check_kind("shape", shape, Shape)
    planes = tuple(_backgrounds(shape))
    left = ~np.any([np.zeros(shape.n_points, dtype=bool), *planes], axis=0)
    outliers = np.zeros(shape.n_points, dtype=bool)
    if shape.faces is None:
        outliers[left] = find_outliers(shape.points[left])
        if not partial:  # a view may show a limb in pieces
            surface = left & ~outliers
            outliers[surface] = _clustered(shape.points[surface])
    left &= ~outliers
    objects = np.zeros(shape.n_points, dtype=bool)
    if not partial and left.sum() >= FEWEST_POINTS:
        objects[left] = _objects(_subset(shape, left)) if shape.faces is None else _mesh_objects(shape, left)[left]
    return Clutter(outliers, planes, objects)


def set_apart(repaired: Repaired, *, partial: bool = False) -> Repaired:
    """Leave out of a repaired shape what does not belong to it, and say so in its report.

    Args:
        repaired: a clean shape, +y up, and the way back to the one it was made from.
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
    shape = repaired.shape
    clutter = find_clutter(shape, partial=partial)
    left = ~clutter.points
    if left.all() or left.sum() < max(FEWEST_POINTS, (1 - _MOST_APART) * shape.n_points):
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


def find_outliers(points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Which points of a cloud lie off the surface that the others sample.

    Points are taken away in rounds: what hides among other outliers is seen once these are gone. Single points that are
    a little off, as surfaces have, are none; once more than a few are, the others like them are outliers as well.

    Args:
        points: positions (n, 3).

    Returns:
        True for each outlier (n,).
    """
    left, is_sure, noisy = np.arange(len(points)), False, _is_noisy(points)
    for _ in range(_ROUNDS):
        if len(left) <= 2 * _AROUND:
            break
        around = _Neighbourhoods.of(points[left])
        clear = around.clear()
        is_sure = is_sure or bool((clear | around.suspicious(_RESIDUAL, noisy=noisy)).mean() > _SUSPICIOUS_SHARE)
        out = clear | around.suspicious(_RESIDUAL_ONCE_SURE, noisy=noisy) if is_sure else clear
        if not out.any():
            break
        left = left[~out]
    outliers = np.ones(len(points), dtype=bool)
    outliers[left] = False
    return outliers


def _is_noisy(points: Float[np.ndarray, "n 3"]) -> bool:
    """Whether a cloud's surface itself has noise: of 0.003 sqrt(area) or more at 5,000 points, whatever its outliers.

    Planes are fitted by the least median of distances (Rousseeuw, "Least median of squares regression", 1984).
    """
    if len(points) <= _FITTED:
        return False
    random = np.random.default_rng(0)
    some = random.permutation(len(points))[:_PLANE_SAMPLES]
    distances, indices = KDTree(points).query(points[some], k=_FITTED + 1, workers=-1)
    near = points[indices]
    least = np.full(len(some), np.inf)
    for _ in range(_TRIPLES):
        a, b, c = near[:, random.choice(_FITTED + 1, 3, replace=False)].transpose(1, 0, 2)
        normals = np.cross(b - a, c - a)
        heights = np.abs(np.einsum("sjc,sc->sj", near - a[:, None], normals))
        heights /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
        least = np.minimum(least, np.median(heights, axis=1))
    widths = np.maximum(distances[:, _DENSITY], np.finfo(float).tiny)
    return bool(np.quantile(least / widths, 0.1) > _LEAST_NOISE)


def _clustered(points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Which points of a cloud are in small clusters, and on no surface of more than a few points (n,)."""
    none = np.zeros(len(points), dtype=bool)
    if len(points) <= 2 * _AROUND:
        return none
    distances, indices = KDTree(points).query(points, k=_FITTED + 1, workers=-1)
    width = distances[:, _DENSITY]
    width = np.maximum(np.median(width[indices], axis=1), np.median(width))
    linked = distances[:, 1:] <= _LINK * width[:, None]
    if 1 - _in_large_pieces(indices, linked).mean() <= _LEAST_CLUSTERED:
        return none
    thin = _Neighbourhoods.of(points).thickness < _THIN
    surface = thin & _in_large_pieces(indices, linked & thin[:, None] & thin[indices[:, 1:]])
    for _ in range(_GROWTH):
        (rest,) = np.nonzero(~surface)
        own = points[surface]
        if len(own) < _DENSITY or not len(rest):
            break
        away, near = KDTree(own).query(points[rest], k=_DENSITY, workers=-1)
        plane = _FittedPlanes.of(own[near], np.exp(-((away / width[rest, None]) ** 2)) + 1e-9)
        off = plane.distances(points[rest]) - _PLANE_THICKNESS * plane.thickness
        surface[rest[(away[:, 0] <= _STEP * width[rest]) & (off < _NEAR_PLANE * width[rest])]] = True
    clustered: np.ndarray = ~surface
    return clustered


def _in_large_pieces(indices: Int[np.ndarray, "n j"], linked: Bool[np.ndarray, "n i"]) -> Bool[np.ndarray, " n"]:
    """Which points are in large pieces, where some neighbours are linked; each comes first among its own (n,)."""
    rows, columns = np.nonzero(linked)
    component = components(rows, indices[:, 1:][rows, columns], len(indices))
    return in_large_components(component, np.bincount(component))


@dataclass(frozen=True, eq=False)
class _FittedPlanes:
    """The plane through each of many sets of points.

    Args:
        middles: a point of each (n, 3).
        normals: of unit length (n, 3).
        variances: of the points along the axes of each set, the least first, which is across the plane (n, 3).
    """

    middles: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    variances: Float[np.ndarray, "n 3"]

    @classmethod
    def of(cls, points: Float[np.ndarray, "n j 3"], weights: Float[np.ndarray, "n j"]) -> _FittedPlanes:
        """Fit them by least squares, with positive weights."""
        shares = weights / weights.sum(axis=1, keepdims=True)
        middles = np.einsum("nj,njc->nc", shares, points)
        away = points - middles[:, None]
        variances, axes = np.linalg.eigh(np.einsum("nj,nja,njb->nab", shares, away, away))
        return cls(middles, axes[:, :, 0], variances)

    @property
    def thickness(self) -> Float[np.ndarray, " n"]:
        """The standard deviation across each plane (n,)."""
        found: np.ndarray = np.sqrt(np.maximum(self.variances[:, 0], 0))
        return found

    def distances(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """How far each point lies from its plane (n,)."""
        found: np.ndarray = np.abs(np.einsum("nc,nc->n", points - self.middles, self.normals))
        return found


@dataclass(frozen=True, eq=False)
class _Neighbourhoods:
    """How each point of a cloud lies among its neighbours.

    Args:
        sparsity: distance to a near neighbour, in its median over the cloud (n,).
        relative: the same, in the least among the neighbours (n,).
        residual: distance from the plane through the neighbours, in their distance to a near neighbour (n,).
        usual: residual of the neighbours, its upper quartile (n,).
        thickness: share of the neighbours' variance across the plane (n,).
    """

    sparsity: Float[np.ndarray, " n"]
    relative: Float[np.ndarray, " n"]
    residual: Float[np.ndarray, " n"]
    usual: Float[np.ndarray, " n"]
    thickness: Float[np.ndarray, " n"]

    @classmethod
    def of(cls, points: Float[np.ndarray, "n 3"]) -> _Neighbourhoods:
        """Find them; two neighbours may not coincide."""
        distances, indices = KDTree(points).query(points, k=_AROUND + 1, workers=-1)
        width = distances[:, _DENSITY]
        densest = width[indices[:, 1:]].min(axis=1)
        near, distances = indices[:, 1 : _FITTED + 1], distances[:, 1 : _FITTED + 1]
        scale = np.median(width[near], axis=1)
        weights = np.exp(-((distances / scale[:, None]) ** 2)) + 1e-9  # far from all, the nearest still count
        planes = _FittedPlanes.of(points[near], weights)
        residual = planes.distances(points) / scale
        usual = np.quantile(residual[near], 0.75, axis=1)
        thickness = planes.variances[:, 0] / planes.variances.sum(axis=1)
        return cls(width / np.median(width), width / densest, residual, usual, thickness)

    def clear(self) -> Bool[np.ndarray, " n"]:
        """What is an outlier however few there are (n,)."""
        sparse = (self.sparsity > _CLEAR_SPARSE) & (self.thickness > _THICK)
        return sparse | (self.sparsity > _EVER_SPARSE) | (self.residual > _CLEAR_RESIDUAL)

    def suspicious(self, residual: float, *, noisy: bool) -> Bool[np.ndarray, " n"]:
        """What is an outlier if there are more like it (n,); of a noisy surface only what lies farther off."""
        off = self.residual - 2 * self.usual > (_RESIDUAL_NOISY if noisy else residual)
        sparse = self.sparsity > (_SPARSE_NOISY if noisy else _SPARSE)
        sparse = (sparse & (self.relative > _SPARSER_THAN_NEAR)) | (self.sparsity > _SPARSE_ALONE)
        found: np.ndarray = off | (sparse & (self.thickness > _THICK))
        return found


@dataclass(frozen=True, eq=False)
class _Plane:
    """A plane that many points lie in.

    Args:
        centre: a point of it (3,).
        normal: of unit length (3,).
        band: half its thickness.
    """

    centre: Float[np.ndarray, " 3"]
    normal: Float[np.ndarray, " 3"]
    band: float

    def heights(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Signed distances from the plane (n,)."""
        found: np.ndarray = (points - self.centre) @ self.normal
        return found

    def holds(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Which points lie in it (n,)."""
        held: np.ndarray = np.abs(self.heights(points)) <= self.band
        return held

    def is_sharp(self, points: Float[np.ndarray, "n 3"]) -> bool:
        """Whether points lie in it and not beside it, as they do around a plane through a curved surface."""
        around = replace(self, band=2 * self.band).holds(points).sum()
        return bool(around <= (1 + _MOST_BESIDE) * self.holds(points).sum())

    def shadow(self, points: Float[np.ndarray, "n 3"]) -> float:
        """Area of the convex hull of points on the plane."""
        flat = (points - self.centre) @ np.linalg.svd(self.normal[None])[2][1:].T
        try:
            return float(ConvexHull(flat).volume)  # of two dimensions, the area
        except QhullError:  # all on one line
            return 0.0

    def is_behind(self, rest: Float[np.ndarray, "m 3"], own: Float[np.ndarray, "p 3"]) -> bool:
        """Whether an object lies on one side of the plane, and the plane reaches far beyond its shadow."""
        above = self.heights(rest) > 0
        if min(above.mean(), 1 - above.mean()) > _MOST_BEHIND:
            return False
        rise = self.normal[1] * (1 if above.mean() > 0.5 else -1)
        if rise < -_UPRIGHT:  # the object hangs below, as a table does below its top
            return False
        beyond = _FLOOR_BEYOND if rise > _UPRIGHT else _WALL_BEYOND
        return self.shadow(own) > beyond * self.shadow(rest)


def _backgrounds(shape: Shape) -> Iterator[Bool[np.ndarray, " n"]]:
    """The points of each plane in the background."""
    samples, normals = _samples(shape)
    planes = sorted(_planes(samples, normals), key=lambda plane: -plane.shadow(samples[plane.holds(samples)]))
    for count in range(len(planes), 0, -1):
        behind = planes[:count]
        rest = samples[~np.any([plane.holds(samples) for plane in behind], axis=0)]
        if shape.faces is None and len(rest) > _FEWEST_OF_OBJECT:
            rest = rest[~find_outliers(rest)]
        if len(rest) >= _FEWEST_OF_OBJECT and all(
            plane.is_behind(rest, samples[plane.holds(samples)]) for plane in behind
        ):
            taken = np.zeros(shape.n_points, dtype=bool)
            for plane in behind:
                own = _points_of_plane(shape, plane) & ~taken
                taken |= own
                yield own
            return


def _samples(shape: Shape) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, "t 3"]]:
    """Positions spread evenly over the surface, and normals at the first of them."""
    random = np.random.default_rng(0)
    if shape.faces is None:
        chosen = random.permutation(shape.n_points)[:_SAMPLES]
        starts = shape.points[chosen[:_STARTS]]
        _, near = KDTree(shape.points).query(starts, k=min(_AROUND, shape.n_points))
        away = shape.points[near] - starts[:, None]
        return shape.points[chosen], normals_of(away.transpose(0, 2, 1) @ away)
    areas = face_areas(shape.points, shape.faces)
    corners = shape.points[shape.faces[random.choice(len(areas), _SAMPLES, p=areas / areas.sum())]]
    weights = random.dirichlet(np.ones(3), _SAMPLES)
    normals = np.cross(corners[:_STARTS, 1] - corners[:_STARTS, 0], corners[:_STARTS, 2] - corners[:_STARTS, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.einsum("sk,skc->sc", weights, corners), normals / np.maximum(lengths, np.finfo(float).tiny)


def _planes(samples: Float[np.ndarray, "s 3"], normals: Float[np.ndarray, "t 3"]) -> Iterator[_Plane]:
    """Planes with many samples, each without those of the planes before."""
    size = float(np.linalg.norm(np.ptp(samples, axis=0)))
    starts, left = samples[: len(normals)], samples
    for _ in range(_MOST_PLANES):
        if len(left) < _LEAST_PLANE * len(samples):
            return
        heights = normals @ left.T  # a row for each plane, counted along it: five times as fast as columns
        heights -= np.einsum("tc,tc->t", starts, normals)[:, None]
        best = int(np.argmax(np.count_nonzero(np.abs(heights, out=heights) < _BAND * size, axis=1)))
        plane = _refined(_Plane(starts[best], normals[best], _BAND * size), left, size)
        if plane.holds(left).sum() < _LEAST_PLANE * len(samples):
            return
        if plane.band < _WIDEST_BAND * size and plane.is_sharp(left):
            yield plane
        left = left[~plane.holds(left)]


def _refined(plane: _Plane, samples: Float[np.ndarray, "s 3"], size: float) -> _Plane:
    """The plane through the samples near it, as thick as they scatter."""
    for _ in range(5):
        own = samples[plane.holds(samples)]
        if len(own) < 3:
            break
        centre = own.mean(axis=0)
        normal = np.linalg.eigh((own - centre).T @ (own - centre))[1][:, 0]
        spread = 4.5 * float(np.median(np.abs((own - centre) @ normal)))  # three standard deviations of Gaussian noise
        plane = _Plane(centre, normal, float(np.clip(spread, _NARROWEST_BAND * size, _WIDEST_BAND * size)))
    return plane


def _points_of_plane(shape: Shape, plane: _Plane) -> Bool[np.ndarray, " n"]:
    """The points that lie in a plane, of a mesh with all of their faces."""
    own = plane.holds(shape.points)
    if shape.faces is not None:
        own[shape.faces[~own[shape.faces].all(axis=1)]] = False
    return own


def _mesh_objects(shape: Shape, left: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Points on components of a mesh that lie apart from the largest, and are smaller."""
    assert shape.faces is not None
    faces = shape.faces[left[shape.faces].all(axis=1)]
    component, areas = mesh_components(shape.points, faces)
    if np.count_nonzero(areas) < 2:
        return np.zeros(shape.n_points, dtype=bool)
    corners = shape.points[faces]
    # Vertices of large faces lie far apart: positions within them tell how near two components are.
    positions = np.concatenate([corners, (corners + np.roll(corners, 1, axis=1)) / 2], axis=1).reshape(-1, 3)
    # Where all is in small pieces, the largest tells nothing of the shape's size.
    size = max(areas.max(), _LEAST_OF_ALL * areas.sum())
    apart = _apart(positions, np.repeat(component[faces[:, 0]], 6), areas, _APART * float(np.sqrt(size)))
    found: np.ndarray = apart[component]
    return found


def _objects(cloud: Shape) -> Bool[np.ndarray, " n"]:
    """Points on components of a cloud that lie apart from the largest, and are smaller, or are specks."""
    component, counts = cloud_components(cloud.points)
    if counts.max() < (1 - _SMALLER_OBJECT) * len(component):  # gaps mean nothing where density varies so much
        return np.zeros(len(component), dtype=bool)
    gap = _APART * float(np.sqrt(cloud_area(cloud.points[component == counts.argmax()])))
    apart = _apart(cloud.points, component, counts, gap)[component]
    found: np.ndarray = apart | ~in_large_components(component, counts)
    return found


def _apart(
    positions: Float[np.ndarray, "q 3"], component: Int[np.ndarray, " q"], sizes: Float[np.ndarray, " p"], gap: float
) -> Bool[np.ndarray, " p"]:
    """Which components are smaller than the largest, and farther than a gap from it and from all that hang on it."""
    joined = np.zeros(len(sizes), dtype=bool)
    joined[sizes.argmax()] = True
    newest = joined
    while newest.any():
        tree, others = KDTree(positions[newest[component]]), ~joined[component]
        is_near = tree.query(positions[others], distance_upper_bound=gap)[0] <= gap
        newest = np.zeros(len(sizes), dtype=bool)
        newest[component[others][is_near]] = True
        joined = joined | newest
    apart: np.ndarray = ~joined & (sizes < _SMALLER_OBJECT * sizes.max())
    return apart
