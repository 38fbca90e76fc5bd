"""Time every step of a match, in seconds and in yardsticks.

Run from the root of the checkout::

    make bench
    python benchmarks/bench.py --only cloud_map --points 5000

A yardstick is one 4096 x 4096 x 4096 float32 matrix product on the same machine. Each figure is measured in a process
of its own, in turn with the yardstick, so that other work on the machine weighs on both; medians are reported. For the
network ``of_peak`` is the share of the yardstick's speed that its products reach, with all else that it does in their
time. Prints a table, and puts its figures in the place of earlier ones of the same name and size in
``benchmarks/latest.json``.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
import trimesh
from rich.console import Console
from rich.table import Table
from torch.utils.flop_counter import FlopCounterMode

from homolog.core.files import atomic_path
from homolog.core.memory import keep_freed_memory
from homolog.features import DiffusionNet, FeatureInfo, save_weights
from homolog.geometry import compute_operators, unit_frame
from homolog.maps import (
    functional_map,
    most_similar,
    normalised,
    point_map_from_functional_map,
    resolvent_mask,
    sinkhorn_matches,
)
from homolog.matching import Matcher, features_of_weights
from homolog.matching.search import orient
from homolog.pairs import MatcherSettings
from homolog.shapes import Shape, farthest_points, read_shape, write_shape
from homolog.training import AugmentationSettings, LossSettings, TrainingShape, pair_losses

ROOT = Path(__file__).parents[1]
LATEST = ROOT / "benchmarks" / "latest.json"
DEMO = ROOT / "src" / "homolog" / "demo_data" / "off"
SIZES = (5_000, 20_000, 100_000)
STEPS = (
    "operators_mesh",
    "operators_cloud",
    "features",
    "orientation",
    "orientation_rigid",
    "functional_map",
    "mesh_map",
    "cloud_map",
    "nearest_map",
    "match_cold",
    "match_warm",
    "match_large_mesh",
    "match_large_cloud",
    "train_step",
    "network_forward",
    "network_backward",
)
# A mesh and a cloud of so many points against a body of 5,000: at this size alone.
MILLION = 1_000_000
# Sinkhorn between clouds of this size is measured once, for its memory.
LARGE_CLOUD = 50_000
# A step of training on so many samples of each shape is what the recipes take.
SAMPLES = 1_200
# Steps that are not measured at every size, and sizes that are measured for one step only.
LARGEST = {"cloud_map": LARGE_CLOUD, "train_step": 20_000, "network_forward": 5_000, "network_backward": 5_000}
SMALLEST = {"match_large_mesh": MILLION, "match_large_cloud": MILLION}
EXTRA = (
    ("cloud_map", LARGE_CLOUD),
    ("match_large_mesh", MILLION),
    ("match_large_cloud", MILLION),
    *((name, SAMPLES) for name in ("train_step", "network_forward", "network_backward")),
)
_EIGENPAIRS = 80
# Side of the square matrices whose product is the yardstick.
YARD = 4096


def body(name: str, n_points: int) -> Shape:
    """A demo body with about ``n_points`` vertices: subdivided smoothly, then decimated."""
    import fast_simplification

    shape = read_shape(DEMO / f"{name}.off")
    if n_points <= 6_000:
        return shape
    mesh = trimesh.Trimesh(shape.points, shape.faces, process=False)
    while len(mesh.vertices) < n_points:
        mesh = mesh.subdivide_loop()
    points, faces = fast_simplification.simplify(
        np.asarray(mesh.vertices, dtype=np.float32), np.asarray(mesh.faces), target_count=2 * n_points
    )
    return Shape(points, faces, name=name)


def yardstick() -> float:
    """Seconds of one 4096 x 4096 x 4096 float32 matrix product."""
    a, b = torch.ones(YARD, YARD), torch.ones(YARD, YARD)
    began = time.perf_counter()
    a @ b
    return time.perf_counter() - began


class Pair:
    """Operators and features of two bodies, made once for the steps that need them."""

    def __init__(self, n_points: int) -> None:
        self.n_points = n_points
        self.operators = [compute_operators(body(name, n_points)) for name in ("amber", "boris")]
        network = untrained_network()
        with torch.inference_mode():
            self.features = [network(operators.points, operators) for operators in self.operators]


def untrained_network() -> DiffusionNet:
    """A network with fixed random weights: they cost what trained ones do."""
    torch.manual_seed(0)
    return DiffusionNet().eval()


def solved(pair: Pair) -> torch.Tensor:
    """The functional map of a pair, coefficients included."""
    x, y = (operators.truncated(_EIGENPAIRS) for operators in pair.operators)
    a, b = x.coefficients(pair.features[0]), y.coefficients(pair.features[1])
    return functional_map(a, b, resolvent_mask(x.eigenvalues, y.eigenvalues))


def mesh_map(pair: Pair) -> object:
    """Features to point map, one direction, by the functional map."""
    x, y = pair.operators
    return point_map_from_functional_map(solved(pair), x.eigenvectors, y.eigenvectors)


def spread_features(n_points: int, seed: int) -> torch.Tensor:
    """Features like a trained network's for a cloud too large to wait for its operators: smooth, of unit length."""
    generator = torch.Generator().manual_seed(seed)
    low = torch.randn(n_points, 16, generator=generator)
    return normalised(torch.tanh(low @ torch.randn(16, 128, generator=torch.Generator().manual_seed(0))))


def train_step(n_points: int) -> Callable[[], object]:
    """One step of training on a pair: the paper's losses, dropout and augmentation, their gradient, and Adam's step."""
    keep_freed_memory()  # as the training loop does
    x, y = (training_shape(body(name, max(n_points, 5_000)), n_points) for name in ("amber", "boris"))
    network, generator = untrained_network().train(), torch.Generator().manual_seed(0)
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-3)
    settings, augmentation = LossSettings(), AugmentationSettings()

    def run() -> None:
        with torch.inference_mode(False), torch.enable_grad():
            optimiser.zero_grad()
            losses = pair_losses(network, x, y, settings=settings, augmentation=augmentation, generator=generator)
            torch.autograd.backward(losses["total"])
            torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimiser.step()

    return run


def network_pass(name: str, n_points: int) -> Callable[[], object]:
    """What a step of training asks of the network: the features of two meshes and their clouds, or the way back."""
    keep_freed_memory()
    shapes = [training_shape(body(which, max(n_points, 5_000)), n_points) for which in ("amber", "boris")]
    bases = [basis for shape in shapes for basis in (shape.mesh, shape.cloud)]
    network, generator = untrained_network().train(), torch.Generator().manual_seed(0)

    @torch.inference_mode(False)
    def forward() -> list[torch.Tensor]:
        return network.several([basis.points for basis in bases], bases, generator=generator)

    if name == "network_forward":
        return forward
    features = forward()
    gradients = [torch.ones_like(each) for each in features]
    return lambda: torch.autograd.backward(features, gradients, retain_graph=True)


def training_shape(shape: Shape, n_samples: int) -> TrainingShape:
    """A mesh and its own points as a cloud, at so many samples of them."""
    scale = unit_frame(shape).scale
    bases = [compute_operators(each, scale=scale).basis for each in (shape, shape.as_cloud())]
    if n_samples < shape.n_points:
        kept = torch.from_numpy(farthest_points(bases[0].points.numpy(), n_samples, seed=0))
        bases = [basis.sampled(kept) for basis in bases]
    mesh, cloud = bases
    return TrainingShape(shape.name, mesh, cloud)


def oriented(name: str, n_points: int) -> Callable[[], object]:
    """Finding the way round of two bodies: by the orienter of the pretrained weights, or as rigid bodies."""
    settings = MatcherSettings(method="axiomatic" if name == "orientation_rigid" else "auto")
    matcher = Matcher(features_of_weights(None, settings), settings=settings)
    pair, _ = matcher.pair(body("amber", n_points), body("boris", n_points))
    operators = [shape.operators for shape in (pair.source, pair.target)]
    return lambda: [*map(matcher.preprocess.orientations, operators), orient(pair)]


def step(name: str, n_points: int) -> Callable[[], object]:
    """The function to time, everything it needs made beforehand."""
    if name.startswith("operators"):
        shape = body("amber", n_points)
        shape = shape.as_cloud() if name == "operators_cloud" else shape
        return lambda: compute_operators(shape)
    if name == "features":
        operators = compute_operators(body("amber", n_points))
        network = untrained_network()
        return lambda: network(operators.points, operators)
    if name == "cloud_map" and n_points == LARGE_CLOUD:
        x, y = spread_features(n_points, 1), spread_features(n_points, 2)
        return lambda: sinkhorn_matches(y, x, temperature=0.1)
    if name == "train_step":
        return train_step(n_points)
    if name.startswith("network"):
        return network_pass(name, n_points)
    if name.startswith("orientation"):
        return oriented(name, n_points)
    pair = Pair(n_points)
    x, y = (normalised(f) for f in pair.features)
    return {
        "functional_map": lambda: solved(pair),
        "mesh_map": lambda: mesh_map(pair),
        "cloud_map": lambda: sinkhorn_matches(y, x, temperature=0.1),
        "nearest_map": lambda: most_similar(y, x),
    }[name]


def measure(name: str, n_points: int) -> dict[str, object]:
    """Time one step in this process."""
    repeats = 1 if n_points == LARGE_CLOUD else 3 if n_points > 6_000 else 7
    run, peak = step(name, n_points), 0.0
    seconds, yards = list[float](), list[float]()
    counter = FlopCounterMode(display=False)
    with torch.inference_mode(not name.startswith("network")):
        if repeats > 1:
            with counter:
                run()
        for _ in range(repeats):
            began = time.perf_counter()
            run()
            seconds.append(time.perf_counter() - began)
            peak = peak if yards else peak_mb(resource.RUSAGE_SELF)  # before the yardstick's own matrices
            yards.append(yardstick())
    second, yard = statistics.median(seconds), statistics.median(yards)
    found = row(name, n_points, second, yard, peak)
    if name.startswith("network"):
        found["of_peak"] = round(counter.get_total_flops() / (2 * YARD**3) * yard / second, 2)
    return found


def measure_match(name: str, n_points: int) -> dict[str, object]:
    """Time ``homolog match`` as a whole process, from files, with an empty or a filled cache."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for which in ("amber", "boris"):
            write_shape(folder / f"{which}.ply", body(which, n_points))
        save_weights(folder / "untrained.safetensors", untrained_network(), FeatureInfo(name="untrained"))
        command = [sys.executable, "-m", "homolog", "match", "amber.ply", "boris.ply", "-o", "out", "--quiet"]
        command += ["--weights", "untrained.safetensors"]
        environment = {**os.environ, "HOMOLOG_CACHE": str(folder / "cache")}
        seconds, yards = [], []
        for repeat in range(2 if name == "match_cold" and n_points > 6_000 else 4):
            if name == "match_cold":
                environment["HOMOLOG_CACHE"] = str(folder / f"cache{repeat}")
            began = time.perf_counter()
            subprocess.run(command, cwd=folder, env=environment, check=True)
            seconds.append(time.perf_counter() - began)
            yards.append(yardstick())
        counted = seconds[1:] if name == "match_warm" else seconds
        return row(
            name, n_points, statistics.median(counted), statistics.median(yards), peak_mb(resource.RUSAGE_CHILDREN)
        )


def measure_large(name: str, n_points: int) -> dict[str, object]:
    """Time ``homolog match`` of a large shape against a body of 5,000 points, as a whole process, without a cache."""
    with tempfile.TemporaryDirectory() as scratch:
        large = body("amber", n_points)
        write_shape(Path(scratch, "large.ply"), large.as_cloud() if name == "match_large_cloud" else large)
        write_shape(Path(scratch, "body.ply"), body("boris", 5_000))
        command = [sys.executable, "-m", "homolog", "match", "large.ply", "body.ply", "-o", "out", "--quiet"]
        before, began = yardstick(), time.perf_counter()
        subprocess.run([*command, "--weights", "people", "--no-cache"], cwd=scratch, check=True)
        seconds, used = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    found = row(name, n_points, seconds, (before + yardstick()) / 2, peak_mb(resource.RUSAGE_CHILDREN))
    return {**found, "cpu_seconds": round(used.ru_utime + used.ru_stime, 1)}


def row(name: str, n_points: int, seconds: float, yard: float, peak: float) -> dict[str, object]:
    """One figure, as it is kept."""
    return {
        "name": name,
        "points": n_points,
        "seconds": round(seconds, 4),
        "yardsticks": round(seconds / yard, 3),
        "peak_mb": round(peak),
    }


def peak_mb(who: int) -> float:
    """Peak resident memory in MB."""
    return resource.getrusage(who).ru_maxrss / 1024


def measured_apart(name: str, n_points: int) -> dict[str, object]:
    """One figure, from a process of its own."""
    command = [sys.executable, __file__, "--one", name, "--points", str(n_points)]
    finished = subprocess.run(command, capture_output=True, text=True, check=True)
    found: dict[str, object] = json.loads(finished.stdout.splitlines()[-1])
    return found


def keep(rows: list[dict[str, object]], path: Path) -> None:
    """Put figures beside those kept before, in the place of any of the same name and size."""
    before = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else []
    merged = {(kept["name"], kept["points"]): kept for kept in [*before, *rows]}
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(list(merged.values()), indent=1) + "\n", encoding="utf-8")


def is_measured(name: str, n_points: int) -> bool:
    """Whether a step is measured at a size."""
    return SMALLEST.get(name, 0) <= n_points <= LARGEST.get(name, n_points)


def main() -> None:
    """Measure what is asked for, print it, and keep it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=STEPS, default=STEPS, help="steps to time")
    parser.add_argument("--points", nargs="+", type=int, default=SIZES, help="sizes to time")
    parser.add_argument("--one", choices=STEPS, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        large = arguments.one in SMALLEST
        measuring = measure_large if large else measure_match if arguments.one.startswith("match") else measure
        print(json.dumps(measuring(arguments.one, arguments.points[0])))
        return
    cases = [(name, n) for n in arguments.points for name in arguments.only if is_measured(name, n)]
    if tuple(arguments.points) == SIZES:
        cases += [case for case in EXTRA if case[0] in arguments.only]
    rows = []
    for name, n_points in cases:
        rows.append(measured_apart(name, n_points))
        print(rows[-1], file=sys.stderr)
    keep(rows, LATEST)
    table = Table(title="homolog, in yardsticks")
    columns = ("name", "points", "seconds", "yardsticks", "peak_mb", "of_peak", "cpu_seconds")
    for column in columns:
        table.add_column(column, justify="left" if column == "name" else "right")
    for found in rows:
        table.add_row(*(str(found.get(column, "")) for column in columns))
    Console().print(table)


if __name__ == "__main__":
    main()
