"""What a rigid alignment and nearest neighbours reach on a set of clouds: the least that a learned map has to beat.

    python benchmarks/rigid_alignment.py LUNGS --set lungs

For every pair of the test the target is laid on the source, by the middles alone and by iterated closest points from
there (trimesh's), and each of its points goes to the nearest point of the source. Beside these, no rigid alignment any
more, stands what takes all points of the target to all of the source on the shortest ways: an optimal transport, at one
middle and scale, smoothed by a few thousandths of the squared size. Errors are straight distances in the
files' unit, over the same pairs and points as `homolog evaluate` scores.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import torch
import trimesh
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from homolog.datasets import ShapeFolder
from homolog.maps import sinkhorn_matches

# Not typed.
_ICP: Any = trimesh.registration.icp

# In units of the mean squared distance from the middle; chosen on training pairs of the lungs, where it is 6 mm.
_SMOOTHED = 0.013


def main() -> None:
    """Print the mean of both alignments."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("data")
    parser.add_argument("--set", dest="name", default="lungs")
    given = parser.parse_args()
    folder = ShapeFolder.open(given.data, given.name)
    pairs = folder.pairs("test")
    shapes = {name: folder.shape(name) for name in dict.fromkeys(name for pair in pairs for name in pair)}
    truth = folder.ground_truth(shapes.__getitem__)
    errors: dict[str, list[Float[np.ndarray, " q"]]] = {
        "middles": [],
        "iterated closest points": [],
        "transport": [],
    }
    for pair in pairs:
        known = truth.between(*pair)
        source, target = (shapes[name].points for name in pair)
        laid = target - target.mean(axis=0) + source.mean(axis=0)
        turned = np.asarray(_ICP(laid, source, reflection=False, scale=False)[1])
        maps = *(KDTree(source).query(points)[1] for points in (laid, turned)), _transport(source, target)
        for way, found in zip(errors, maps, strict=True):
            errors[way].append(np.linalg.norm(source[found[known.target]] - source[known.source], axis=1))
    for way, found in errors.items():
        together = np.concatenate(found)
        print(f"{way}: mean {together.mean():.2f}, median {np.median(together):.2f}, {len(pairs)} pairs")


def _transport(source: Float[np.ndarray, "n 3"], target: Float[np.ndarray, "m 3"]) -> Int[np.ndarray, " m"]:
    """Each point of the target by the entropic optimal transport to the source.

    Products of these features are negative squared distances.
    """
    x, y = (torch.from_numpy(_unit(points)).float() for points in (source, target))
    ones_x, ones_y = torch.ones(len(x), 1), torch.ones(len(y), 1)
    features_x = torch.cat([2 * x, -x.square().sum(dim=1, keepdim=True), -ones_x], dim=1)
    features_y = torch.cat([y, ones_y, y.square().sum(dim=1, keepdim=True)], dim=1)
    found: Int[np.ndarray, " m"]
    found = sinkhorn_matches(features_y, features_x, temperature=_SMOOTHED, iterations=30).y_to_x.numpy()
    return found


def _unit(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    offsets = points - points.mean(axis=0)
    scaled: Float[np.ndarray, "n 3"] = offsets / np.sqrt((offsets**2).sum(axis=1).mean())
    return scaled


if __name__ == "__main__":
    main()
