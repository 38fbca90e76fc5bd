"""Peak memory and time of reading large text files, each in a fresh process.

    python benchmarks/reading_memory.py --megabytes 150

Memory is the peak of the process less that of one that only imports what it needs. Coordinates have six decimals, as
most programs write them, and are random, so that half of the quadrilaterals are folded. Prints a row a format: the
file's size, the memory, how often that is the size, and the seconds of the processor.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from homolog.shapes import read_shape
from homolog.shapes.formats.text_rows import write_rows

# Bytes of a point and its two faces, roughly, and of a facet.
_OF_POINT, _OF_FACES, _OF_FACET = 30, 44, 190
_FACET = "facet normal 0 0 1\nouter loop\nvertex %r %r %r\nvertex %r %r %r\nvertex %r %r %r\nendloop\nendfacet\n"


def _points(n: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(n, 3)).round(6)


def _grid(size: int, corners: int) -> tuple[np.ndarray, np.ndarray]:
    """Points, and faces of three or four corners between those of a square grid."""
    side = int(np.sqrt(size / (_OF_POINT + _OF_FACES * (0.8 if corners == 4 else 1))))
    at = np.arange(side * side).reshape(side, side)
    quads = np.stack([at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]], axis=-1).reshape(-1, 4)
    faces = quads if corners == 4 else quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    return _points(side * side), faces


def _mesh(suffix: str, corners: int) -> Callable[[Path, int], None]:
    def write(path: Path, size: int) -> None:
        points, faces = _grid(size, corners)
        pattern, head = "%r %r %r\n", f"OFF\n{len(points)} {len(faces)} 0\n"
        face = f"{corners}{' %d' * corners}\n"
        if suffix == ".obj":
            pattern, face, faces, head = "v %r %r %r\n", f"f{' %d' * corners}\n", faces + 1, ""
        if suffix == ".ply":
            head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\n"
            head += f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
        write_rows(path, [(pattern, points), (face, faces)], head)

    return write


def _stl(path: Path, size: int) -> None:
    points, faces = _grid(size * (_OF_POINT + _OF_FACES) // (2 * _OF_FACET), 3)
    write_rows(path, [(_FACET, points[faces].reshape(-1, 9))], "solid\n")


def _xyz(path: Path, size: int) -> None:
    write_rows(path, [("%r %r %r\n", _points(size // _OF_POINT))])


def _csv(path: Path, size: int) -> None:
    write_rows(path, [("%r,%r,%r\n", _points(size // _OF_POINT))], "x,y,z\n")


FILES = {
    "triangles.off": _mesh(".off", 3),
    "quads.off": _mesh(".off", 4),
    "triangles.obj": _mesh(".obj", 3),
    "quads.obj": _mesh(".obj", 4),
    "triangles.ply": _mesh(".ply", 3),
    "quads.ply": _mesh(".ply", 4),
    "facets.stl": _stl,
    "points.xyz": _xyz,
    "points.csv": _csv,
}


def _measured(path: str) -> None:
    """In a process of its own: print the peak memory in bytes and the seconds of the processor."""
    began = time.process_time()
    if path:
        read_shape(path)
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024, time.process_time() - began)


def _fresh(path: str) -> tuple[float, float]:
    ended = subprocess.run([sys.executable, __file__, "--read", path], capture_output=True, text=True, check=True)
    peak, seconds = map(float, ended.stdout.split())
    return peak, seconds


def main() -> None:
    """Read the options, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--megabytes", type=int, default=150)
    parser.add_argument("--only", choices=FILES, nargs="+", default=list(FILES))
    parser.add_argument("--folder", type=Path, help="keep the files here, and use those that are there")
    parser.add_argument("--read", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.read is not None:
        return _measured(options.read)
    least, _ = _fresh("")
    with tempfile.TemporaryDirectory() as temporary:
        for name in options.only:
            path = (options.folder or Path(temporary)) / name
            if not path.exists():
                FILES[name](path, options.megabytes * 10**6)
            size = path.stat().st_size
            peak, seconds = _fresh(str(path))
            over = peak - least
            print(
                f"{name:15} {size / 1e6:6.0f} MB {over / 1e6:6.0f} MB {over / size:5.1f} x {seconds:6.1f} s", flush=True
            )
    return None


if __name__ == "__main__":
    main()
