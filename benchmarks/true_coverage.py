"""How well points without a counterpart are found from the true map: the bound for any map.

Run from the root of the checkout, with the unpacked dataset::

    python benchmarks/true_coverage.py SHREC16 --dataset shrec16_cuts --every 10

``homolog evaluate`` gives the same figures for computed maps.
"""

from __future__ import annotations

import argparse

import torch

from homolog.datasets import GroundTruth, ShapeFolder
from homolog.evaluation import Detection
from homolog.geometry import OperatorCache
from homolog.maps import overlap
from homolog.matching import Matcher


def detection(matcher: Matcher, folder: ShapeFolder, truth: GroundTruth, source: str, target: str) -> Detection:
    """Points of a full shape without a counterpart on a partial one: by the true map, and in truth."""
    known = truth.counterparts(source, target)
    if known is None:
        raise SystemExit(
            f"{folder.description.name} has no ground truth of this kind; take shrec16_cuts or shrec16_holes"
        )
    full = matcher.preprocess.operators(folder.shape(source))
    partial = matcher.preprocess.operators(folder.shape(target), scale=full.scale)
    found = overlap(full, partial, torch.from_numpy(truth.between(source, target).source)).numpy()
    return Detection.of(~found[known.points], ~known.present)


def main() -> None:
    """Score the parts, pair by pair."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data")
    parser.add_argument("--dataset", default="shrec16_cuts")
    parser.add_argument("--every", type=int, default=1, help="take every so many-th of the pairs")
    given = parser.parse_args()
    folder = ShapeFolder.open(given.data, given.dataset)
    truth, matcher = folder.ground_truth(), Matcher(operators=OperatorCache.default().operators)
    scores = [detection(matcher, folder, truth, *pair) for pair in folder.pairs("test")[:: given.every]]
    print(sum(scores[1:], scores[0]).to_dict())


if __name__ == "__main__":
    main()
