"""``homolog synth animals``: options reach the making of animals, which needs no extra."""

import json

import pytest

from homolog import synthesis
from homolog.datasets import ShapeFolder
from homolog.synthesis import BodyFolder


def test_options_are_passed_on(homolog, monkeypatch, tmp_path):
    calls = []

    def synthesize(output, n, settings, *, processes, progress):
        calls.append((output, n, settings, processes))
        return BodyFolder(output, "animal")

    monkeypatch.setattr(synthesis, "synthesize_animals", synthesize)
    ended = homolog(
        *("synth", "animals", "-n", 7, "--seed", 5, "-o", tmp_path / "set"),
        *("--vertices", 3000, "--stretch", 2.5, "--processes", 3),
    )
    assert (ended.code, ended.out.strip(), ended.err) == (0, str(tmp_path / "set"), "")
    ((out, n, settings, processes),) = calls
    assert (out, n, processes) == (tmp_path / "set", 7, 3)
    assert (settings.seed, settings.mesh.vertices, settings.mesh.stretch) == (5, 3000, 2.5)


@pytest.mark.slow
def test_two_animals_are_made_and_evaluated(homolog, tmp_path):
    made = homolog("synth", "animals", "-n", 2, "--vertices", 800, "-o", tmp_path / "set", "--processes", 1, "-q")
    assert (made.code, made.out) == (0, "")
    assert ShapeFolder.open(tmp_path / "set").names == ("animal_00000", "animal_00001")
    scored = homolog(
        *("evaluate", tmp_path / "set", "--method", "axiomatic", "--split", "all", "--n-pairs", 1, "--json", "-"),
    )
    assert scored.code == 0, scored.err


@pytest.mark.parametrize("wrong", [["-n", 0], ["-n", 1, "--stretch", 9], ["-n", 1, "--vertices", 3]])
def test_wrong_options(homolog, tmp_path, wrong):
    assert homolog("synth", "animals", "-o", tmp_path / "set", *wrong).is_one_line_of_complaint()
    assert not (tmp_path / "set").exists()


def test_folders_of_other_seeds_and_of_people_are_left_alone(homolog, tmp_path):
    few = ("-n", 1, "--vertices", 500, "-o", tmp_path / "set", "--processes", 1, "-q")
    assert homolog("synth", "animals", *few).code == 0
    other = homolog("synth", "animals", *few, "--seed", 9)
    assert other.is_one_line_of_complaint()
    assert "seed 0, not 9" in other.err
    manifest = tmp_path / "set" / "manifest.json"
    made = json.loads(manifest.read_text())
    # As in the folders that homolog synth people makes.
    made["making"] = {**made["making"], "anny": "0.6.2"}
    del made["making"]["kind"]
    manifest.write_text(json.dumps(made))
    people = homolog("synth", "animals", *few)
    assert people.is_one_line_of_complaint()
    assert "kind None, not animals" in people.err


def test_help_shows_examples(homolog):
    ended = homolog("synth", "animals", "--help")
    assert ended.code == 0
    assert "homolog synth animals -n 400" in ended.out
    assert "animals" in homolog("synth", "--help").out
