"""How well bodies in loose shells are matched, by a surface around them and without: ``python benchmarks/proxies.py``.

Each demo body is matched to the other one made into shells (``homolog.synthesis.add_shells``), clean, with random
triangles turned round, and as a soup of triangles without common points.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

import homolog
from homolog.evaluation import geodesic_errors
from homolog.shapes import Shape
from homolog.synthesis import PartialShape, add_shells


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the errors of each kind, on amber and on boris, of both maps, x100."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--proxy", nargs="+", default=["auto", "never"], help="auto, never, always")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), help=", ".join(KINDS))
    options = parser.parse_args(arguments)
    matcher = homolog.Matcher.from_weights("people", device="cpu")
    for kind in options.kinds:
        for proxy in options.proxy:
            print(
                f"{kind:20} --proxy {proxy:8}",
                *(f"{error:6.2f}" for error in _errors(matcher, kind, proxy)),
                flush=True,
            )


def _errors(matcher: homolog.Matcher, kind: str, proxy: str) -> list[float]:
    folder = Path(homolog.__file__).parent / "demo_data" / "corres"
    points = [np.loadtxt(folder / f"{name}.vts", dtype=int) - 1 for name in ("amber", "boris")]
    shapes = homolog.demo_shapes()
    found = []
    for one, other in ((0, 1), (1, 0)):
        made = KINDS[kind](shapes[other])
        match = matcher.match(shapes[one], made.shape, proxy=proxy)
        to_one = np.full(shapes[other].n_points, -1)
        to_one[points[other]] = points[one]
        true = np.where(made.full_index >= 0, to_one[made.full_index], -1)
        (known,) = np.nonzero((true >= 0) & (match.target_to_source >= 0))
        found.append(geodesic_errors(shapes[one], true[known], match.target_to_source[known]).mean())
        reached = made.shape.points[match.source_to_target[points[one]]]
        place = KDTree(shapes[other].points).query(reached)[1]
        found.append(geodesic_errors(shapes[other], points[other], place).mean())
    return [100 * float(error) for error in found]


def _turned(shape: Shape) -> PartialShape:
    made = add_shells(shape, seed=0)
    assert made.shape.faces is not None
    which = np.random.default_rng(0).random(len(made.shape.faces)) < 0.5
    faces = np.where(which[:, None], made.shape.faces[:, ::-1], made.shape.faces)
    return PartialShape(Shape(made.shape.points, faces, name=shape.name), made.full_index)


def _soup(shape: Shape) -> PartialShape:
    made = add_shells(shape, seed=0)
    assert made.shape.faces is not None
    corners = made.shape.faces.ravel()
    points = made.shape.points[corners] + np.random.default_rng(0).normal(scale=1e-5, size=(len(corners), 3))
    return PartialShape(
        Shape(points, np.arange(len(corners)).reshape(-1, 3), name=shape.name), made.full_index[corners]
    )


KINDS: dict[str, Callable[[Shape], PartialShape]] = {
    "the bare body": lambda shape: PartialShape(shape, np.arange(shape.n_points)),
    "shells, seed 0": lambda shape: add_shells(shape, seed=0),
    "shells, seed 1": lambda shape: add_shells(shape, seed=1),
    "turned triangles": _turned,
    "soup of triangles": _soup,
}

if __name__ == "__main__":
    main()
