"""``homolog synth hands`` and ``homolog synth heads``: options reach the making of them."""

import pytest

from homolog import synthesis
from homolog.synthesis import BodyFolder


@pytest.mark.parametrize(
    ("kind", "more", "sides"), [("hands", ["--sides", "left"], "left"), ("hands", [], "both"), ("heads", [], None)]
)
def test_options_are_passed_on(homolog, monkeypatch, tmp_path, kind, more, sides):
    calls = []

    def synthesize(output, n, settings, *, processes, progress, sides=None):
        calls.append((output, n, settings, processes, sides))
        return BodyFolder(output, kind[:-1])

    monkeypatch.setattr(synthesis, f"synthesize_{kind}", synthesize)
    ended = homolog(
        *("synth", kind, "-n", 7, "--seed", 5, "-o", tmp_path / "set", "--vertices", 3000),
        *("--stretch", 2.5, "--processes", 3, *more),
    )
    assert (ended.code, ended.out.strip(), ended.err) == (0, str(tmp_path / "set"), "")
    ((out, n, settings, processes, found),) = calls
    assert (out, n, processes, found) == (tmp_path / "set", 7, 3, sides)
    assert (settings.seed, settings.mesh.vertices, settings.mesh.stretch) == (5, 3000, 2.5)


@pytest.mark.parametrize("kind", ["hands", "heads"])
@pytest.mark.parametrize("wrong", [["-n", 0], ["-n", 1, "--stretch", 9], ["-n", 1, "--vertices", 3]])
def test_wrong_options(homolog, tmp_path, kind, wrong):
    assert homolog("synth", kind, "-o", tmp_path / "set", *wrong).is_one_line_of_complaint()
    assert not (tmp_path / "set").exists()


def test_a_side_that_there_is_not(homolog, tmp_path):
    assert homolog("synth", "hands", "-n", 1, "--sides", "upper", "-o", tmp_path / "set").is_one_line_of_complaint()


@pytest.mark.parametrize("kind", ["hands", "heads"])
def test_help_shows_examples(homolog, kind):
    ended = homolog("synth", kind, "--help")
    assert ended.code == 0
    assert f"homolog synth {kind} -n 400 -o {kind}" in ended.out
    assert kind in homolog("synth", "--help").out
