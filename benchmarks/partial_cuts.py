"""How well points without a counterpart are found on SHREC'16 cuts, with the true map and with a network's own.

Run from the root of the checkout, with the unpacked set::

    python benchmarks/partial_cuts.py SHREC16 --weights surreal.pth --every 8

Truth: a point of the complete shape has a counterpart if the true position of some partial point lies within one mean
edge of it. F1 is that of "has no counterpart", pooled over all points of all pairs.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from homolog.geometry import OperatorCache
from homolog.maps import covered
from homolog.matching import Matcher
from homolog.shapes import Shape, read_shape


def true_positions(complete: Shape, ground_truth: Path) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
    """Where each partial point lies on the complete shape, and the nearest corner of the triangle there."""
    rows = np.loadtxt(ground_truth)
    assert complete.faces is not None
    corners, weights = complete.faces[rows[:, 0].astype(int) - 1], rows[:, 1:]
    positions = np.einsum("ij,ijk->ik", weights, complete.points[corners])
    return positions, np.take_along_axis(corners, weights.argmax(axis=1)[:, None], axis=1)[:, 0]


def has_counterpart(complete: Shape, positions: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " m"]:
    """Which complete points have a true position within one mean edge."""
    assert complete.faces is not None
    corners = complete.points[complete.faces]
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean()
    distances, _ = KDTree(positions).query(complete.points)
    near: np.ndarray = distances <= edge
    return near


class Score:
    """Precision, recall and F1 of points found to have no counterpart."""

    def __init__(self) -> None:
        self.counts = np.zeros(3)

    def add(self, found: Bool[np.ndarray, " m"], truth: Bool[np.ndarray, " m"]) -> None:
        """Count found, true, and rightly found points without a counterpart."""
        self.counts += [(~found).sum(), (~truth).sum(), (~found & ~truth).sum()]

    def __str__(self) -> str:
        found, true, both = self.counts
        return f"precision {both / found:.3f}, recall {both / true:.3f}, F1 {2 * both / (found + true):.3f}"


def main() -> None:
    """Score the cuts."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--weights", type=Path)
    parser.add_argument("--kind", default="cuts", choices=("cuts", "holes"))
    parser.add_argument("--every", type=int, default=8, help="take every so many-th shape")
    arguments = parser.parse_args()
    operators = OperatorCache.default().operators
    matcher = Matcher.from_weights(arguments.weights, operators=operators) if arguments.weights else Matcher()
    scores = {"true map": Score(), "own map, mesh": Score(), "own map, cloud": Score()}
    for file in sorted((arguments.data / arguments.kind).glob("*.off"))[:: arguments.every]:
        complete = read_shape(arguments.data / "null" / f"{file.stem.split('_')[1]}.off")
        positions, nearest = true_positions(complete, file.with_suffix(".baryc_gt"))
        truth = has_counterpart(complete, positions)
        whole = matcher.operators(complete)
        part = matcher.operators(read_shape(file), length=whole.length)
        scores["true map"].add(covered(whole, part, torch.from_numpy(nearest)).numpy(), truth)
        found = matcher.match(complete, read_shape(file), partial="target")
        scores["own map, mesh"].add(found.source_to_target >= 0, truth)
        found = matcher.match(complete, read_shape(file), partial="target", as_cloud="both")
        scores["own map, cloud"].add(found.source_to_target >= 0, truth)
        print(file.stem, {name: str(score) for name, score in scores.items()}, flush=True)
    for name, score in scores.items():
        print(f"{name}: {score}")


if __name__ == "__main__":
    main()
