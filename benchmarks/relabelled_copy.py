"""How well a shape is matched to a copy of itself whose points are in another order.

Run from the root of the checkout, with the unpacked dataset::

    python benchmarks/relabelled_copy.py FAUST_r --weights surreal.pth --shapes tr_reg_080 tr_reg_091

Prints for each method the share of points that find themselves, and the mean geodesic error x100 of all.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from homolog.datasets import ShapeFolder
from homolog.evaluation import geodesic_errors
from homolog.matching import Matcher
from homolog.pairs import AsCloud, MatcherSettings
from homolog.shapes import Shape

METHODS: tuple[tuple[str, str, AsCloud | None], ...] = (
    ("functional-map, meshes", "functional-map", None),
    ("nearest-features, meshes", "nearest-features", None),
    ("nearest-features, clouds", "nearest-features", "both"),
)


def main() -> None:
    """Match every shape by every method."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--weights", required=True)
    parser.add_argument("--shapes", nargs="+", required=True)
    given = parser.parse_args()
    folder = ShapeFolder.open(given.data)
    for described, method, as_cloud in METHODS:
        matcher = Matcher.from_weights(given.weights, settings=MatcherSettings(method=method))
        for name in given.shapes:
            shape = folder.shape(name)
            order = np.random.default_rng(0).permutation(shape.n_points)
            copy = Shape(shape.points[order], np.argsort(order)[shape.faces], name=name)
            found = order[matcher.match(shape, copy, as_cloud=as_cloud).source_to_target]
            own = np.arange(shape.n_points)
            error = 100 * geodesic_errors(shape, own, found).mean()
            print(f"{described:<26}{name:<14}itself {100 * (found == own).mean():6.2f} %   error {error:.3f}")


if __name__ == "__main__":
    main()
