"""The package as a whole: what it exports, what it imports, and who may import whom."""

import ast
import importlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import homolog
from homolog.core.threads import other_running_threads

ROOT = Path(homolog.__file__).parent
MODULES = sorted(path for path in ROOT.rglob("*.py"))

# Floor by floor, what each part may import of homolog. Modules of `core`, the ground, are floors of their own.
CORE = {
    "core.messages": set(),
    "core.errors": {"core.messages"},
    "core.versions": set(),
    "core.choices": set(),
    "core.lazy": set(),
    "core.threads": set(),
    "core.progress": set(),
    "core.reprs": set(),
    "core.plugins": {"core.errors"},
    "core.arguments": {"core.errors"},
    "core.memory": {"core.errors", "core.arguments"},
    "core.arrays": {"core.errors"},
    "core.files": {"core.errors"},
    "core.reasons": {"core.messages"},
    "core.unchanged": {"core.errors"},
    "core.records": {"core.errors", "core.files", "core.reasons", "core.versions"},
    "core.ends": {"core.files"},
    "core.settings": {"core.errors", "core.files", "core.messages", "core.reasons", "core.records"},
    "core.array_files": {"core.files", "core.memory", "core.messages", "core.reasons"},
    "core.reader_child": set(),
    "core.reader_process": {"core.memory"},
    "core.tensors": {"core.files"},
    "core.caches": {"core.errors", "core.files"},
    "core.pretrained": {"core.errors", "core.files"},
    "core.folders": {"core.errors", "core.files", "core.records"},
    "core.plots": {"core.errors", "core.files"},
    "core.method_names": {"core.plugins"},
    "core.cluster": {"core.errors", "core.files", "core.arguments", "core.ends", "core.versions"},
    "core.tasks": {"core.errors", "core.progress", "core.ends", "core.arguments", "core.cluster"},
    "core": set(),
}
GROUND = set(CORE)
BENEATH_MATCHING = {"shapes", "geometry", "maps", "features", "pairs", "methods"}
BENEATH_EVALUATION = BENEATH_MATCHING | {"matching", "datasets"}
FLOORS = CORE | {
    "shapes": GROUND,
    "geometry": GROUND | {"shapes"},
    "maps": GROUND | {"shapes", "geometry"},
    "features": GROUND | {"shapes", "geometry", "maps"},
    "pairs": GROUND | {"shapes", "geometry", "maps", "features", "volumes"},
    "methods": GROUND | {"shapes", "geometry", "maps", "features", "pairs"},
    "matching": GROUND | BENEATH_MATCHING,
    "transfer": GROUND | {"shapes", "geometry", "maps", "pairs", "matching", "volumes"},
    "testing": GROUND | BENEATH_MATCHING | {"matching"},
    "datasets": GROUND | {"shapes"},
    "volumes": GROUND | {"shapes", "geometry"},
    "synthesis": GROUND | {"shapes", "geometry", "datasets"},
    "evaluation": GROUND | BENEATH_EVALUATION | {"statistics", "synthesis"},
    "training": GROUND | BENEATH_EVALUATION | {"synthesis", "evaluation"},
    "viewing": GROUND | {"shapes", "geometry", "pairs", "matching", "datasets", "evaluation"},
    "serving": GROUND | {"shapes", "pairs", "matching", "viewing"},
    "statistics": GROUND | {"geometry"},
    "shape_models": GROUND
    | {"shapes", "geometry", "features", "maps", "pairs", "matching"}
    | {"transfer", "viewing", "statistics", "training"}
    | {"symmetries"},
    "symmetries": GROUND | {"shapes", "geometry", "pairs", "matching", "transfer", "statistics", "viewing"},
    "fitting": GROUND | {"shapes", "geometry", "maps", "matching", "synthesis"},
    "reproduction": GROUND | BENEATH_EVALUATION | {"evaluation", "training", "viewing", "synthesis", "volumes"},
    "cli": GROUND
    | BENEATH_EVALUATION
    | {
        "evaluation",
        "training",
        "reproduction",
        "synthesis",
        "volumes",
        "transfer",
        "viewing",
        "serving",
        "shape_models",
        "symmetries",
        "fitting",
    }
    | {"__init__"},
    "__main__": {"cli"},
    "__init__": GROUND
    | BENEATH_EVALUATION
    | {
        "evaluation",
        "training",
        "reproduction",
        "synthesis",
        "testing",
        "volumes",
        "transfer",
        "viewing",
        "serving",
        "shape_models",
        "statistics",
        "symmetries",
        "fitting",
    },
}
HEAVY = [
    "pyvista",
    "vtkmodules",
    "matplotlib",
    "anny",
    "pypcd4",
    "fast_simplification",
    "SimpleITK",
    "skimage",
    "xatlas",
    "PIL",
    "tensorboard",
    "lightning_fabric",
    "starlette",
    "uvicorn",
    "h5py",
]


def parsed(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def part_of(path):
    """The floor that a file belongs to: a package, a module beside the packages, or a module of ``core``."""
    return floor_of(".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"))


def floor_of(module):
    """The floor of a module whose dotted name begins below ``homolog``."""
    parts = module.split(".")
    return ".".join(parts[:2]) if parts[0] == "core" else parts[0]


def imported_parts(path):
    """Which parts of homolog a file imports, anywhere in it."""
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} has a relative import, which this test does not follow"
            module = node.module or ""
            names = [f"homolog.{alias.name}" for alias in node.names] if module == "homolog" else [module]
        else:
            continue
        for name in names:
            if name.split(".")[0] == "homolog":
                yield floor_of(name.split(".", 1)[1]) if "." in name else "__init__"


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_point_downward(path):
    part = part_of(path)
    assert part in FLOORS, f"say in FLOORS what {part} may import"
    beyond = set(imported_parts(path)) - FLOORS[part] - {part}
    assert not beyond, f"{path} must not import {sorted(beyond)}"


def test_floors_have_an_order():
    """The table itself must not allow a circle."""
    left = dict(FLOORS)
    while left:
        lowest = [part for part, below in left.items() if not below & set(left)]
        assert lowest, f"these import one another: {sorted(left)}"
        for part in lowest:
            del left[part]


def test_every_floor_is_there():
    assert {part_of(path) for path in MODULES} == set(FLOORS)


def test_exports():
    assert homolog.__all__ == sorted(homolog.__all__)
    assert len(set(homolog.__all__)) == len(homolog.__all__)
    for name in homolog.__all__:
        assert getattr(homolog, name) is not None
    for name in ("Matcher", "Shape", "read_shape", "Match", "HomologError"):
        assert name in homolog.__all__


@pytest.mark.parametrize("path", [path for path in MODULES if path.name == "__init__.py"], ids=part_of)
def test_packages_export_what_they_import(path):
    """``__all__`` names exactly what a package takes from its modules."""
    tree, package = parsed(path), ".".join(("homolog", *path.relative_to(ROOT).parts[:-1]))
    # Some import their public names for type checkers only, and find them when they are used.
    deferred = [node for block in tree.body if isinstance(block, ast.If) for node in block.body]
    imported = {
        alias.asname or alias.name
        for node in deferred or tree.body
        if isinstance(node, ast.ImportFrom) and node.module not in ("homolog", package)
        for alias in node.names
    }
    listed = [
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and node.targets[0].id == "__all__"
    ]
    assert set(listed[0] if listed else []) == imported


@pytest.mark.parametrize("path", [path for path in MODULES if path.name == "__init__.py"], ids=part_of)
def test_lazy_packages_say_where_each_name_is_from(path):
    """The table that is used agrees with what type checkers see."""
    package = importlib.import_module(".".join(("homolog", *path.relative_to(ROOT).parts[:-1])))
    if hasattr(package, "_MODULES"):
        assert set(package._MODULES) == set(package.__all__)
        for name, module in package._MODULES.items():
            found = importlib.import_module(f"{package.__name__}.{module}")
            assert getattr(package, name) is getattr(found, name)


@pytest.mark.process
def test_packages_are_attributes():
    """Without an import of their own; no other word is one."""
    on_disk = {path.parent.name for path in ROOT.glob("*/__init__.py")} - {"cli"}
    assert set(homolog._PACKAGES) == on_disk
    program = (
        "import homolog\nfor name in homolog._PACKAGES: assert getattr(homolog, name).__name__ == f'homolog.{name}'"
    )
    subprocess.run([sys.executable, "-c", program], timeout=120, check=True)
    with pytest.raises(AttributeError, match="has no attribute 'errors'"):
        _ = homolog.errors


CHANGES = """
import os
before = dict(os.environ)
import homolog
assert dict(os.environ) == before
homolog.read_shape, homolog.Matcher, homolog.synthesis
assert not {"OMP_WAIT_POLICY", "GOMP_SPINCOUNT", "THP_MEM_ALLOC_ENABLE"} & (os.environ.keys() - before.keys())
"""


@pytest.mark.process
def test_import_changes_no_environment_variable():
    """Nor does the use of what is imported then set those that ``tune_threads`` sets."""
    subprocess.run([sys.executable, "-c", CHANGES], timeout=120, check=True)


TUNED = {"OMP_WAIT_POLICY": "PASSIVE", "GOMP_SPINCOUNT": "10000", "THP_MEM_ALLOC_ENABLE": "1"}


@pytest.mark.parametrize(
    ("chosen", "expected"),
    [
        ({}, TUNED),
        ({"OMP_WAIT_POLICY": "ACTIVE"}, {"OMP_WAIT_POLICY": "ACTIVE", "THP_MEM_ALLOC_ENABLE": "1"}),
        ({"GOMP_SPINCOUNT": "7"}, TUNED | {"GOMP_SPINCOUNT": "7"}),
        ({"THP_MEM_ALLOC_ENABLE": "0"}, TUNED | {"THP_MEM_ALLOC_ENABLE": "0"}),
    ],
)
def test_tuning_leaves_what_the_user_has_chosen(monkeypatch, chosen, expected):
    for name in TUNED:
        monkeypatch.delenv(name, raising=False)
    for name, value in chosen.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("homolog.core.threads.other_running_threads", lambda: 0)
    homolog.tune_threads()
    assert {name: os.environ[name] for name in TUNED if name in os.environ} == expected
    for name in TUNED:  # monkeypatch knows of those alone that it has set itself
        os.environ.pop(name, None)


@pytest.mark.parametrize(
    ("others", "cores", "spins"), [(0, 1, "10000"), (1, 4, "10000"), (2, 4, "1000"), (9, 4, "1000")]
)
def test_threads_sleep_sooner_beside_others(monkeypatch, others, cores, spins):
    for name in TUNED:
        monkeypatch.setenv(name, "")  # so that it is set back
        monkeypatch.delenv(name)
    monkeypatch.setattr("homolog.core.threads.other_running_threads", lambda: others)
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    homolog.tune_threads()
    assert os.environ["GOMP_SPINCOUNT"] == spins


@pytest.mark.parametrize(
    ("told", "others"),
    [("1.20 0.95 0.80 3/412 9120\n", 2), ("0.00 0.00 0.00 0/80 1\n", 0), ("", 0), ("1.0 1.0 1.0 many 1", 0), (None, 0)],
)
def test_other_running_threads(tmp_path, told, others):
    if told is not None:
        (tmp_path / "loadavg").write_text(told)
    assert other_running_threads(tmp_path / "loadavg") == others


@pytest.mark.process
def test_the_command_tunes_before_anything_loads_torch():
    program = (
        "import os, sys, homolog.core.threads\n"
        "tune = homolog.core.threads.tune_threads\n"
        "homolog.core.threads.tune_threads = lambda: (print('torch' in sys.modules), tune())\n"
        "from homolog.cli.main import main\n"
        "sys.argv = ['homolog', 'doctor', '--torch']\n"
        "try: main()\n"
        "finally: print(os.environ['THP_MEM_ALLOC_ENABLE'])"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=True)
    lines = ended.stdout.splitlines()
    assert (lines[0], lines[-1]) == ("False", "1") and any("threads used" in line for line in lines)


def test_star_import():
    names = {}
    exec("from homolog import *", names)
    assert set(homolog.__all__) <= set(names)


@pytest.mark.process
def test_import_takes_no_extra_and_no_output():
    """What is heavy or optional is imported where it is used."""
    program = f"import sys, homolog, homolog.cli.main; print([name for name in {HEAVY!r} if name in sys.modules])"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "[]\n", "")


def test_typed():
    assert (ROOT / "py.typed").is_file()


def undocumented(nodes, where):
    """Public classes and functions without a docstring, methods included."""
    for node in nodes:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            if ast.get_docstring(node) is None:
                yield f"{where}.{node.name}"
            if isinstance(node, ast.ClassDef):
                yield from undocumented(node.body, f"{where}.{node.name}")


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_everything_public_has_a_docstring(path):
    tree = parsed(path)
    if path.name != "__main__.py":
        assert ast.get_docstring(tree)
    assert list(undocumented(tree.body, path.stem)) == []


def test_version_is_that_of_the_package():
    from homolog.core.versions import version_of, versions

    assert versions()["homolog"] == version_of("homolog") is not None
    assert version_of("no-such-package-as-this") is None
    assert homolog.__version__ == version_of("homolog")


def test_commit_and_machine_for_reports():
    from homolog.core.versions import commit, machine

    assert re.fullmatch(r".+, \d+ cores", machine())
    git, root = shutil.which("git"), ROOT.parents[1]
    if git is None or not (root / ".git").exists():
        assert commit() is None
        return
    told = subprocess.run([git, "-C", root, "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout
    assert told.startswith(commit().removesuffix("-dirty"))
    assert len(commit()) >= 10


@pytest.mark.process
def test_lazy_names_are_listed():
    program = "import homolog; print(*dir(homolog))"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=True)
    assert {*homolog.__all__, "__version__"} <= set(ended.stdout.split())
