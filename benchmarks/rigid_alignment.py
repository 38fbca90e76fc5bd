"""What centring, ICP and nearest neighbours reach on a dataset of clouds: the baseline of a learned map.

    python benchmarks/rigid_alignment.py LUNGS --dataset lungs

For every test pair the target is aligned with the source, by centring alone and by iterated closest points from there
(trimesh's). Each of its points is mapped to the nearest point of the source. Errors are Euclidean distances in the
files' unit, over the same pairs and points as `homolog evaluate` scores.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial import KDTree

from homolog.datasets import ShapeFolder

# Not typed.
_ICP: Any = trimesh.registration.icp


def main() -> None:
    """Print the mean of both alignments."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("data")
    parser.add_argument("--dataset", default="lungs")
    given = parser.parse_args()
    folder = ShapeFolder.open(given.data, given.dataset)
    pairs = folder.pairs("test")
    shapes = {name: folder.shape(name) for name in dict.fromkeys(name for pair in pairs for name in pair)}
    truth = folder.ground_truth(shapes.__getitem__)
    errors: dict[str, list[Float[np.ndarray, " q"]]] = {"centring": [], "iterated closest points": []}
    for pair in pairs:
        known = truth.between(*pair)
        source, target = (shapes[name].points for name in pair)
        centred = target - target.mean(axis=0) + source.mean(axis=0)
        aligned = np.asarray(_ICP(centred, source, reflection=False, scale=False)[1])
        maps = (KDTree(source).query(points)[1] for points in (centred, aligned))
        for way, found in zip(errors, maps, strict=True):
            errors[way].append(np.linalg.norm(source[found[known.target]] - source[known.source], axis=1))
    for way, found in errors.items():
        together = np.concatenate(found)
        print(f"{way}: mean {together.mean():.2f}, median {np.median(together):.2f}, {len(pairs)} pairs")


if __name__ == "__main__":
    main()
