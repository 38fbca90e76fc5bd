"""Gather full and partial shapes of several benchmarks in one folder, to train the recipe ``parts`` on.

Run from the root of the checkout, with the unpacked datasets::

    python benchmarks/gather_parts.py MIXED --parts SHREC16 --leave-out "*_shape_1?" --full FAUST_r SCAPE_r SMAL_r
    homolog train MIXED -o run --recipe parts

Parts stay pre-aligned with their full shapes. Everything is +y up, and full shapes have unit area. ``MIXED/pairs.txt``
lists each part with its full shape, and pairs of training shapes of each other dataset.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path

import numpy as np

from homolog.datasets import Pair, ShapeFolder
from homolog.geometry import Frame, unit_frame
from homolog.shapes import Shape, write_shape

# Partners of each full shape: datasets with fewer shapes have more, so that each has its share of the pairs.
_PAIRS_PER_DATASET = 60


def written(shape: Shape, frame: Frame, file: Path) -> None:
    """Write a shape in the coordinates of a frame."""
    write_shape(file, Shape(frame.to_unit(shape.points), shape.faces))


def gather_full(root: Path, output: Path) -> Iterator[Pair]:
    """The training shapes of a dataset, in pairs drawn at random."""
    folder, random = ShapeFolder.open(root), np.random.default_rng(0)
    names = folder.split("train")
    for name in names:
        shape = folder.shape(name)
        written(shape, unit_frame(shape), output / f"{root.name}-{name}.off")
    for name in names:
        others = [other for other in names if other != name]
        for other in random.choice(others, size=max(round(_PAIRS_PER_DATASET / len(names)), 1), replace=False):
            yield f"{root.name}-{name}", f"{root.name}-{other}"


def gather_parts(root: Path, output: Path, leave_out: str) -> Iterator[Pair]:
    """The parts of SHREC'16, in the frames of their full shapes."""
    for kind in ("shrec16_cuts", "shrec16_holes"):
        folder = ShapeFolder.open(root, kind)
        frames = {name: unit_frame(folder.shape(name)) for name in folder.full}
        for name, frame in frames.items():
            written(folder.shape(name), frame, output / f"null_{name}.off")
        for full, part in folder.pairs("all"):
            if not fnmatch(part, leave_out):
                written(folder.shape(part), frames[full], output / f"{part}.off")
                yield f"null_{full}", part


def main() -> None:
    """Gather what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("output", type=Path)
    parser.add_argument("--parts", type=Path, required=True, help="SHREC16")
    parser.add_argument("--full", type=Path, nargs="+", default=[], help="datasets of full shapes")
    parser.add_argument("--leave-out", default="", help="pattern of the names of parts to keep for testing")
    arguments = parser.parse_args()
    shapes = arguments.output / "off"
    if shapes.exists():
        parser.error(f"{shapes} exists already; give another folder")
    shapes.mkdir(parents=True)
    pairs = list(gather_parts(arguments.parts, shapes, arguments.leave_out))
    for root in arguments.full:
        pairs += gather_full(root, shapes)
    (arguments.output / "pairs.txt").write_text("".join(f"{x},{y}\n" for x, y in pairs), encoding="utf-8")


if __name__ == "__main__":
    main()
