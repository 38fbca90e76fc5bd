"""How smooth maps between surfaces compare with the point maps that they are made of, where the ground truth is known.

Run from the root of the checkout, with an unpacked dataset of meshes::

    python benchmarks/surface_maps.py FAUST_r --weights weights.safetensors --first 80 --n-pairs 8

Without weights the axiomatic method is used, as for ``src/homolog/demo_data``. Errors are Euclidean distances between a
template point on the target and its mapped position, in hundredths of the square root of the target's area. Both ends
of the truth are vertices, so that no map comes below some half of the distance between these. A triangle is flipped
where its normal turns from the target's surface below it; it is accurate where the template points among its corners
are off by less than 3. Edges' lengths are relative to before, over the median of these ratios.
"""

from __future__ import annotations

import argparse
import time
from itertools import permutations

import numpy as np
from jaxtyping import Float, Int

from homolog.datasets import ShapeFolder
from homolog.datasets.folder import drawn_pairs
from homolog.geometry import OperatorCache, Surface, unit
from homolog.matching import Matcher
from homolog.shapes import Shape
from homolog.transfer import SurfaceProjector, surface_map

_ACCURATE = 3.0
_NAMES = ("mean error", "median", "95th percentile", "% flipped", "% flipped, accurate", "edges, 5 %", "edges, 95 %")


def figures(
    shape: Shape,
    images: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    errors: Float[np.ndarray, " n"],
) -> list[float]:
    """The figures of a map: errors (NaN where the truth is not known), flipped triangles and lengths of edges."""
    assert shape.faces is not None
    faces, known = shape.faces, errors[np.isfinite(errors)]
    below = unit(normals[faces].mean(axis=1))
    flipped = np.einsum("mk,mk->m", Surface(images, faces).face_normals, below) <= 0
    accurate = np.nan_to_num(errors)[faces].max(axis=1) < _ACCURATE
    lengths = [np.linalg.norm(p[faces] - p[faces[:, [1, 2, 0]]], axis=2).ravel() for p in (images, shape.points)]
    low, middle, high = np.percentile(lengths[0] / lengths[1], [5, 50, 95])
    errors_told = [known.mean(), np.median(known), np.percentile(known, 95)]
    return [*errors_told, 100 * flipped.mean(), 100 * flipped[accurate].mean(), low / middle, high / middle]


def compared(
    matcher: Matcher, source: Shape, target: Shape, truth: tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]
) -> tuple[list[float], list[float], float]:
    """The figures of the point map and of the smooth one, and the seconds that the latter took."""
    found = matcher.match(source, target)
    goal = SurfaceProjector(target)
    begin = time.perf_counter()
    smooth = surface_map(source, goal, found)
    seconds = time.perf_counter() - begin
    normals = goal.normals(smooth.surface_points)
    assert goal.surface is not None and normals is not None

    def errors(images: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        away = np.full(source.n_points, np.nan)
        away[truth[0]] = np.linalg.norm(images[truth[0]] - target.points[truth[1]], axis=1)
        return 100 * away / goal.unit

    there = found.source_to_target
    images, of_points = target.points[there], goal.repaired.to_original(goal.surface.vertex_normals, fill=0.0)
    by_points = figures(source, images, of_points[there], errors(images))
    return by_points, figures(source, smooth.positions, normals, errors(smooth.positions)), seconds


def main() -> None:
    """Compare pair by pair."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data")
    parser.add_argument("--weights", help="by default the axiomatic method")
    parser.add_argument("--first", type=int, help="take so many shapes, in the order of their names")
    parser.add_argument("--n-pairs", type=int, default=8)
    given = parser.parse_args()
    folder, operators = ShapeFolder.open(given.data), OperatorCache.default().operators
    matcher = (
        Matcher.from_weights(given.weights, operators=operators) if given.weights else Matcher(operators=operators)
    )
    pairs = drawn_pairs(permutations(folder.names[: given.first], 2), given.n_pairs, seed=0)
    told, all_seconds = list[tuple[list[float], list[float]]](), list[float]()
    for a, b in pairs:
        truth = (folder.template_correspondence(a), folder.template_correspondence(b))
        before, after, seconds = compared(matcher, folder.shape(a), folder.shape(b), truth)
        told.append((before, after))
        all_seconds.append(seconds)
        print(f"{a} {b}: mean error {before[0]:.2f} -> {after[0]:.2f}, flipped {before[3]:.1f} % -> {after[3]:.2f} %")
    before, after = np.mean(told, axis=0)
    for name, *values in zip(_NAMES, before, after, strict=True):
        print(f"{name:24s}{values[0]:8.2f}{values[1]:8.2f}")
    print(f"{'seconds':24s}{'':8s}{np.median(all_seconds):8.2f}")


if __name__ == "__main__":
    main()
