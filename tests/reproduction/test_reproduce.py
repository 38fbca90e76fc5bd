"""Running experiments: figures against a direct evaluation, what is made again and what is not, and what is said."""

import functools
import json
import shutil

import numpy as np
import pytest

from homolog import Matcher, MatcherSettings
from homolog.core.errors import ArgumentError, DataError
from homolog.datasets import ShapeFolder
from homolog.evaluation import Protocol, evaluate
from homolog.reproduction import ReproductionSettings, experiments, reproduce, training_runs
from homolog.reproduction import run as running
from homolog.synthesis import MeshSettings
from homolog.training import TrainingState


def cells(output, name="plain"):
    return {
        (cell["row"], cell["column"]): cell
        for cell in (json.loads(file.read_text()) for file in sorted((output / name / "cells").glob("*.json")))
    }


def times(output):
    return {file: file.stat().st_mtime_ns for file in sorted(output.rglob("*.json"))}


@pytest.mark.slow
def test_figures_are_those_of_an_evaluation(data, output, tmp_path):
    """Errors of each pair by a matcher of its own settings, and their means by hand."""
    done = reproduce("plain", data, output, ReproductionSettings(seed=3))
    assert (done.made, done.found) == (4, 0)
    folder = ShapeFolder.open(data / "blobs", tmp_path / "definitions" / "blobs.toml")
    found = cells(output)
    for modality, row, noise in (("mesh", "blobs, mesh", 0.0), ("cloud", "blobs, noisy cloud", 0.01)):
        for column, orient, clutter, settings in (
            ("ours", "auto", "remove", MatcherSettings(method="axiomatic")),
            ("paper", "given", "keep", MatcherSettings(method="axiomatic", refinement=None, alignment=None)),
        ):
            protocol = Protocol(modality=modality, noise=noise, orient=orient, clutter=clutter, seed=3)
            truth = evaluate(Matcher(settings=settings), folder, protocol)
            errors = {pair.pair: 100 * pair.errors for pair in truth.pairs}
            figures = found[row, column]["figures"]
            assert figures["mean"] == pytest.approx(np.mean(list(errors.values())), rel=1e-6)
            different = [each for (source, target), each in errors.items() if source != target]
            assert figures["mean_without_self_pairs"] == pytest.approx(np.mean(different), rel=1e-6)
            assert figures["median"] == pytest.approx(np.median(list(errors.values())), rel=1e-6)
            assert (figures["pairs"], figures["self_pairs"], figures["is_whole"]) == (4, 2, True)
    assert len({cell["figures"]["mean"] for cell in found.values()}) == 4


def test_a_cell_says_how_it_was_made(data, output):
    reproduce("plain", data, output, ReproductionSettings(seed=3, only=("cloud",)))
    cell = cells(output)["blobs, noisy cloud", "paper"]
    assert cell["command"].startswith(f"homolog evaluate {data / 'blobs'} --dataset ")
    assert cell["command"].endswith(
        "--modality cloud --noise 0.01 --clutter keep --orient given --seed 3 --method axiomatic "
        "--no-refinement --no-alignment"
    )
    assert (cell["experiment"], cell["paper"], cell["made_by"], cell["seed"]) == ("plain", None, "no weights", 3)
    for name in ("version", "machine", "date", "device"):
        assert isinstance(cell[name], str)
        assert cell[name]
    assert cell["commit"] is None or len(cell["commit"]) >= 10
    assert cell["seconds"] > 0
    assert len(cell["data"]["sha256"]) == 64


def test_what_is_there_is_not_made_again(data, ready):
    output = ready
    assert cells(output)["blobs, mesh", "ours"]["paper"] == 2.0
    before = times(output)
    done = reproduce("plain", data, output)
    assert (done.made, done.found) == (0, 4)
    assert times(output) == before


@pytest.mark.slow
def test_other_settings_and_other_data_make_other_cells(data, output):
    reproduce("plain", data, output, ReproductionSettings(only=("mesh",)))
    assert reproduce("plain", data, output, ReproductionSettings(only=("mesh",), n_pairs=1)).made == 2
    assert reproduce("plain", data, output, ReproductionSettings(only=("mesh",), seed=1)).made == 2
    truth = data / "blobs" / "corres" / "dog.vts"
    truth.write_text("\n".join(reversed(truth.read_text().split())))
    assert reproduce("plain", data, output, ReproductionSettings(only=("mesh",))).made == 2
    assert len(list((output / "plain" / "cells").iterdir())) == 8


@pytest.mark.slow
def test_a_quick_look_takes_as_many_pairs_as_there_are(data, output):
    reproduce("plain", data, output, ReproductionSettings(only=("mesh",), n_pairs=50))
    figures = cells(output)["blobs, mesh", "ours"]["figures"]
    assert (figures["pairs"], figures["self_pairs"], figures["is_whole"]) == (2, 0, False)
    assert "(2 pairs)" in (output / "report.md").read_text()
    reproduce("plain", data, output, ReproductionSettings(only=("mesh",)))
    line = next(line for line in (output / "report.md").read_text().splitlines() if line.startswith("| blobs, mesh |"))
    assert "pairs" not in line  # all of them say more than some
    assert "/" in line


DAMAGES = {
    "is damaged": lambda text: text[: len(text) // 2],
    "is damaged (empty)": lambda text: "",
    "cannot be used": lambda text: text.replace('"seconds"', '"second"', 1),
    "is another cell's": lambda text: text.replace('"key": "', '"key": "0', 1),
}


def test_a_damaged_cell_is_made_again(data, ready, caplog):
    output, only = ready, ReproductionSettings(only=("mesh",))
    file = next((output / "plain" / "cells").glob("*mesh*--paper--*.json"))
    whole = json.loads(file.read_text())
    for said, damage in DAMAGES.items():
        caplog.clear()
        file.write_text(damage(file.read_text()))
        done = reproduce("plain", data, output, only)
        assert (done.made, done.found) == (1, 1)
        assert f"{file} {said.partition(' (')[0]}" in caplog.text
        assert "it is made again" in caplog.text
        assert json.loads(file.read_text())["figures"] == whole["figures"]


def test_a_damaged_cell_is_left_out_of_the_table(data, output, caplog):
    reproduce("plain", data, output, ReproductionSettings(only=("mesh",)))
    next((output / "plain" / "cells").glob("*mesh*--paper--*.json")).write_text("{}")
    reproduce("plain", data, output, ReproductionSettings(only=("cloud",)))
    assert "it is left out of the table" in caplog.text
    line = next(line for line in (output / "report.md").read_text().splitlines() if line.startswith("| blobs, mesh |"))
    assert line.split(" | ")[2] == ""


def test_what_is_missing_is_named_and_empty(data, ready):
    output = ready
    done = reproduce("plain", data, output)
    assert done.empty == {
        ("gone, mesh", column): f"{data} has no folder gone or lost; ask for it" for column in ("paper", "ours")
    }
    table = (output / "plain" / "table.md").read_text()
    assert "| gone, mesh | 3.1 |  |  |\n" in table
    assert table in (output / "report.md").read_text()


def test_a_fault_of_one_dataset_leaves_the_others(data, ready):
    shutil.copytree(data / "blobs", data / "lost")
    (data / "lost" / "corres" / "cat.vts").unlink()
    done = reproduce("plain", data, ready)
    assert done.found == 4
    assert "1 of 4 shapes have no ground truth" in done.empty["gone, mesh", "ours"]


def test_nothing_at_all_is_a_mistake(data, output):
    with pytest.raises(DataError, match=r"no cell of plain can be made: .* has no folder gone or lost; ask for it"):
        reproduce("plain", data, output, ReproductionSettings(only=("gone",)))
    assert not output.exists()
    with pytest.raises(DataError, match="there is no such folder; give one that holds blobs, gone"):
        reproduce("plain", data / "nowhere", output)
    with pytest.raises(DataError, match="the training small is not there; use --train, or give --weights FILE"):
        reproduce("learned", data, output)


def test_mistakes(data, output, tmp_path):
    with pytest.raises(ArgumentError, match=r"the experiment is 'plane'.*did you mean 'plain'"):
        reproduce("plane", data, output)
    with pytest.raises(ArgumentError, match="weights is 'people', but train is given, too"):
        ReproductionSettings(weights="people", train=True)
    with pytest.raises(ArgumentError, match="weights is 'people', but changes is given, too"):
        ReproductionSettings(weights="people", changes={"training.steps": 1})
    with pytest.raises(Exception, match="there are no weights 'nobody'"):
        ReproductionSettings(weights="nobody")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    with pytest.raises(ArgumentError, match="holds other things"):
        reproduce("plain", data, tmp_path / "mine")
    assert [file.name for file in (tmp_path / "mine").iterdir()] == ["letter.txt"]


def test_an_interrupt_leaves_whole_cells(data, output, monkeypatch):
    calls = []

    def interrupted(*given, **named):
        calls.append(given)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return evaluate(*given, **named)

    monkeypatch.setattr(running, "evaluate", interrupted)
    with pytest.raises(KeyboardInterrupt):
        reproduce("plain", data, output)
    assert set(cells(output)) == {("blobs, mesh", "paper"), ("blobs, mesh", "ours")}
    assert "| blobs, noisy cloud |  |  |  |" in (output / "report.md").read_text()
    assert not list(output.rglob(".homolog-*"))
    done = reproduce("plain", data, output)
    assert (done.made, done.found) == (2, 2)


def test_progress_is_one_count_of_pairs(data, output):
    told = []
    reproduce("plain", data, output, progress=lambda *given: told.append(given))
    assert {total for _, total, _ in told} == {16}
    assert [done for done, _, _ in told] == sorted(done for done, _, _ in told)
    assert told[0][2].startswith("blobs, mesh, the paper's setting: ")


def test_cells_that_are_there_are_no_work(data, output):
    """Twelve of 16 pairs are left when the first of four cells is there; how fast they go tells the time left."""
    reproduce("plain", data, output)
    cell = next((output / "plain" / "cells").glob("blobs-noisy-cloud--ours--*.json"))
    for file in (output / "plain" / "cells").glob("*.json"):
        if file != cell:
            file.unlink()
    told = []
    done = reproduce("plain", data, output, progress=lambda *given: told.append(given))
    assert (done.made, done.found) == (3, 1)
    assert {total for _, total, _ in told} == {12}
    assert told[0][0] == 0


@pytest.mark.slow
def test_cells_of_weights_that_are_trained_are_no_work(data, output):
    settings = ReproductionSettings(train=True, only=("all losses",))
    reproduce("learned", data, output, settings)
    for file in (output / "learned" / "cells").glob("*--paper--*.json"):
        file.unlink()
    told = []
    reproduce("learned", data, output, settings, progress=lambda *given: told.append(given))
    assert {total for _, total, _ in told} == {4}


def test_only_some_shapes_are_tested(data, output):
    reproduce("parts_of_it", data, output)
    listed = output / "parts_of_it" / "blobs-d-g-pairs.txt"
    assert listed.read_text() == "cat,dog\ndog,dog\n"
    cell = cells(output, "parts_of_it")["to dogs", "ours"]
    assert cell["figures"]["pairs"] == 2
    assert f"--pairs {listed}" in cell["command"]


@pytest.mark.slow
def test_weights_take_the_place_of_trainings(data, output):
    told = []
    settings = ReproductionSettings(weights="people")
    done = reproduce("learned", data, output, settings, progress=lambda *given: told.append(given))
    assert done.made == 2
    assert {total for _, total, _ in told} == {8}  # pairs of rows that stay empty are none that are left
    assert done.empty["without contrast", "ours"] == (
        "it is about the training small_no_contrast, which other weights cannot replace"
    )
    cell = cells(output, "learned")["all losses", "ours"]
    assert (cell["made_by"], cell["weights"][0]["name"], cell["training"]) == ("people", "people", None)
    assert cell["command"].endswith("--weights people")


@pytest.mark.slow
def test_trainings_are_shared_and_done_once(data, output, monkeypatch):
    runs = []

    def counted(*given, **named):
        runs.append(given[2].name)
        return training_runs_train(*given, **named)

    training_runs_train = training_runs.train
    monkeypatch.setattr(training_runs, "train", counted)
    settings = ReproductionSettings(train=True)
    assert reproduce("learned", data, output, settings).made == 4
    assert reproduce("shared", data, output, settings).made == 4
    assert [name.rpartition("-")[0] for name in runs] == ["small", "small_no_contrast"]
    assert reproduce("learned", data, output).found == 4  # what was trained once is there without --train, too
    cell = cells(output, "learned")["without contrast", "ours"]
    assert (cell["made_by"], cell["training"]["steps"]) == ("trained", 3)
    assert "--set loss.infonce=0.0 --dataset" in cell["training"]["command"]
    report = (output / "report.md").read_text()
    assert "(3 steps), then `homolog evaluate" in report
    for picture in ("learned/pck-ours-trained.png", "shared/noise.png"):
        assert (output / picture).stat().st_size > 1000
    assert len(list((output / "learned" / "pictures").glob("*.png"))) == 4


@pytest.mark.slow
def test_a_changed_recipe_is_another_training(data, output):
    only = {"train": True, "only": ("all losses",)}
    reproduce("learned", data, output, ReproductionSettings(**only))
    reproduce("learned", data, output, ReproductionSettings(**only, changes={"training.steps": 2}))
    assert len(list((output / "runs").iterdir())) == 2
    heads = next(line for line in (output / "report.md").read_text().splitlines() if line.startswith("|  | the paper"))
    assert "ours, trained (training.steps=2)" in heads
    assert "ours, trained |" in heads
    with pytest.raises(ArgumentError, match="did you mean 'steps'"):
        reproduce("learned", data, output, ReproductionSettings(**only, changes={"training.stepps": 2}))


@pytest.mark.slow
def test_changed_weights_are_not_taken_for_those_that_were_trained(data, output, monkeypatch):
    settings = ReproductionSettings(train=True, only=("all losses",))
    reproduce("learned", data, output, settings)
    run = next((output / "runs").iterdir())
    (run / "trained.json").write_text("{}")
    steps = []

    def counted(*given, **named):
        state: TrainingState = training_runs_train(*given, **named)
        steps.append(state.step)
        return state

    training_runs_train = training_runs.train
    monkeypatch.setattr(training_runs, "train", counted)
    assert reproduce("learned", data, output, settings).found == 2  # the checkpoint was the last one already
    assert steps == [3]


@pytest.mark.slow
def test_shapes_of_two_datasets_are_trained_on_together(data, output):
    reproduce("together", data, output, ReproductionSettings(train=True))
    gathered = next((output / "shapes").iterdir())
    assert sorted(file.name for file in (gathered / "off").iterdir()) == [
        "blobs_ape.off",
        "blobs_bee.off",
        "more_ape.off",
        "more_bee.off",
    ]
    for name in ("blobs", "more"):
        same = (data / name / "off" / "ape.off").read_bytes()
        assert (gathered / "off" / f"{name}_ape.off").read_bytes() == same
    report = json.loads((next((output / "runs").iterdir()) / "report.json").read_text())
    assert report["shapes"] == 4


def test_some_shapes_of_one_dataset_keep_their_ground_truth(data, output):
    reproduce("taught", data, output, ReproductionSettings(train=True))
    gathered = next((output / "shapes").iterdir())
    assert (gathered / "train.txt").read_text() == "blobs_ape\nblobs_bee\n"
    for name in ("ape", "bee"):
        same = (data / "blobs" / "corres" / f"{name}.vts").read_bytes()
        assert (gathered / "corres" / f"blobs_{name}.vts").read_bytes() == same
    report = json.loads((next((output / "runs").iterdir()) / "report.json").read_text())
    assert report["shapes"] == 2
    assert report["validations"][0]["validation/supervised"] > 0


def test_too_few_shapes_are_not_taken_for_enough(data, output):
    (data / "blobs" / "off" / "ape.off").unlink()
    with pytest.raises(DataError, match="blobs has 1 shapes to train on, but small_supervised takes 2; add some"):
        reproduce("taught", data, output, ReproductionSettings(train=True))


def test_the_output_may_lie_in_the_data(data):
    """As with --data . and the usual folder for results."""
    assert reproduce("plain", data, data / "reproduced", ReproductionSettings(only=("mesh",))).made == 2
    assert reproduce("plain", data, data / "reproduced", ReproductionSettings(only=("mesh",))).found == 2


def test_pictures_are_left_out_without_their_packages(data, output, monkeypatch, caplog):
    import sys

    from homolog.reproduction import pictures

    pictures._say_once.cache_clear()
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setitem(sys.modules, "PIL", None)
    assert reproduce("plain", data, output, ReproductionSettings(only=("mesh",))).made == 2
    assert caplog.text.count("there will be no pictures") == 2
    assert experiments.experiment_names()


def test_columns_of_baselines(data, output):
    """Weights of their own, trained with other losses; a method without weights; nothing by weights that are given."""
    done = reproduce("compared", data, output, ReproductionSettings(train=True))
    assert (done.made, done.empty) == (3, {})
    found = {column: cell for (_, column), cell in cells(output, "compared").items()}
    assert "loss.infonce=0.0" in found["dpfm"]["training"]["command"]
    assert "loss.infonce" not in found["ours"]["training"]["command"]
    assert found["dpfm"]["weights"] != found["ours"]["weights"]
    assert (found["axiomatic"]["training"], found["axiomatic"]["made_by"]) == (None, "no weights")
    assert found["axiomatic"]["command"].endswith("--method axiomatic")
    table = (output / "compared" / "table.md").read_text()
    assert "\nWeights: trained.\n\n|  | ours | axiomatic | losses of unsupervised DPFM |\n" in table
    assert sorted(folder.name.rpartition("-")[0] for folder in (output / "runs").iterdir()) == ["small", "small_dpfm"]
    weights = str(next((output / "runs").glob("small-*")) / "weights.safetensors")
    done = reproduce("compared", data, output, ReproductionSettings(weights=weights))
    assert (done.made, done.found) == (0, 2)  # weights are told by their contents
    assert list(done.empty) == [("blobs, mesh", "dpfm")]


@pytest.mark.slow
def test_other_meshings_are_made_where_they_are_not_there(data, output, monkeypatch):
    coarse = functools.partial(running.write_meshings, settings=MeshSettings(500, 2.0))
    monkeypatch.setattr(running, "write_meshings", coarse)
    done = reproduce("meshed", data, output)
    assert (done.made, done.empty) == (2, {})
    folder = ShapeFolder.open(output / "shapes" / "blobs_anew")
    assert folder.names == ("cat", "dog")
    assert folder.shape("cat").n_points == pytest.approx(500, rel=0.1)
    before = times(output / "shapes")
    assert reproduce("meshed", data, output).found == 2
    assert times(output / "shapes").keys() == before.keys()
    (data / "blobs").rename(data / "elsewhere")
    with pytest.raises(DataError, match="has no folder blobs"):
        reproduce("meshed", data, output)
