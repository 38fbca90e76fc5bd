"""Whether a map exchanges left and right, or turns a shape over: head for tail, front for back. New here."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from homolog.core.errors import DataError, HomologError
from homolog.datasets import GroundTruth, Pair, ShapeFolder, class_of, read_vertices
from homolog.shapes import Shape
from homolog.statistics import MirrorPlane, generalised_procrustes, mirror_normal

Exchange = Literal["none", "left-right", "turned over"]
"""What a map exchanges."""

# Points that lie nearer to their partner, in units of sqrt(area), tell nothing: both places are about the same.
_FAR = 0.1
# The mean shape is of so many shapes at most.
_SHAPES = 20
# Fewer template points outline no shape.
_FEWEST_POINTS = 10
_ROUNDS = 30
# Rounds end once the normal turns by less (the sine).
_STEADY = 1e-6


@dataclass(frozen=True, eq=False)
class Partners:
    """For each template point the one that it is exchanged with; -1 where that is not known.

    Args:
        left_right: its partner across the mirror plane (k,).
        turned_over: its partners along the longer and the shorter principal axis within that plane (2, k).
    """

    left_right: Int[np.ndarray, " k"]
    turned_over: Int[np.ndarray, "2 k"]


def mirror_plane(points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " 3"]:
    """The unit normal (3,) of the best mirror plane through the centre of points.

    Iterated closest points with reflections, from each principal axis; the plane with the least mean distance between
    the points and their mirror images is taken.

    Args:
        points: of a shape, about evenly spread (k, 3).

    Examples:
        >>> box = np.random.default_rng(0).uniform(-1, 1, (500, 3)) * [3, 2, 1] + [0, 0, 5]
        >>> mirrored = np.concatenate([box, box * [1, -1, 1]])
        >>> normal = mirror_plane(np.concatenate([mirrored, mirrored[mirrored[:, 0] > 1] + [2, 0, 1]]))
        >>> np.abs(normal).round(3).tolist()
        [0.0, 1.0, 0.0]
    """
    centred = points - points.mean(axis=0)
    tree = KDTree(centred)
    found = [_refined_plane(centred, tree, axis) for axis in np.linalg.svd(centred, full_matrices=False)[2]]
    return min(found, key=lambda plane: plane[1])[0]


def _refined_plane(
    centred: Float[np.ndarray, "k 3"], tree: KDTree, normal: Float[np.ndarray, " 3"]
) -> tuple[Float[np.ndarray, " 3"], float]:
    """A plane's normal after closest points were iterated, and the mean distance of points from the mirror image."""
    for _ in range(_ROUNDS):
        distances, nearest = tree.query(MirrorPlane(normal).reflected(centred))
        before, normal = normal, mirror_normal(centred, centred[nearest])
        if np.linalg.norm(np.cross(before, normal)) < _STEADY:
            break
    return normal, float(distances.mean())


def partners(points: Float[np.ndarray, "k 3"], left_right: Int[np.ndarray, " k"] | None = None) -> Partners:
    """The points that lie nearest to the mirror images of points, across the mirror plane and along its axes.

    Args:
        points: of the mean shape; rows of NaN have no partners (k, 3).
        left_right: the partner of each point across the plane, where that is known; -1 for none (k,).

    Examples:
        >>> cross = np.array([[3.0, 0, 0], [-3, 0, 0], [0, 2, 0], [0, -2, 0], [0, 0, 1], [0, 0, -1], [0, 0, 0]])
        >>> partners(cross, np.array([0, 1, 2, 3, 5, 4, 6])).turned_over.tolist()
        [[1, 0, 2, 3, 4, 5, 6], [0, 1, 3, 2, 4, 5, 6]]
    """
    known = np.flatnonzero(np.isfinite(points).all(axis=1))
    centred = points[known] - points[known].mean(axis=0)
    if left_right is None:
        normal = mirror_plane(centred)
        left_right = _among(known, _nearest_mirrored(centred, normal), len(points))
    else:
        normal = _normal_of(points, left_right)
    over = [_among(known, _nearest_mirrored(centred, axis), len(points)) for axis in _axes_within(centred, normal)]
    return Partners(left_right, np.stack(over))


def _normal_of(points: Float[np.ndarray, "k 3"], left_right: Int[np.ndarray, " k"]) -> Float[np.ndarray, " 3"]:
    """The direction that points and their known partners differ in."""
    away = points - points[left_right]
    away = away[(left_right >= 0) & np.isfinite(away).all(axis=1)]
    return np.asarray(np.linalg.eigh(away.T @ away)[1][:, -1])


def _axes_within(centred: Float[np.ndarray, "k 3"], normal: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "2 3"]:
    """The principal axes within a plane, the longer one first."""
    within = centred - np.outer(centred @ normal, normal)
    return np.asarray(np.linalg.eigh(within.T @ within)[1][:, :0:-1].T)


def _nearest_mirrored(centred: Float[np.ndarray, "k 3"], axis: Float[np.ndarray, " 3"]) -> Int[np.ndarray, " k"]:
    return np.asarray(KDTree(centred).query(MirrorPlane(axis).reflected(centred))[1])


def _among(known: Int[np.ndarray, " m"], found: Int[np.ndarray, " m"], count: int) -> Int[np.ndarray, " k"]:
    """Indices among the known points as those among all of them."""
    indices = np.full(count, -1)
    indices[known] = known[found]
    return indices


def exchange_of(
    own: Float[np.ndarray, "p 3"],
    mapped: Float[np.ndarray, "p 3"],
    left_right: Float[np.ndarray, "p 3"],
    turned_over: Float[np.ndarray, "2 p 3"],
    *,
    scale: float = 1.0,
) -> Exchange:
    """What a map exchanges: where more than half of its points lie nearer to their partner's place than to their own.

    Points count that are farther than 0.1 from their partner, in units of sqrt(area). Where that holds in several ways,
    it is the one whose partners lie nearest to where points are mapped. Distances are straight.

    Args:
        own: the true places of points on the source (p, 3).
        mapped: where the map takes them (p, 3).
        left_right: the places of their partners across the mirror plane; NaN where there is none (p, 3).
        turned_over: of their partners along the two axes of the plane, likewise (2, p, 3).
        scale: sqrt(area) of the source.

    Examples:
        >>> own = np.array([[1.0, 1, 0], [-1, 1, 0], [1, -2, 0], [-1, -2, 0]])
        >>> over = np.stack([own * [1, -1, 1], own])
        >>> [exchange_of(own, own * signs, own * [-1, 1, 1], over) for signs in ([1, 1, 1], [-1, 1, 1], [1, -1, 1])]
        ['none', 'left-right', 'turned over']
    """
    ways: list[tuple[Exchange, Float[np.ndarray, "p 3"]]] = [("left-right", left_right)]
    ways += [("turned over", places) for places in turned_over]
    found = list[tuple[float, Exchange]]()
    for way, places in ways:
        away, far = _apart(mapped, places), _apart(own, places) > _FAR * scale  # not so where a place is NaN
        if far.any() and np.mean(away[far] < _apart(mapped, own)[far]) > 0.5:
            found.append((float(np.nanmean(away)), way))
    return min(found, key=lambda one: one[0])[1] if found else "none"


def _apart(points: Float[np.ndarray, "p 3"], others: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, " p"]:
    return np.asarray(np.linalg.norm(points - others, axis=1))


class ExchangeFinder:
    """Tells what maps between a folder's shapes exchange, by its template correspondence.

    The partner of each template point is found once for all shapes of a class. It is read where a shape of the class
    has a file ``NAME.sym.vts`` beside its template correspondence, with the vertex at each template point's partner.
    Otherwise it is the nearest point of the mirrored mean shape: of up to 20 shapes, by generalised Procrustes.

    Args:
        folder: the dataset.
        ground_truth: of its pairs.
        shape_of: gives a shape by its name.

    Examples:
        >>> from homolog.datasets import demo_folder
        >>> folder = demo_folder()
        >>> finder = ExchangeFinder(folder, folder.ground_truth(), folder.shape)
        >>> finder.exchange(("amber", "boris"), folder.template_correspondence("amber"), scale=1.4)
        'none'
    """

    def __init__(self, folder: ShapeFolder, ground_truth: GroundTruth, shape_of: Callable[[str], Shape]) -> None:
        self._folder, self._truth, self._shape_of = folder, ground_truth, shape_of
        self._found: dict[tuple[str, int], Partners | None] = {}

    def exchange(self, pair: Pair, mapped: Int[np.ndarray, " p"], *, scale: float) -> Exchange | None:
        """What a map exchanges; None where the shapes have too few template points to tell.

        Args:
            pair: names of source and target.
            mapped: the source's point at each template point that both have; -1 for none (p,).
            scale: sqrt(area) of the source.

        Raises:
            DataError: if a file of partners does not fit its shape.
        """
        ours, theirs = (self._truth.template_vertices(name) for name in pair)
        found = self._partners(pair[0], len(ours))
        if found is None:
            return None
        places = _places(self._shape_of(pair[0]), ours)
        known, matched = np.flatnonzero((ours >= 0) & (theirs >= 0)), mapped >= 0
        points, reached = known[matched], self._shape_of(pair[0]).points[mapped[matched]]
        left_right, *over = (_at(places, each[points]) for each in (found.left_right, *found.turned_over))
        return exchange_of(places[points], reached, left_right, np.stack(over), scale=scale)

    def _partners(self, name: str, count: int) -> Partners | None:
        """The partners of the template points of a shape's class, of which it has so many."""
        key = (class_of(name) if self._folder.description.pairs == "same-class" else "", count)
        if key not in self._found:
            alike = [each for each in self._folder.names if not key[0] or class_of(each) == key[0]]
            found = (self._template_points(each, count) for each in alike[:: -(-len(alike) // _SHAPES)])
            mean = mean_shape([places for places in found if places is not None])
            self._found[key] = None if mean is None else partners(mean, self._read_partners(alike, count))
        return self._found[key]

    def _template_points(self, name: str, count: int) -> Float[np.ndarray, "k 3"] | None:
        """A shape's template points; None if they are not so many, or the shape, which may be in no pair, is faulty."""
        try:
            vertices = self._truth.template_vertices(name)
            return _places(self._shape_of(name), vertices) if len(vertices) == count else None
        except HomologError:
            return None

    def _read_partners(self, names: Iterable[str], count: int) -> Int[np.ndarray, " k"] | None:
        """The partners that the first shape with a file of them, and so many template points, tells."""
        for name in names:
            file = self._folder.partners_file(name)
            if file.is_file() and (points := self._template_points(name, count)) is not None:
                return _template_partners(file, points, self._shape_of(name))
        return None


def mean_shape(shapes: Iterable[Float[np.ndarray, "k 3"]]) -> Float[np.ndarray, "k 3"] | None:
    """The mean of shapes in correspondence, turned and scaled onto each other (k, 3); NaN where any lacks the point.

    None if there are no shapes, or fewer than ten points that all of them have.

    Args:
        shapes: points of each, NaN where it lacks one (k, 3).

    Examples:
        >>> one = np.random.default_rng(0).normal(size=(20, 3))
        >>> mean = mean_shape([one, 2 * one[:, [1, 2, 0]] + 7])
        >>> bool(np.allclose(mean, 1.5 * (one - one.mean(axis=0)), atol=0.2 * np.abs(one).max()))
        True
    """
    points = np.stack(list(shapes) or [np.empty((0, 3))])
    known = np.isfinite(points).all(axis=(0, 2))
    if min(len(np.unique(each, axis=0)) for each in points[:, known]) < _FEWEST_POINTS:
        return None
    mean = np.full(points.shape[1:], np.nan)
    mean[known] = generalised_procrustes(points[:, known], scale=True).mean
    return mean


def _template_partners(file: Path, points: Float[np.ndarray, "k 3"], shape: Shape) -> Int[np.ndarray, " k"]:
    """The template points nearest to the vertices that a file names as their partners; -1 for none."""
    vertices, known = read_vertices(file), np.isfinite(points).all(axis=1)
    if len(vertices) != len(points) or vertices.max() >= shape.n_points:
        raise DataError(
            f"{file} has {len(vertices)} lines up to {vertices.max() + 1}, but must have {len(points)} "
            f"up to {shape.n_points}, the vertex at the partner of each template point"
        )
    nearest = KDTree(points[known]).query(shape.points[vertices])[1]
    return np.where(vertices < 0, -1, np.flatnonzero(known)[nearest])


def _places(shape: Shape, vertices: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k 3"]:
    return _at(shape.points, vertices)


def _at(places: Float[np.ndarray, "n 3"], indices: Int[np.ndarray, " p"]) -> Float[np.ndarray, "p 3"]:
    """The places at indices (p, 3); NaN at -1."""
    return np.where(indices[:, None] < 0, np.nan, places[indices])
