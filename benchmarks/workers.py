"""How much faster two workers of a Ray cluster are than one process: ``python benchmarks/workers.py``.

Each job is run by one process, then with ``--cluster ray``. The rate is that of files from the first to the last, so
that the seconds in which Ray and its workers begin do not count. CPU seconds of that time are told beside it, of the
command itself, of Ray's workers and of the rest of Ray. On a machine with other work they say what idle cores would
give: as many times the rate as there are workers, over the share by which a file takes more CPU seconds. Files that
differ between both runs are listed.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import psutil
import trimesh
from safetensors.numpy import load_file

from homolog.core.cluster import Cluster, Processes
from homolog.core.files import sha256
from homolog.core.progress import ignore
from homolog.geometry import OperatorCache
from homolog.shapes import Shape, write_shape
from homolog.training import read_recipe
from homolog.training.data import TrainingSet
from homolog.training.store import keep_operators

JOBS = ("animals", "collection", "operators")
# Files whose times say how far a job is, and those that hold times, names of folders or notes in any order.
_MADE = {"animals": "off/*.off", "collection": "records/*.json", "operators": "**/*.safetensors"}
_DIFFER = {"report.json", "quality.csv", "modes.html", "records"}


@dataclass(frozen=True)
class Run:
    """What a run took from its first file to its last.

    Args:
        files: how many after the first.
        seconds: of the clock.
        cpu: CPU seconds of the command, of Ray's workers, and of the rest of Ray.
    """

    files: int
    seconds: float
    cpu: dict[str, float]

    @property
    def rate(self) -> float:
        """Files a second."""
        return self.files / self.seconds


def main() -> None:
    """Run each job both ways, and print rates, CPU seconds and files that differ."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--jobs", nargs="+", choices=JOBS, default=JOBS)
    parser.add_argument("-n", type=int, default=16, help="how many shapes")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--vertices", type=int, default=1000, help="of each animal")
    parser.add_argument("--operators-of", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--processes", type=int, default=1, help=argparse.SUPPRESS)
    parser.add_argument("--cluster", help=argparse.SUPPRESS)
    parser.add_argument("folder", type=Path, nargs="?", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.operators_of is not None:
        processes = Cluster(given.cluster, given.processes) if given.cluster else given.processes
        keep(given.operators_of, given.folder, processes)
        return
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with tempfile.TemporaryDirectory() as scratch:
        for job in given.jobs:
            folders = [Path(scratch, f"{job}-{workers}") for workers in (1, given.workers)]
            command = [sys.executable, *command_of(job, given.n, given.vertices, Path(scratch))]
            one = run([*command, str(folders[0]), "--processes", "1"], folders[0], _MADE[job])
            cluster = ["--cluster", "ray", "--processes", str(given.workers)]
            several = run([*command, str(folders[1]), *cluster], folders[1], _MADE[job])
            tell(job, one, several, given.workers)
            print("    files that differ:", ", ".join(differing(*folders)) or "none", flush=True)


def command_of(job: str, n: int, vertices: int, scratch: Path) -> list[str]:
    """The arguments of a job, without its folder, which comes last."""
    animals = [
        "-m",
        "homolog",
        "synth",
        "animals",
        "-n",
        str(n),
        "--vertices",
        str(vertices),
        "--seed",
        "3",
        "--quiet",
        "-o",
    ]
    if job == "animals":
        return animals
    if job == "operators":
        if not (scratch / "shapes").exists():
            subprocess.run([sys.executable, *animals, str(scratch / "shapes")], check=True)
        return [__file__, "--operators-of", str(scratch / "shapes")]
    shapes = [scratch / f"{number:03}.ply" for number in range(n + 1)]
    for number, path in enumerate(shapes):
        ball = trimesh.creation.icosphere(subdivisions=2 if number else 3)
        write_shape(path, Shape(ball.vertices * [1, 2 + 0.01 * number, 0.5], ball.faces))
    options = ["--method", "registration", "--orient", "given", "--clutter", "keep", "--no-cache", "--quiet"]
    return ["-m", "homolog", "collection", *map(str, shapes), *options, "-o"]


def keep(shapes: Path, folder: Path, processes: Processes) -> None:
    """Compute the operators of shapes and their clouds into a cache, as ``homolog train --cluster`` does first."""
    recipe = read_recipe("quick", {"data.split": "all"})
    source = OperatorCache(folder).operators
    keep_operators(TrainingSet.open(shapes, recipe), recipe, source, processes, progress=ignore)


def run(command: list[str], folder: Path, made: str) -> Run:
    """Run a command to its end, and look at its processes meanwhile."""
    process = psutil.Popen(command)
    last, looks = dict[int, tuple[str, float]](), list[tuple[float, dict[str, float]]]()
    while process.poll() is None:
        for each in (process, *process.children(recursive=True)):
            with suppress(psutil.Error):
                times, name = each.cpu_times(), " ".join(each.cmdline())
                is_worker = "workers" in last.get(each.pid, ()) or name.startswith(("ray::_in_worker", "ray::IDLE"))
                kind = "command" if each == process else "workers" if is_worker else "Ray"
                last[each.pid] = kind, times.user + times.system
        looks.append((time.time(), by_kind(last)))
        time.sleep(0.5)
    if process.returncode:
        raise SystemExit(process.returncode)
    times_made = sorted(path.stat().st_mtime for path in folder.glob(made))
    first, final = (
        next((used for when, used in looks if when >= made_at), looks[-1][1])
        for made_at in (times_made[0], times_made[-1])
    )
    cpu = {kind: final[kind] - first[kind] for kind in final}
    return Run(len(times_made) - 1, times_made[-1] - times_made[0], cpu)


def by_kind(used: dict[int, tuple[str, float]]) -> dict[str, float]:
    """The CPU seconds of all processes of each kind."""
    return {kind: sum(each for name, each in used.values() if name == kind) for kind in ("command", "workers", "Ray")}


def tell(job: str, one: Run, several: Run, workers: int) -> None:
    """Print what both runs of a job took."""
    print(f"{job}: {one.rate:.3g} and {several.rate:.3g} files a second, {several.rate / one.rate:.2f} times")
    alone, told = sum(one.cpu.values()), ", ".join(f"{kind} {used:.1f}" for kind, used in several.cpu.items())
    on_idle = workers * alone / one.files / (sum(several.cpu.values()) / several.files)
    print(f"    CPU s: {alone:.1f}, then {told}; on idle cores {on_idle:.2f} times")


def differing(one: Path, other: Path) -> list[str]:
    """Files of either folder that the other one lacks, or has with other bytes."""
    hashes = [
        {path.relative_to(root).as_posix(): content(path) for path in root.rglob("*") if path.is_file()}
        for root in (one, other)
    ]
    return sorted(
        name
        for name in {**hashes[0], **hashes[1]}
        if hashes[0].get(name) != hashes[1].get(name) and not _DIFFER & {*Path(name).parts}
    )


def content(path: Path) -> str:
    """A hash of a file; of its tensors in their order, where notes beside them have none."""
    if path.suffix != ".safetensors":
        return sha256(path)
    tensors = sorted(load_file(path).items())
    return hashlib.sha256(b"".join(name.encode() + values.tobytes() for name, values in tensors)).hexdigest()


if __name__ == "__main__":
    main()
