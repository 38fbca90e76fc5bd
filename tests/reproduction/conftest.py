"""Small experiments in place of the paper's, and datasets of a few blobs to run them on."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from homolog.reproduction import experiments, pictures, reproduce
from homolog.shapes import Shape, write_shape

NAMES = ("ape", "bee", "cat", "dog")
DESCRIPTION = """
title = "Blobs"
split = "last"
n_test = 2
pairs = "every"
"""
RECIPE = """
name = "small"
upright = false
samples = {points = 100, subsets = 1}
network = {width = 8, blocks = 1, out_channels = 8}
operators = {n_eigenpairs = 16}
loss = {map_eigenpairs = 8}
training = {steps = 3}
validation = {shapes = 0, pairs = 1}
"""
TRAININGS = """
[small]
recipe = "RECIPE"
data = ["blobs"]
minutes = 1

[small_no_contrast]
recipe = "RECIPE"
data = ["blobs"]
changes = {"loss.infonce" = 0.0}

[small_supervised]
recipe = "RECIPE"
data = ["blobs"]
first = 2
changes = {"loss.supervised" = 1.0}

[small_both]
recipe = "RECIPE"
data = ["blobs", "more"]
"""
EXPERIMENTS = {
    "plain": """
title = "Blobs without weights"
about = "Two blobs."
rows = [
  {name = "blobs, mesh", data = "blobs", method = "axiomatic", paper = 2.0},
  {name = "blobs, noisy cloud", data = "blobs", method = "axiomatic", modality = "cloud", noise = 0.01},
  {name = "gone, mesh", data = "gone", method = "axiomatic", paper = 3.14},
]
""",
    "learned": """
title = "Blobs with weights"
about = "Two blobs."
rows = [
  {name = "all losses", data = "blobs", training = "small"},
  {name = "without contrast", data = "blobs", training = "small_no_contrast", trained_only = true},
]
""",
    "shared": """
title = "Noise"
about = "Two blobs."
axis = "noise"
rows = [
  {name = "noise 0", data = "blobs", training = "small", modality = "cloud", curve = "blobs"},
  {name = "noise 0.02", data = "blobs", training = "small", modality = "cloud", noise = 0.02, curve = "blobs"},
]
""",
    "together": """
title = "Two sets"
about = "Trained on two sets."
rows = [{name = "both", data = "more", training = "small_both"}]
""",
    "taught": """
title = "By ground truth"
about = "Trained on the first two shapes."
rows = [{name = "taught", data = "blobs", training = "small_supervised"}]
""",
    "compared": """
title = "Baselines"
about = "Two blobs."
columns = ["ours", "axiomatic", "dpfm"]
rows = [{name = "blobs, mesh", data = "blobs", training = "small"}]
""",
    "meshed": """
title = "Other triangles"
about = "Two blobs, meshed anew."
rows = [{name = "blobs, meshed anew", data = "blobs_anew", method = "axiomatic"}]
""",
    "parts_of_it": """
title = "Some shapes"
about = "Pairs whose second shape has this name."
rows = [{name = "to dogs", data = "blobs", method = "axiomatic", names = "d?g"}]
""",
}


def write_blobs(root: Path, make, *, bend: float = 0.0) -> None:
    """``off/`` and ``corres/`` of four blobs, two of them for tests; each has its points in an order of its own."""
    (root / "off").mkdir(parents=True)
    (root / "corres").mkdir()
    blob = make.blob(2)
    for number, name in enumerate(NAMES):
        order = np.random.default_rng(number).permutation(blob.n_points)
        shape = make.relabelled(blob, order)
        stretched = Shape(shape.points * [1 + 0.4 * number, 1 + bend, 1 - 0.2 * number], shape.faces)
        write_shape(root / "off" / f"{name}.off", stretched)
        (root / "corres" / f"{name}.vts").write_text("\n".join(map(str, np.argsort(order)[:100] + 1)))


@pytest.fixture(scope="module")
def templates(tmp_path_factory, make):
    """A folder with two datasets of blobs, and one of the experiments above."""
    root = tmp_path_factory.mktemp("templates")
    place = root / "definitions"
    (place / "experiments").mkdir(parents=True)
    (place / "blobs.toml").write_text(DESCRIPTION)
    (place / "small.toml").write_text(RECIPE)
    described = (place / "blobs.toml").as_posix()
    (place / "data.toml").write_text(
        "\n".join(f'[{name}]\ndataset = "{described}"' for name in ("blobs", "more"))
        + '\n[blobs_anew]\ndataset = "own"\nmade_from = "blobs"'
        + f'\n[gone]\ndataset = "{described}"\nsource = "ask for it"\nfolders = ["gone", "lost"]\n'
    )
    (place / "trainings.toml").write_text(TRAININGS.replace("RECIPE", (place / "small.toml").as_posix()))
    for name, text in EXPERIMENTS.items():
        (place / "experiments" / f"{name}.toml").write_text(text)
    write_blobs(root / "data" / "blobs", make)
    write_blobs(root / "data" / "more", make, bend=0.2)
    return root


@pytest.fixture
def data(tmp_path, templates, monkeypatch):
    """A folder with two datasets of blobs, and the experiments above in place of the paper's."""
    caches = experiments.read_experiment, experiments.trainings, experiments.data_places
    for cached in caches:
        cached.cache_clear()
    monkeypatch.setattr(experiments, "_FOLDER", templates / "definitions" / "experiments")
    monkeypatch.setattr(pictures, "_WIDTH", 100)
    shutil.copytree(templates / "definitions", tmp_path / "definitions")
    shutil.copytree(templates / "data", tmp_path / "data")
    yield tmp_path / "data"
    for cached in caches:
        cached.cache_clear()


@pytest.fixture
def output(tmp_path):
    """Where results go."""
    return tmp_path / "out"


@pytest.fixture
def ready(data, output, templates):
    """The output of the experiment ``plain`` on the data, which is run once for all tests of a file."""
    if not (templates / "out").exists():
        reproduce("plain", data, templates / "out")
    shutil.copytree(templates / "out", output)
    return output
