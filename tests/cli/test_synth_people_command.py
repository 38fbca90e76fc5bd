"""``homolog synth people``: options reach the making of people, and its errors are one line."""

import sys

import pytest

from homolog import synthesis
from homolog.synthesis import BodyFolder


@pytest.fixture
def asked(monkeypatch):
    """What the command asks for, instead of its being done."""
    calls = []

    def synthesize(output, n, settings, *, poses, processes, progress):
        calls.append((output, n, settings, poses, processes))
        return BodyFolder(output, "person")

    monkeypatch.setattr(synthesis, "synthesize_people", synthesize)
    return calls


def test_options_are_passed_on(homolog, asked, tmp_path):
    ended = homolog(
        *("synth", "people", "-n", 7, "--seed", 5, "-o", tmp_path / "set"),
        *("--vertices", 3000, "--stretch", 2.5, "--processes", 3, "--poses", "wide"),
    )
    assert (ended.code, ended.out.strip(), ended.err) == (0, str(tmp_path / "set"), "")
    ((out, n, settings, poses, processes),) = asked
    assert (out, n, poses, processes) == (tmp_path / "set", 7, "wide", 3)
    assert (settings.seed, settings.mesh.vertices, settings.mesh.stretch) == (5, 3000, 2.5)


def test_quiet(homolog, asked, tmp_path):
    assert homolog("synth", "people", "-n", 1, "-o", tmp_path, "-q").out == ""


@pytest.mark.parametrize("wrong", [["-n", 0], ["-n", 1, "--stretch", 9], ["-n", 1, "--vertices", 3]])
def test_wrong_options(homolog, asked, tmp_path, wrong):
    assert homolog("synth", "people", "-o", tmp_path / "set", *wrong).is_one_line_of_complaint()
    assert not asked
    assert not (tmp_path / "set").exists()


def test_without_anny(homolog, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "anny", None)
    ended = homolog("synth", "people", "-n", 1, "-o", tmp_path / "set")
    assert ended.is_one_line_of_complaint()
    assert "pip install 'homolog[synth]'" in ended.err
    assert not (tmp_path / "set").exists()


def test_help_shows_examples(homolog):
    ended = homolog("synth", "people", "--help")
    assert ended.code == 0
    assert "homolog synth people -n 500" in ended.out
    assert homolog("synth", "--help").out.count("people") >= 1
