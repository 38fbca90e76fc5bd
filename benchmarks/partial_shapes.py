"""How well parts of shapes are matched to their complete ones on SHREC'16, and what has no counterpart is found.

Run from the root of the checkout, with the unpacked set::

    python benchmarks/partial_shapes.py SHREC16 --weights cuts.safetensors --kind cuts --names "*_shape_1?"

Prints for meshes and clouds the mean geodesic error x100 of the parts' points, in units of the square root of the
complete shape's area, and precision, recall and F1 of "has no counterpart", pooled over all points of all pairs.
Truth for these: a point of the complete shape has a counterpart if the true position of some point of the part lies
within one mean edge of it.
"""

from __future__ import annotations

import argparse
from fnmatch import fnmatch
from pathlib import Path
from typing import get_args

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from homolog.evaluation import geodesic_errors
from homolog.geometry import OperatorCache
from homolog.maps import covered
from homolog.matching import AsCloud, Matcher
from homolog.shapes import Shape, Up, read_shape

MODALITIES: dict[str, AsCloud | None] = {"mesh": None, "cloud": "both"}


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
    """Errors of parts' points, and how well complete points without a counterpart are found."""

    def __init__(self) -> None:
        self.counts = np.zeros(3)
        self.errors: list[Float[np.ndarray, " n"]] = []

    def add(self, found: Bool[np.ndarray, " m"], truth: Bool[np.ndarray, " m"]) -> None:
        """Count found, true, and rightly found points without a counterpart."""
        self.counts += [(~found).sum(), (~truth).sum(), (~found & ~truth).sum()]

    def __str__(self) -> str:
        found, true, both = self.counts
        error = f"error {100 * np.concatenate(self.errors).mean():.2f}, " if self.errors else ""
        return f"{error}precision {both / found:.3f}, recall {both / true:.3f}, F1 {2 * both / (found + true):.3f}"


def main() -> None:
    """Score the parts, pair by pair."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--weights", type=Path)
    parser.add_argument("--kind", default="cuts", choices=("cuts", "holes"))
    parser.add_argument("--names", default="*", help="pattern of the parts' names")
    parser.add_argument("--up", default="z", choices=get_args(Up), help="which axis of the files points up")
    parser.add_argument("--in-place", action="store_true", help="take parts to lie where they belong, as the files do")
    parser.add_argument("--every", type=int, default=1, help="take every so many-th of them")
    arguments = parser.parse_args()
    operators = OperatorCache.default().operators
    matcher = Matcher.from_weights(arguments.weights, operators=operators) if arguments.weights else Matcher()
    scores = {"true map": Score(), "own map, mesh": Score(), "own map, cloud": Score()}
    files = [
        file for file in sorted((arguments.data / arguments.kind).glob("*.off")) if fnmatch(file.stem, arguments.names)
    ]
    for file in files[:: arguments.every]:
        part, complete = read_shape(file), read_shape(arguments.data / "null" / f"{file.stem.split('_')[1]}.off")
        positions, nearest = true_positions(complete, file.with_suffix(".baryc_gt"))
        truth = has_counterpart(complete, positions)
        whole = matcher.operators(complete)
        true_counterparts = covered(whole, matcher.operators(part, length=whole.length), torch.from_numpy(nearest))
        scores["true map"].add(true_counterparts.numpy(), truth)
        for modality, as_cloud in MODALITIES.items():
            found = matcher.match(
                complete,
                part,
                partial="target",
                in_place=arguments.in_place,
                as_cloud=as_cloud,
                source_up=arguments.up,
                target_up=arguments.up,
            )
            score = scores[f"own map, {modality}"]
            score.add(found.source_to_target >= 0, truth)
            score.errors.append(geodesic_errors(complete, nearest, found.target_to_source))
        print(file.stem, {name: str(score) for name, score in scores.items()}, flush=True)
    for name, score in scores.items():
        print(f"{name}: {score}")


if __name__ == "__main__":
    main()
