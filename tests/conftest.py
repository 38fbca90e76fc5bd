"""What the tests share: small shapes of known geometry, the demo bodies, the published reference numbers, a browser."""

from __future__ import annotations

import copy
import gc
import hashlib
import importlib
import logging
import os
import shutil
import tarfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

# Small shapes on a busy machine: threads would wait for each other most of the time. To be set before numpy loads.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest
import scipy.sparse as sparse
import torch
import trimesh
from hypothesis import settings
from torch import Tensor
from torch.multiprocessing.reductions import StorageWeakRef
from torch.utils._python_dispatch import TorchDispatchMode

import homolog
from homolog.core.reader_process import ReaderProcessError
from homolog.geometry import Operators, OperatorSettings, clutter, compute_operators
from homolog.geometry import operators as geometry_operators
from homolog.geometry.operators import compressed_rows
from homolog.matching import mirror, search
from homolog.shapes import Shape, read_shape, write_shape

# The same examples on every run, and no failure because a machine is slow.
settings.register_profile("homolog", derandomize=True, deadline=None)
settings.load_profile("homolog")
torch.set_num_threads(int(os.environ["OMP_NUM_THREADS"]))


LONG = ("bodies", "browser", "process", "pages", "slow")
# Files whose tests take minutes each.
LONGEST = ("test_crash", "test_fuzz")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what ``make test`` leaves out with one word, before tests are chosen by their marks; the longest come first.

    So no process is left alone with one of them when all others are done.
    """
    for item in items:
        if any(item.get_closest_marker(name) for name in LONG):
            item.add_marker("long")
    items.sort(key=lambda item: item.path.stem not in LONGEST)


def pytest_collection_finish() -> None:
    """Garbage is not looked for among all modules and tests again and again."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """One process for each core that may be used; each takes some 700 MB."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(cores, 8)


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep every test away from the user's own operator cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HOMOLOG_CACHE", str(tmp_path_factory.mktemp("operator-cache")))
        patch.delenv("HOMOLOG_CACHE_GB", raising=False)
        yield


# Pure functions on which matches of small shapes spend most of their time: where they are called, and how many results
# are kept.
_REMEMBERED = (
    (clutter, "find_clutter", 200),
    (geometry_operators, "lowest_eigenpairs", 40),
    (mirror, "closest_point_rotations", 1000),
    (search, "closest_point_rotations", 1000),
    (search, "most_similar", 1000),
    (search, "zoomout", 1000),
)


def _identity(given: object) -> object:
    """What tells one argument from another: of arrays all that they hold."""
    if isinstance(given, Tensor):
        return given.device, *_identity(given.detach().cpu().numpy())
    if sparse.issparse(given):
        return tuple(_identity(part) for part in (given.indptr, given.indices, given.data))
    if isinstance(given, Shape):
        return _identity(given.points), _identity(given.faces)
    if isinstance(given, np.ndarray):
        return given.dtype, given.shape, hashlib.sha256(np.ascontiguousarray(given)).digest()
    return repr(given)


def _remembered(function: Callable[..., object], most: int) -> Callable[..., object]:
    known: dict[object, object] = {}

    def once(*given: object, **named: object) -> object:
        key = *map(_identity, given), *((name, _identity(value)) for name, value in sorted(named.items()))
        if key not in known:
            if len(known) == most:
                known.pop(next(iter(known)))
            known[key] = function(*given, **named)
        return copy.deepcopy(known[key])

    return once


@pytest.fixture(autouse=True)
def _own_log_level() -> Iterator[None]:
    """A command sets for its process how much is told, which other tests in it must not depend on."""
    log = logging.getLogger("homolog")
    level = log.level
    yield
    log.setLevel(level)


@pytest.fixture(scope="session", autouse=True)
def compute_anew() -> Iterator[Callable[[pytest.MonkeyPatch], None]]:
    """What several tests compute from the same is computed once.

    Returns:
        A function that has a test compute it anew.
    """
    plain = {(module, name): getattr(module, name) for module, name, _ in _REMEMBERED}

    def anew(patch: pytest.MonkeyPatch) -> None:
        for (module, name), function in plain.items():
            patch.setattr(module, name, function)

    with pytest.MonkeyPatch.context() as patch:
        for module, name, most in _REMEMBERED:
            patch.setattr(module, name, _remembered(plain[module, name], most))
        yield anew


@pytest.fixture
def small_sheets(monkeypatch: pytest.MonkeyPatch) -> None:
    """Contact sheets have few pixels: drawing them takes longer than all else of a small collection."""
    sheets = importlib.import_module("homolog.viewing.contact_sheet")
    monkeypatch.setattr(sheets, "_WIDTH", 80)
    monkeypatch.setattr(sheets, "_HEIGHT", 92)


@pytest.fixture
def readers_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whole files are read in this process: each process of a reader takes a third of a second to start."""
    root = Path(homolog.__file__).parents[1]

    def read(script: Path, path: Path, *arguments: str, library: str) -> dict[str, np.ndarray]:
        reader = importlib.import_module(".".join(script.relative_to(root).with_suffix("").parts))
        try:
            return reader.read(str(path), *arguments)
        except (ValueError, OSError, RuntimeError) as error:
            raise ReaderProcessError(str(error)) from None

    for module in ("matching.result_files", "shapes.formats.vtk", "volumes.reading"):
        monkeypatch.setattr(f"homolog.{module}.read_in_process", read)


@pytest.fixture(params=["cpu", "cuda"] if torch.cuda.is_available() else ["cpu"])
def device(request: pytest.FixtureRequest) -> torch.device:
    """Each device that there is: results must lie on it, and be those of the CPU."""
    return torch.device(request.param)


@pytest.fixture(params=[torch.float32, torch.float64], ids=["float32", "float64"])
def dtype(request: pytest.FixtureRequest) -> torch.dtype:
    """Both precisions."""
    return request.param


def sphere_shape(subdivisions: int, *, radius: float = 1.0) -> Shape:
    """A sphere of 10 * 4^subdivisions + 2 points, as regular as can be."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return Shape(np.asarray(mesh.vertices), np.asarray(mesh.faces), name="sphere")


def grid_shape(n: int, *, width: float = 1.0) -> Shape:
    """A flat, open square of n x n points in the plane z = 0."""
    x, y = np.meshgrid(np.linspace(0, width, n), np.linspace(0, width, n), indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), np.zeros(n * n)], axis=1)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + n, corner + n + 1], axis=1),
            np.stack([corner, corner + n + 1, corner + 1], axis=1),
        ]
    )
    return Shape(points, faces, name="grid")


def blob_shape(subdivisions: int = 3) -> Shape:
    """A smooth closed surface without any symmetry, so that no eigenvalue is repeated."""
    sphere = sphere_shape(subdivisions)
    x, y, z = sphere.points.T
    radius = 1 + 0.25 * x * y + 0.2 * np.sin(2 * z + 0.4) + 0.15 * np.cos(3 * x + y + 0.7) + 0.1 * np.sin(2 * x - z)
    points = sphere.points * radius[:, None] * np.array([1.0, 1.4, 0.8])
    return Shape(points, sphere.faces, name="blob")


def joined(shapes: list[Shape]) -> Shape:
    """Several meshes as one."""
    offsets = np.cumsum([0, *(shape.n_points for shape in shapes)])
    faces = [shape.faces + offset for shape, offset in zip(shapes, offsets, strict=False)]
    return Shape(np.concatenate([shape.points for shape in shapes]), np.concatenate(faces), name="several")


def relabelled(shape: Shape, order: np.ndarray) -> Shape:
    """The same surface with its points in another order: new point i is old point ``order[i]``."""
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    return Shape(shape.points[order], None if shape.faces is None else place[shape.faces], name=shape.name)


def littered(shape: Shape, count: int, *, first: bool = False) -> Shape:
    """A mesh with many tiny tetrahedra around it, none near it; they come after its own points and faces, or first."""
    rng = np.random.default_rng(0)
    extent = np.ptp(shape.points, axis=0).max()
    away = rng.standard_normal((count, 1, 3))
    away *= (1 + rng.random((count, 1, 1))) * extent / np.linalg.norm(away, axis=2, keepdims=True)
    corners = away + 1e-3 * extent * rng.standard_normal((count, 4, 3))
    tetrahedron = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    faces = tetrahedron + 4 * np.arange(count)[:, None, None]
    pieces = Shape(corners.reshape(-1, 3) + shape.points.mean(axis=0), faces.reshape(-1, 3))
    return joined([pieces, shape] if first else [shape, pieces])


def random_rotation(seed: int) -> np.ndarray:
    """A proper rotation (3, 3)."""
    q, r = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


@dataclass(frozen=True)
class Makers:
    """The functions above, for tests to make shapes with."""

    sphere: Callable[..., Shape] = sphere_shape
    grid: Callable[..., Shape] = grid_shape
    blob: Callable[..., Shape] = blob_shape
    joined: Callable[..., Shape] = joined
    littered: Callable[..., Shape] = littered
    relabelled: Callable[..., Shape] = relabelled
    rotation: Callable[[int], np.ndarray] = random_rotation


@pytest.fixture(scope="session")
def make() -> Makers:
    """Makers of small shapes."""
    return Makers()


class LargeTensors(TorchDispatchMode):
    """Within a ``with`` block, how many tensors of at least so many bytes live at once, at most; views count once."""

    def __init__(self, n_bytes: float) -> None:
        super().__init__()
        self.n_bytes, self.most_alive = n_bytes, 0
        self._alive: dict[int, StorageWeakRef] = {}

    def __torch_dispatch__(self, operation, types, args=(), kwargs=None):
        results = operation(*args, **(kwargs or {}))
        for result in results if isinstance(results, tuple | list) else [results]:
            if isinstance(result, Tensor) and result.layout == torch.strided:
                self._see(result.untyped_storage())
        return results

    def _see(self, storage: torch.UntypedStorage) -> None:
        if storage.nbytes() >= self.n_bytes:
            self._alive = {key: seen for key, seen in self._alive.items() if not seen.expired()}
            seen = StorageWeakRef(storage)
            self._alive[seen.cdata] = seen
            self.most_alive = max(self.most_alive, len(self._alive))


@pytest.fixture
def large_tensors() -> Callable[[float], LargeTensors]:
    """``with large_tensors(n_bytes) as seen: ...``, then ``seen.most_alive``."""
    return LargeTensors


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Callable[[type, str], list[str]]:
    """``calls(Class, "method")`` is a list to which each call of the method adds its name."""

    def count(owner: type, name: str) -> list[str]:
        method, seen = getattr(owner, name), []

        def counted(*args, **kwargs):
            seen.append(name)
            return method(*args, **kwargs)

        monkeypatch.setattr(owner, name, counted)
        return seen

    return count


# A browser without a screen or a graphics card draws in software, and asks nobody for anything.
_BROWSER_ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--disable-sync",
    "--disable-background-networking",
    "--disable-component-update",
    "--no-first-run",
]
_BROWSER_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@pytest.fixture(scope="session")
def browser():
    """Chromium, driven by playwright."""
    driver = pytest.importorskip("playwright.sync_api", reason="playwright is missing; pip install 'homolog[dev]'")
    program = os.environ.get("HOMOLOG_CHROMIUM") or next(filter(None, map(shutil.which, _BROWSER_NAMES)), None)
    if program is None:
        pytest.skip("no Chromium on the path; install one, or set HOMOLOG_CHROMIUM")
    with driver.sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=program, args=_BROWSER_ARGUMENTS)
        yield found
        found.close()


class Tab:
    """A page with all that it complained of and asked for."""

    def __init__(self, browser, width, height):
        self.page = browser.new_page(viewport={"width": width, "height": height})
        self.page.set_default_timeout(90_000)
        self.complaints, self.requests = [], []
        self.page.on("console", lambda message: message.type == "error" and self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))


@pytest.fixture
def tab(browser):
    """``tab()`` is a new page of 900 x 600 pixels, or of what is given."""
    opened = []

    def new(width=900, height=600):
        opened.append(Tab(browser, width, height))
        return opened[-1]

    yield new
    for one in opened:
        one.page.close()


@dataclass(frozen=True)
class DemoPair:
    """The two bundled bodies, with the common points of their true correspondence."""

    amber: Shape
    boris: Shape
    amber_points: np.ndarray
    boris_points: np.ndarray


@pytest.fixture(scope="session")
def demo_folder() -> Path:
    """The bundled data: ``off/NAME.off`` and ``corres/NAME.vts``."""
    return Path(homolog.__file__).parent / "demo_data"


@pytest.fixture(scope="session")
def demo(demo_folder: Path) -> DemoPair:
    """The two bundled bodies."""
    shapes = [read_shape(demo_folder / "off" / f"{name}.off") for name in ("amber", "boris")]
    common = [np.loadtxt(demo_folder / "corres" / f"{name}.vts", dtype=int) - 1 for name in ("amber", "boris")]
    return DemoPair(*shapes, *common)


@pytest.fixture(scope="session")
def demo_operators(demo: DemoPair) -> tuple[Operators, Operators]:
    """The operators of both bundled bodies, with 60 eigenpairs."""
    wanted = OperatorSettings(n_eigenpairs=60)
    return compute_operators(demo.amber, settings=wanted), compute_operators(demo.boris, settings=wanted)


def write_rows(path: Path, rows: np.ndarray) -> None:
    """A file with a row a line, numbers as they come."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(" ".join(f"{value:.17g}" for value in np.atleast_1d(row)) + "\n" for row in rows))


@pytest.fixture
def parts_set(tmp_path: Path, make: Makers) -> tuple[Path, dict[str, tuple[str, np.ndarray, np.ndarray]]]:
    """Two complete shapes and three parts laid out as SHREC'16 has them; where each point of a part lies is known.

    Returns:
        The folder, and per part its complete shape's name, the triangle (from 0) and the weights of each point.
    """
    root, known = tmp_path / "parts", {}
    rng = np.random.default_rng(0)
    for below in ("null", "cuts"):
        (root / below).mkdir(parents=True)
    complete = {"cat": make.blob(2), "dog": make.sphere(2, radius=30)}
    for name, shape in complete.items():
        write_shape(root / "null" / f"{name}.off", shape)
    for name, partner, n_faces in (
        ("cuts_cat_shape_1", "cat", 60),
        ("cuts_dog_shape_1", "dog", 90),
        ("cuts_dog_2", "dog", 40),
    ):
        whole = complete[partner]
        middles = whole.points[whole.faces].mean(axis=1)
        triangles = np.argsort(middles[:, 2])[:n_faces]
        weights = rng.dirichlet([1, 1, 1], size=n_faces)
        points = np.einsum("ij,ijk->ik", weights, whole.points[whole.faces[triangles]])
        faces = np.stack([np.arange(n_faces), np.roll(np.arange(n_faces), 1), np.roll(np.arange(n_faces), 2)], axis=1)
        write_shape(root / "cuts" / f"{name}.off", Shape(points, faces))
        write_rows(root / "cuts" / f"{name}.baryc_gt", np.column_stack([triangles + 1, weights]))
        known[name] = (partner, triangles, weights)
    return root, known


@pytest.fixture
def clouds_set(tmp_path: Path) -> tuple[Path, dict[str, np.ndarray]]:
    """Three clouds of 50 points laid out as the lungs are: row i is the same point in each, and in no other place."""
    root, rng = tmp_path / "clouds", np.random.default_rng(1)
    root.mkdir()
    base = rng.standard_normal((50, 3)) * [10, 20, 30]
    clouds = {}
    for number, name in enumerate(("A", "B", "C")):
        clouds[name] = base * (1 + 0.1 * number) + number
        rows = "".join(",".join(f"{value:.17g}" for value in row) + "\n" for row in clouds[name])
        (root / f"landmarks{name}.csv").write_text("# x,y,z\n" + rows)
    return root, clouds


@pytest.fixture(scope="session")
def benchmark_set(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """``benchmark_set("FAUST_r")``: below ``HOMOLOG_BENCHMARKS``, or unpacked from ``../shared/data``."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    unpacked = Path(os.environ.get("HOMOLOG_BENCHMARKS") or tmp_path_factory.mktemp("benchmarks"))

    def folder(name: str) -> Path:
        if not (unpacked / name).is_dir():
            archive = beside / f"{name}.tar.xz"
            if "HOMOLOG_BENCHMARKS" in os.environ or not archive.is_file():
                pytest.skip(f"no {name} at {unpacked} or {archive}; set HOMOLOG_BENCHMARKS")
            with tarfile.open(archive) as tar:
                tar.extractall(unpacked, filter="data")
        return unpacked / name

    return folder


@pytest.fixture(scope="session")
def reference() -> Path:
    """The folder of reference numbers: ``HOMOLOG_REFERENCE``, or ``../shared/reference`` beside the checkout."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "reference"
    folder = Path(os.environ.get("HOMOLOG_REFERENCE", beside))
    if not (folder / "faust_080_091.npz").is_file():
        pytest.skip(f"no reference numbers at {folder}; set HOMOLOG_REFERENCE")
    return folder


@pytest.fixture(scope="session")
def faust(reference: Path) -> dict[str, np.ndarray]:
    """The published code's numbers for one pair of FAUST_r."""
    with np.load(reference / "faust_080_091.npz") as stored:
        return {name: stored[name] for name in stored.files}


@pytest.fixture(scope="session")
def stored_operators(faust: dict[str, np.ndarray]) -> Callable[[str], Operators]:
    """Operators as the published code used them: ``stored_operators("x_mesh")``."""

    def build(which: str) -> Operators:
        n = len(faust[f"{which}_mass"])

        def matrix(name: str) -> torch.Tensor:
            rows, columns = faust[f"{which}_{name}_ij"]
            whole = sparse.csr_matrix((faust[f"{which}_{name}_v"], (rows, columns)), shape=(n, n))
            return compressed_rows(*(torch.from_numpy(part) for part in (whole.indptr, whole.indices, whole.data)))

        return Operators(
            points=torch.from_numpy(faust[f"{which[0]}_vertices"]),
            mass=torch.from_numpy(faust[f"{which}_mass"]),
            eigenvalues=torch.from_numpy(faust[f"{which}_evals"]),
            eigenvectors=torch.from_numpy(faust[f"{which}_evecs"]),
            laplacian=matrix("laplacian"),
            gradient_x=matrix("gradX"),
            gradient_y=matrix("gradY"),
            centre=torch.zeros(3, dtype=torch.float64),
            scale=1.0,
            method="stored",
        )

    return build
