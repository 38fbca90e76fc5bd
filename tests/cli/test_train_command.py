"""``homolog train``."""

import json
import sys

import pytest

from homolog.shapes import write_shape


@pytest.fixture
def data(tmp_path, make):
    """Three small meshes in a plain folder."""
    for number in range(3):
        shape = make.blob(2)
        (tmp_path / "data").mkdir(exist_ok=True)
        write_shape(
            tmp_path / "data" / f"m{number}.ply", type(shape)(shape.points * [1 + 0.1 * number, 1, 1], shape.faces)
        )
    return tmp_path / "data"


TINY = """
name = "tiny"
samples = {points = 100, subsets = 1}
network = {width = 8, blocks = 1, out_channels = 8}
operators = {n_eigenpairs = 16}
loss = {map_eigenpairs = 8}
training = {steps = 2}
orienter = {steps = 2}
validation = {shapes = 0, pairs = 1}
"""


@pytest.fixture
def recipe(tmp_path):
    """A recipe of two steps."""
    (tmp_path / "tiny.toml").write_text(TINY)
    return tmp_path / "tiny.toml"


def test_from_meshes_to_weights_that_match(homolog, data, recipe, tmp_path):
    run = tmp_path / "run"
    ended = homolog("train", data, "-o", run, "--recipe", recipe, "--device", "cpu")
    assert (ended.code, ended.out) == (0, f"{run / 'weights.safetensors'}\n")
    assert ended.err.startswith("Trained 2 steps")
    weights = run / "weights.safetensors"
    matched = homolog("match", data / "m0.ply", data / "m1.ply", "-o", tmp_path / "out", "--weights", weights, "-q")
    assert matched.code == 0, matched
    again = homolog("train", data, "-o", run, "--recipe", recipe, "--device", "cpu")
    assert again.is_one_line_of_complaint()
    assert "--resume" in again.err
    assert homolog("train", data, "-o", run, "--recipe", recipe, "--device", "cpu", "--resume", "-q").code == 0


def test_parts_of_a_set_by_its_name(homolog, parts_set, recipe, tmp_path):
    """The set's description says where parts lie, and which axis is up."""
    root, _ = parts_set
    options = "--recipe", recipe, "--dataset", "shrec16_cuts", "-o", tmp_path / "run", "--device", "cpu", "-q"
    ended = homolog("train", root, *options)
    assert ended.is_one_line_of_complaint()
    assert "shrec16_cuts is a dataset of partial shapes, but the recipe 'tiny' has no section [partial]" in ended.err
    recipe.write_text(TINY.replace("100", "0") + "[partial]\n")
    assert homolog("train", root, *options).code == 0
    told = json.loads((tmp_path / "run" / "report.json").read_text())["recipe"]
    assert told["data"]["up"] == "z"
    assert told["partial"] == {"full": "null", "parts": "cuts", "pre_aligned": True}
    recipe.write_text(TINY + '[partial]\nparts = "holes"\n')
    ended = homolog("train", root, *options)
    assert "[partial] parts is 'holes', but shrec16_cuts has 'cuts'; leave it out of the recipe" in ended.err


def test_quiet_and_verbose(homolog, data, recipe, tmp_path, caplog):
    quiet = homolog("train", data, "-o", tmp_path / "one", "--recipe", recipe, "--quiet")
    assert (quiet.code, quiet.out, quiet.err) == (0, "", "")
    assert homolog("train", data, "-o", tmp_path / "two", "--recipe", recipe, "--verbose").code == 0
    assert "step 2: validation/bijectivity" in caplog.text


MISTAKES = {
    "recipe": (lambda d, r, t: [d, "--recipe", "qick", "-o", t / "run"], "did you mean 'quick'?"),
    "data": (lambda d, r, t: [t / "gone", "--recipe", r, "-o", t / "run"], "no such folder"),
    "no data": (lambda d, r, t: ["--recipe", r, "-o", t / "run"], "DATA"),
    "no output": (lambda d, r, t: [d, "--recipe", r], "--output"),
    "dataset": (lambda d, r, t: [d, "--dataset", "fasut_r", "-o", t / "run"], "did you mean 'faust_r'?"),
    "place": (lambda d, r, t: [d, "--recipe", r, "-o", r], "cannot be made a folder"),
    "processes": (lambda d, r, t: [d, "--recipe", r, "-o", t / "run", "--processes", "0"], "--processes"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line(homolog, data, recipe, tmp_path, mistake):
    arguments, said = MISTAKES[mistake]
    ended = homolog("train", *arguments(data, recipe, tmp_path))
    assert ended.is_one_line_of_complaint(), ended
    assert said in ended.err
    assert not (tmp_path / "run").exists()


def test_an_unknown_key_is_one_line(homolog, data, recipe, tmp_path):
    recipe.write_text(TINY.replace("steps", "stepps"))
    ended = homolog("train", data, "-o", tmp_path / "run", "--recipe", recipe)
    assert ended.is_one_line_of_complaint()
    assert "[training] has an unknown key 'stepps'; did you mean 'steps'?" in ended.err


@pytest.mark.parametrize("package", ["lightning_fabric", "tensorboard"])
def test_a_missing_package_is_one_line(homolog, data, recipe, tmp_path, monkeypatch, package):
    monkeypatch.setitem(sys.modules, package, None)
    ended = homolog("train", data, "-o", tmp_path / "run", "--recipe", recipe)
    assert ended.is_one_line_of_complaint()
    assert "pip install 'homolog[train]'" in ended.err
    assert not (tmp_path / "run").exists()


def test_weights_to_begin_with(homolog, data, recipe, tmp_path):
    ended = homolog(
        "train", data, "-o", tmp_path / "run", "--recipe", recipe, "--weights", tmp_path / "none.safetensors"
    )
    assert ended.is_one_line_of_complaint()
    assert "none.safetensors" in ended.err
