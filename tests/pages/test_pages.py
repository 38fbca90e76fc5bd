"""Every shell and Python block of the README and of the site's tutorials and gallery runs, in order, page by page.

Blocks of a page share a folder, and those in Python their names. A block of text after one is what it prints: the same
words, and numbers that are about the same, as they differ between machines; where there is a ``...``, it stands for
anything.
What a page takes for given, such as a reader's own scan, lies in the folder beforehand.
"""

import contextlib
import doctest
import io
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import SimpleITK
import trimesh
from command_server import read_short_recipe
from sybil.document import Document
from sybil.evaluators.python import PythonEvaluator
from sybil.parsers.markdown import CodeBlockParser

from homolog import training
from homolog.datasets import read_description
from homolog.features import DiffusionNet, FeatureInfo, NetworkSettings, save_weights
from homolog.shapes import Shape, write_shape
from homolog.training import read_recipe

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [
    ROOT / "README.md",
    *(DOCS / f"{name}.md" for name in ("index", "matching", "method", "conventions", "training", "data", "extending")),
    *(DOCS / f"{name}.md" for name in ("serving", "symmetry")),
    *sorted((DOCS / "tutorials").glob("*.md")),
]
SHELLS = ("sh", "bash", "console", "shell")
HERE = Path(__file__).parent
# What blocks call beside homolog; what would set up whole environments is only looked at.
PROGRAMS = {
    "pip": f'exec "{sys.executable}" "{HERE / "check_pip.py"}" "$@"',
    "python": f'exec "{sys.executable}" "$@"',
    "make": f'exec "{shutil.which("make")}" --directory "{ROOT}" --dry-run "$@" > /dev/null',
    "tensorboard": 'test "$1" = --logdir && ls "$2" | grep -q events',
}
OUTPUT = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
NUMBER = re.compile(r"\d+(?:\.\d+)?")


def looks_like(printed, expected):
    """Whether words are the same, and numbers within a fifth or a unit of their last digit."""
    same = doctest.OutputChecker().check_output
    if "..." in expected:
        return same(expected, printed, OUTPUT)
    units = [10.0 ** -len(number.partition(".")[2]) for number in NUMBER.findall(expected)]
    wanted, found = ([float(number) for number in NUMBER.findall(text)] for text in (expected, printed))
    about = len(found) == len(wanted) and np.allclose(found, wanted, rtol=0.2, atol=units if units else 0)
    return about and same(NUMBER.sub("0", expected), NUMBER.sub("0", printed), OUTPUT)


def write_program(file, command):
    file.write_text(f"#!/bin/sh\n{command}\n")
    file.chmod(0o755)


@pytest.fixture(scope="module")
def programs(tmp_path_factory):
    """A folder of the programs that blocks call, and a process that runs ``homolog`` for them."""
    folder = tmp_path_factory.mktemp("programs")
    for name, command in PROGRAMS.items():
        write_program(folder / name, command)
    place = folder / "socket"
    # -S -E: it needs nothing but the standard library, and starts at once.
    write_program(folder / "homolog", f'exec "{sys.executable}" -S -E "{HERE / "call_homolog.py"}" "{place}" "$@"')
    server = subprocess.Popen([sys.executable, str(HERE / "command_server.py"), str(place)])
    try:
        wait_for(place, server)
        yield folder
    finally:
        server.terminate()
        server.wait()


def wait_for(place, server):
    while not place.exists():
        assert server.poll() is None, "the process that runs homolog for the pages has ended"
        time.sleep(0.1)


class Reader:
    """Someone who types a page's blocks one after the other, and looks at what they print."""

    def __init__(self, programs):
        self.programs = programs
        self.printed = ""

    def shell(self, block):
        environment = {
            **os.environ,
            "PATH": f"{self.programs}{os.pathsep}{os.environ['PATH']}",
            "PYTHONPATH": os.pathsep.join(filter(None, (str(ROOT / "src"), os.environ.get("PYTHONPATH")))),
            "COLUMNS": "100",
        }
        ended = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", block.parsed],
            capture_output=True,
            text=True,
            env=environment,
            stdin=subprocess.DEVNULL,
            timeout=300,
            check=False,
        )
        assert ended.returncode == 0, f"{block.path}:{block.line} ends with {ended.returncode}\n{ended.stderr}"
        self.printed = ended.stdout

    def python(self, block):
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            PythonEvaluator()(block)
        self.printed = printed.getvalue()

    def toml(self, block):
        """A file that later blocks may use: a dataset's description or a recipe, called by its title or name."""
        table = tomllib.loads(block.parsed)
        name = table.get("title", table.get("name"))
        if name is None:
            return
        file = Path(f"{name.lower()}.toml")
        file.write_text(block.parsed)
        read = read_description if "title" in table else read_recipe
        read(str(file))

    def look(self, block):
        expected = str(block.parsed)
        if not looks_like(self.printed, expected):
            pytest.fail(f"{block.path}:{block.line} shows\n{expected}\nbut it prints\n{self.printed}")

    def read(self, page):
        parsers = [
            *(CodeBlockParser(shell, self.shell) for shell in SHELLS),
            CodeBlockParser("python", self.python),
            CodeBlockParser("toml", self.toml),
            CodeBlockParser("text", self.look),
        ]
        for block in Document.parse(str(page), *parsers).examples():
            block.evaluate()


def give_for_readme(folder, make):
    """What the README takes for given: the checkout, and files of the reader's own."""
    for name in ("src", "results"):
        (folder / name).symlink_to(ROOT / name)
    body = trimesh.load(ROOT / "src" / "homolog" / "demo_data" / "off" / "boris.off", process=False)
    body.visual.vertex_colors = np.full((len(body.vertices), 4), 200, dtype=np.uint8)
    body.export(folder / "scan.ply")
    body.export(folder / "template.obj")
    for name, axis in (("front.ply", 2), ("side.ply", 0)):
        body.submesh([body.face_normals[:, axis] > 0.1], append=True).export(folder / name)
    give_blobs(folder, make)
    ball = np.linalg.norm(np.indices((24, 24, 24)) - 11.5, axis=0) < 9
    SimpleITK.WriteImage(SimpleITK.GetImageFromArray(3 * ball.astype(np.uint8)), folder / "lungs.mhd")
    (folder / "lungs").mkdir()
    np.savetxt(folder / "lungs" / "one.csv", make.blob(4).points, delimiter=",", header="x,y,z", comments="")


def give_blobs(folder, make):
    """Small shapes of one kind, for training and in the layout of a benchmark."""
    for kind in ("scans", "FAUST_r/off", "FAUST_r/corres"):
        (folder / kind).mkdir(parents=True)
    shape = make.blob(3)
    for name in ("horse.ply", "template.ply", "scans/one.ply"):
        write_shape(folder / name, shape)
    for number in range(6):
        blob = Shape(shape.points * [1, 1 + 0.1 * number, 1], shape.faces)
        write_shape(folder / "scans" / f"{number}.off", blob)
        if number < 2:
            write_shape(folder / "FAUST_r" / "off" / f"{number}.off", blob)
            lines = "\n".join(map(str, range(1, shape.n_points + 1)))
            (folder / "FAUST_r" / "corres" / f"{number}.vts").write_text(lines)


def give_weights(file, **info):
    """Small weights, for shapes in any pose."""
    network = DiffusionNet(NetworkSettings(width=16, blocks=1, out_channels=16))
    save_weights(file, network, FeatureInfo(upright=False, n_eigenpairs=30, map_eigenpairs=10, **info))


def blobs(make, count, *, subdivisions=3):
    """Shapes of one kind, each stretched a little more than the one before, and numbered alike."""
    shape = make.blob(subdivisions)
    return [Shape(shape.points * [1, 1 + 0.05 * number, 1], shape.faces) for number in range(count)]


def give_for_training(folder, make):
    """Meshes, clouds, and two files of each to match."""
    for name in ("scans", "lungs"):
        (folder / name).mkdir()
    for number, shape in enumerate(blobs(make, 6)):
        write_shape(folder / "scans" / f"{number}.ply", shape)
        np.savetxt(folder / "lungs" / f"{number}.csv", shape.points, delimiter=",", header="x,y,z", comments="")
    for number, name in enumerate("ab"):
        shutil.copy(folder / "scans" / f"{number}.ply", folder / f"{name}.ply")
        shutil.copy(folder / "lungs" / f"{number}.csv", folder / f"{name}.csv")


def give_for_data(folder, make):
    """Cuts in the layout of a benchmark, a dataset of one's own, and weights for both."""
    give_weights(folder / "cuts.safetensors", partial=True)
    give_weights(folder / "teeth.safetensors")
    give_cuts(folder / "SHREC16", make)
    for place in ("scans", "points"):
        (folder / "my_teeth" / place).mkdir(parents=True)
    for number, shape in enumerate(blobs(make, 12, subdivisions=2)):
        write_shape(folder / "my_teeth" / "scans" / f"tooth_{number}.ply", shape)
        lines = range(1, shape.n_points + 1)
        np.savetxt(folder / "my_teeth" / "points" / f"tooth_{number}.vts", lines, fmt="%d")


def give_cuts(folder, make):
    """Each full shape with the part of it on one side of a plane, whose true points are corners of its faces."""
    for place in ("null", "cuts"):
        (folder / place).mkdir(parents=True)
    names = read_description("shrec16_cuts").full_names
    for name, full in zip(names, blobs(make, len(names)), strict=True):
        kept = np.flatnonzero(full.points[:, 0] > -0.2)
        index = np.full(full.n_points, -1)
        index[kept] = np.arange(len(kept))
        faces = index[full.faces]
        write_shape(folder / "null" / f"{name}.off", full)
        part = Shape(full.points[kept], faces[(faces >= 0).all(axis=1)])
        write_shape(folder / "cuts" / f"cuts_{name}_shape_1.off", part)
        at, corner = zip(*(np.argwhere(full.faces == point)[0] for point in kept), strict=True)
        rows = np.column_stack([np.array(at) + 1, np.eye(3, dtype=int)[list(corner)]])
        np.savetxt(folder / "cuts" / f"cuts_{name}_shape_1.baryc_gt", rows, fmt="%d")


GIVEN = {
    "README.md": give_for_readme,
    "matching.md": give_for_readme,
    "symmetry.md": give_for_readme,
    "training.md": give_for_training,
    "data.md": give_for_data,
}


@pytest.mark.pages
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_blocks_run(page, programs, make, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(training, "read_recipe", read_short_recipe)
    if page.name in GIVEN:
        GIVEN[page.name](tmp_path, make)
    Reader(programs).read(page)


@pytest.mark.parametrize(
    ("printed", "expected", "alike"),
    [
        ("2.1 and 40 of a\n", "2.0 and 41 of a", True),
        ("2.1 and 40 of b\n", "2.0 and 41 of a", False),
        ("2.9 of a\n", "2.0 of a", False),
        ("2.9 of a\n", "2... of a", True),
        ("3 a\n", "a", False),
    ],
)
def test_what_looks_alike(printed, expected, alike):
    assert looks_like(printed, expected) == alike


@pytest.mark.parametrize(
    "package", sorted(path.parent.name for path in (ROOT / "src" / "homolog").glob("*/__init__.py"))
)
def test_every_package_is_in_the_reference(package):
    if package != "cli":  # the commands have a page of their own
        assert f"::: homolog.{package}\n" in (DOCS / "api" / f"{package}.md").read_text(encoding="utf-8")
        assert f"api/{package}.md" in (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
