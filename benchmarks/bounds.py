"""What bounds the errors on a dataset of people: its ground truth, its edges, and which parts of the body they lie on.

Run from the root of the checkout, with the unpacked dataset::

    python benchmarks/bounds.py FAUST_r --dataset faust_r --n-pairs 8

All figures are x100, in units of sqrt(area), over pairs of different test shapes.

- "ground truth": the error of the best map to vertices there is. Several template points have one vertex of the target,
  but vertices of their own on the source, of which a map can take one only. Geodesic.
- "half an edge": the distance from points anywhere on the source to the nearest vertex, Euclidean: what rounding to
  vertices costs a map that is right.
- "map": the geodesic error of the map, and of its parts. Hands, feet and head are what lies within so far of their tips
  on the first shape of the dataset, along edges; the first shape must stand upright with its arms away from the body.
- "to vertices", "to places": Euclidean errors of the map, and of the smooth map that is made of it, which leads to
  places on triangles.
"""

from __future__ import annotations

import argparse

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from homolog.datasets import ShapeFolder, Truth, drawn_pairs
from homolog.evaluation.metrics import geodesic_errors
from homolog.geometry import OperatorCache, Surface, surface_area
from homolog.geometry.geodesics import edge_graph, pair_distances
from homolog.geometry.surface import BarycentricPoints
from homolog.matching import Matcher
from homolog.shapes import Shape, face_areas, repair
from homolog.transfer import SurfaceProjector, surface_map

_PARTS = ("hands", "feet", "head", "the rest")
_REACH = {"hands": 0.14, "feet": 0.16, "head": 0.2}
_SAMPLES = 20_000
_FIGURES = ("ground truth", "half an edge", "map", "to vertices", "to places")


def parts_of_template(folder: ShapeFolder) -> Int[np.ndarray, " p"]:
    """For each template point the number of the part of the body in ``_PARTS``."""
    name = folder.names[0]
    shape = repair(folder.shape(name))
    assert shape.shape.faces is not None
    points = shape.shape.points / np.sqrt(surface_area(shape.shape))
    graph = edge_graph(points, shape.shape.faces)
    tips = [int(np.linalg.norm(points - points.mean(axis=0), axis=1).argmin())]
    nearest = np.full(len(points), np.inf)
    while len(tips) < 6:  # the first is no tip: the others are each the farthest from those before
        away = pair_distances(graph, np.full(len(points), tips[-1]), np.arange(len(points)))
        nearest = away if len(tips) == 1 else np.minimum(nearest, away)
        tips.append(int(nearest.argmax()))
    tips = sorted(tips[1:], key=lambda tip: points[tip, 1])
    feet, others = tips[:2], sorted(tips[2:], key=lambda tip: abs(points[tip, 0] - np.median(points[:, 0])))
    label = np.full(len(points), _PARTS.index("the rest"))
    for part, ends in (("head", others[:1]), ("hands", others[1:]), ("feet", feet)):
        for tip in ends:
            label[pair_distances(graph, np.full(len(points), tip), np.arange(len(points))) < _REACH[part]] = (
                _PARTS.index(part)
            )
    return np.asarray(label[shape.clean_index[folder.template_correspondence(name)]])


def floor_of_truth(source: Shape, truth: Truth) -> float:
    """The mean geodesic error of the map that gives each target vertex the best of its true source vertices."""
    order = np.argsort(truth.target, kind="stable")
    group = np.cumsum(np.diff(truth.target[order], prepend=-1) > 0) - 1
    sizes = np.bincount(group)
    starts = np.cumsum(sizes) - sizes
    members = [np.arange(start, start + size) for start, size in zip(starts, sizes, strict=True)]
    one = np.concatenate([np.repeat(each, len(each)) for each in members])
    other = np.concatenate([np.tile(each, len(each)) for each in members])
    away = geodesic_errors(source, truth.source[order][other], truth.source[order][one])
    costs = np.bincount(one, away, len(order))  # of giving the whole group each member's vertex
    return float(np.minimum.reduceat(costs, starts).sum() / len(order))


def half_an_edge(shape: Shape, generator: np.random.Generator) -> float:
    """The mean distance of a point of the surface to the nearest vertex."""
    assert shape.faces is not None
    areas = face_areas(shape.points, shape.faces)
    chosen = generator.choice(len(areas), _SAMPLES, p=areas / areas.sum())
    places = BarycentricPoints(chosen, generator.dirichlet(np.ones(3), _SAMPLES))
    away, _ = KDTree(shape.points).query(places.positions(Surface(shape.points, shape.faces)))
    return float(away.mean() / np.sqrt(areas.sum()))


def main() -> None:
    """Print the means over the pairs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data")
    parser.add_argument("--dataset", default="faust_r")
    parser.add_argument("--weights", default="people")
    parser.add_argument("--n-pairs", type=int, default=8)
    given = parser.parse_args()
    folder, generator = ShapeFolder.open(given.data, given.dataset), np.random.default_rng(0)
    truths, part = folder.ground_truth(), parts_of_template(folder)
    matcher = Matcher.from_weights(given.weights, operators=OperatorCache.default().operators)
    figures, errors = list[list[float]](), list[Float[np.ndarray, " p"]]()
    for a, b in drawn_pairs(folder.pairs("test"), given.n_pairs, seed=0):
        source, target, truth = folder.shape(a), folder.shape(b), truths.between(a, b)
        found = matcher.match(source, target)
        mapped = found.target_to_source[truth.target]
        smooth = surface_map(target, SurfaceProjector(source), found.inverse())
        wanted, unit = source.points[truth.source], np.sqrt(surface_area(repair(source).shape))
        both = source.points[mapped], smooth.positions[truth.target]
        to_vertices, to_places = (np.linalg.norm(places - wanted, axis=1).mean() / unit for places in both)
        errors.append(geodesic_errors(source, truth.source, mapped))
        bounds = floor_of_truth(source, truth), half_an_edge(source, generator)
        figures.append([100 * figure for figure in (*bounds, errors[-1].mean(), to_vertices, to_places)])
        print(f"{a} {b}: " + " ".join(f"{figure:.2f}" for figure in figures[-1]), flush=True)
    for name, figure in zip(_FIGURES, np.mean(figures, axis=0), strict=True):
        print(f"{name:14s}{figure:6.2f}")
    every, part = np.concatenate(errors), np.tile(part, len(errors))
    for number, name in enumerate(_PARTS):
        own = part == number
        shares = f"{own.mean():.0%} of the points, {every[own].sum() / every.sum():.0%} of the error"
        print(f"{name:14s}{100 * every[own].mean():6.2f}, {shares}")


if __name__ == "__main__":
    main()
