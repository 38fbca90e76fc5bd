"""How smooth the true maps of a dataset of clouds are: what the best map of a kind reaches that is fitted to the truth.

    python benchmarks/smooth_bounds.py LUNGS --dataset lungs --split train

For pairs of clouds the target's points are moved to their counterparts on the source: by the best similarity, the best
affine map, and the best thin-plate spline with so many centres. The first number is how far they then are from their
true positions, the second the error of the nearest point of the source, both Euclidean and in the files' unit. The last
line is how much a row's displacement differs from the mean of its six neighbours': what no smooth map can know.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from homolog.datasets import ShapeFolder, drawn_pairs

_Points = Float[np.ndarray, "n 3"]
_CENTRES = (10, 30, 100, 300)


def main() -> None:
    """Print the means over the pairs."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("data")
    parser.add_argument("--dataset", default="lungs")
    parser.add_argument("--split", choices=("train", "test"), default="train")
    parser.add_argument("--n-pairs", type=int, default=30)
    given = parser.parse_args()
    folder = ShapeFolder.open(given.data, given.dataset)
    truth = folder.ground_truth(folder.shape)
    # Of a shape and itself every map is exact.
    pairs = [pair for pair in drawn_pairs(folder.pairs(given.split), 2 * given.n_pairs, seed=1) if pair[0] != pair[1]]
    found: dict[str, list[tuple[float, float]]] = {}
    rough = []
    for source, target in pairs[: given.n_pairs]:
        known = truth.between(source, target)
        x, y = folder.shape(source).points[known.source], folder.shape(target).points[known.target]
        for way, moved in _moved(x, y):
            found.setdefault(way, []).append((_mean(moved - x), _mean(x[KDTree(x).query(moved)[1]] - x)))
        _, near = KDTree(y).query(y, 7)
        rough.append(_mean((x - y) - (x - y)[near[:, 1:]].mean(axis=1)))
    for way, errors in found.items():
        print(f"{way}: {np.mean(errors, axis=0)[0]:.2f}, nearest points {np.mean(errors, axis=0)[1]:.2f}")
    print(f"a row and its neighbours: {np.mean(rough):.2f}; {len(rough)} pairs")


def _moved(x: _Points, y: _Points) -> Iterator[tuple[str, _Points]]:
    """The points y by each kind of map, fitted to their true positions x."""
    yield "similarity", _similar(x, y)
    affine = np.c_[y, np.ones(len(y))]
    yield "affine", _fitted(affine, x)
    random = np.random.default_rng(0)
    for number in _CENTRES:
        centres = y[random.choice(len(y), number, replace=False)]
        yield f"spline with {number} centres", _fitted(np.c_[affine, cdist(y, centres)], x)


def _fitted(functions: Float[np.ndarray, "n k"], x: _Points) -> _Points:
    moved: _Points = functions @ np.linalg.lstsq(functions, x, rcond=None)[0]
    return moved


def _similar(x: _Points, y: _Points) -> _Points:
    """The best turn, scale and shift of y onto x (Umeyama, "Least-squares estimation", PAMI 1991)."""
    x0, y0 = x - x.mean(axis=0), y - y.mean(axis=0)
    u, stretch, v = np.linalg.svd(y0.T @ x0)
    stretch[-1] *= (sign := np.sign(np.linalg.det(u @ v)))
    turn = u @ np.diag([1, 1, sign]) @ v
    moved: _Points = stretch.sum() / (y0**2).sum() * y0 @ turn + x.mean(axis=0)
    return moved


def _mean(offsets: _Points) -> float:
    return float(np.linalg.norm(offsets, axis=1).mean())


if __name__ == "__main__":
    main()
