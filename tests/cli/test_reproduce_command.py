"""``homolog reproduce`` on a few blobs in place of FAUST_r."""

import json
import shlex

import numpy as np
import pytest

from homolog.reproduction import experiment_names, pictures
from homolog.shapes import Shape, write_shape


@pytest.fixture
def data(tmp_path, make, monkeypatch):
    """A folder with three shapes at FAUST_r, and with nothing else."""
    monkeypatch.setattr(pictures, "_WIDTH", 100)
    monkeypatch.chdir(tmp_path)
    for name in ("off", "corres"):
        (tmp_path / "data" / "FAUST_r" / name).mkdir(parents=True)
    for number in range(3):
        order = np.random.default_rng(number).permutation(make.blob(2).n_points)
        shape = make.relabelled(make.blob(2), order)
        shape = Shape(shape.points * [1 + 0.2 * number, 1, 1], shape.faces)
        name = f"tr_reg_{number:03}"
        write_shape(tmp_path / "data" / "FAUST_r" / "off" / f"{name}.off", shape)
        rows = "\n".join(map(str, np.argsort(order) + 1))
        (tmp_path / "data" / "FAUST_r" / "corres" / f"{name}.vts").write_text(rows)
    return tmp_path / "data"


def test_the_list(homolog):
    ended = homolog("reproduce", "--list")
    assert ended.code == 0
    heads, *rows = [line.split("\t") for line in ended.out.splitlines()]
    assert heads == ["name", "title", "rows", "data", "trainings, minutes"]
    assert [row[0] for row in rows] == list(experiment_names())
    (complete,) = [row for row in rows if row[0] == "complete"]
    assert complete[2:] == ["9", "FAUST_r, SCAPE_r, SHREC19", "faust 60, scape 50, faust_scape 65"]


@pytest.mark.slow
def test_from_files_to_a_table(homolog, data, tmp_path):
    """What each cell's own command prints is the cell's figure; the second run makes nothing."""
    options = ("reproduce", "complete", "--data", data, "--weights", "people", "-n", 2, "--device", "cpu")
    ended = homolog(*options, "--only", "_r, mesh", "--only", "FAUST_r, noisy")
    assert (ended.code, ended.out) == (0, "reproduced/report.md\n"), ended
    said = ended.err.splitlines()
    assert "2 cells stay empty" in said[-2]
    assert f"{data} has no folder SCAPE_r; get it from" in said[-2]
    assert said[-1] == "4 cells made, 0 were there."
    cells = [json.loads(file.read_text()) for file in (tmp_path / "reproduced" / "complete" / "cells").iterdir()]
    assert len(cells) == 4
    for cell in cells:
        figures = homolog(*shlex.split(cell["command"])[1:], "--json", "-")
        assert json.loads(figures.out)["mean_geodesic_error"] == pytest.approx(cell["figures"]["mean"], rel=1e-6)
    again = homolog(*options, "--only", "FAUST_r, mesh")
    assert again.err.splitlines()[-1] == "0 cells made, 2 were there."
    quiet = homolog(*options, "--only", "FAUST_r, mesh", "--quiet")
    assert (quiet.code, quiet.out, quiet.err) == (0, "", "")


@pytest.mark.slow
def test_the_folder_of_results_may_lie_in_that_of_the_data(homolog, data):
    """What the command wrote there itself is not taken for an input that would be replaced."""
    for n_pairs in (1, 2):
        options = ("--weights", "people", "-n", n_pairs, "--only", "FAUST_r, mesh", "-o", data / "out")
        assert homolog("reproduce", "complete", "--data", data, *options).code == 0
    assert len(list((data / "out" / "complete" / "cells").iterdir())) == 4


MISTAKES = {
    "no name": ((), "NAME is missing, but must be one of ablation"),
    "name": (("complet", "--data", "data"), "NAME is 'complet', but must be one of"),
    "no data": (("complete",), "--data is missing; give the folder that holds FAUST_r, SCAPE_r, SHREC19"),
    "data": (("complete", "--data", "nowhere"), "nowhere: there is no such folder"),
    "row": (("complete", "--data", "data", "--only", "horse"), "--only is 'horse', but must be one of FAUST_r, mesh"),
    "weights": (("complete", "--data", "data", "--weights", "nobody"), "there are no weights 'nobody'"),
    "both": (("complete", "--data", "data", "--weights", "people", "--train"), "but --train is given, too"),
    "set": (("complete", "--data", "data", "--set", "steps"), "--set is 'steps', but must be SECTION.KEY=VALUE"),
    "pairs": (("complete", "--data", "data", "-n", "0"), "-n"),
    "output": (("complete", "--data", "data", "-o", "full", "--weights", "people"), "full holds other things"),
    "nothing": (("complete", "--data", "data"), "no cell of complete can be made: the training faust is not there"),
    "empty": (("partial", "--data", "data"), "data has no folder SHREC16; get it from"),
    "key": (
        ("complete", "--data", "data", "--train", "--set", "training.stepps=2"),
        "[training] has an unknown key 'stepps'; did you mean 'steps'?",
    ),
    "section": (("complete", "--data", "data", "--train", "--set", "name.steps=2"), "name.steps"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line(homolog, data, tmp_path, mistake):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "letter.txt").write_text("dear")
    arguments, said = MISTAKES[mistake]
    ended = homolog("reproduce", *arguments, "-q")
    assert ended.is_one_line_of_complaint(), ended
    assert said in ended.err
    assert not (tmp_path / "reproduced").exists()
    assert [file.name for file in (tmp_path / "full").iterdir()] == ["letter.txt"]


@pytest.mark.slow
def test_evaluation_without_stages(homolog, data):
    """As matchers without these settings."""
    from homolog import Matcher, MatcherSettings
    from homolog.datasets import ShapeFolder
    from homolog.evaluation import Protocol, evaluate

    ended = homolog("evaluate", data / "FAUST_r", "--method", "axiomatic", "--no-refinement", "--json", "-")
    matcher = Matcher(settings=MatcherSettings(method="axiomatic", refinement=None))
    expected = evaluate(matcher, ShapeFolder.open(data / "FAUST_r"), Protocol()).to_dict()
    told = json.loads(ended.out)
    assert told["mean_geodesic_error"] == pytest.approx(expected["mean_geodesic_error"], rel=1e-6)
    assert told["settings"]["refinement"] is None
    assert told["settings"]["alignment"] is not None
    none = homolog("evaluate", data / "FAUST_r", "--method", "axiomatic", "--no-alignment", "--json", "-")
    assert json.loads(none.out)["settings"]["alignment"] is None
    refused = homolog("evaluate", data / "FAUST_r", "--maps", data, "--no-refinement")
    assert refused.is_one_line_of_complaint()
    assert "--refinement has no effect" in refused.err
