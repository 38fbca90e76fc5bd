"""``homolog synth bones`` and ``homolog synth organs``: options reach the making of them."""

import pytest

from homolog import synthesis
from homolog.synthesis import BodyFolder


@pytest.mark.parametrize(
    ("kind", "more", "passed"),
    [
        ("bones", ["--bone", "hip", "--turn", "none"], {"bone": "hip", "turn": "none"}),
        ("bones", [], {"bone": "femur", "turn": "any"}),
        ("organs", ["--strength", 0.5], {"strength": 0.5, "turn": "any"}),
    ],
)
def test_options_are_passed_on(homolog, monkeypatch, tmp_path, body_file, kind, more, passed):
    calls = []

    def synthesize(*where, processes, progress, **how):
        calls.append((where, how, processes))
        return BodyFolder(tmp_path / "set", kind[:-1])

    monkeypatch.setattr(synthesis, f"synthesize_{kind}", synthesize)
    start = ["--from", body_file] if kind == "organs" else []
    ended = homolog(
        *("synth", kind, *start, "-n", 7, "--seed", 5, "-o", tmp_path / "set", "--vertices", 3000),
        *("--processes", 3, *more),
    )
    assert (ended.code, ended.out.strip(), ended.err) == (0, str(tmp_path / "set"), "")
    ((where, how, processes),) = calls
    assert where[:-1] == (*start[1:], tmp_path / "set", 7)
    assert (where[-1].seed, where[-1].mesh.vertices) == (5, 3000)
    assert (how, processes) == (passed, 3)


@pytest.fixture
def body_file(tmp_path, make):
    """A file with a closed mesh."""
    from homolog.shapes import write_shape

    write_shape(tmp_path / "organ.ply", make.blob(2))
    return tmp_path / "organ.ply"


@pytest.mark.parametrize(
    "wrong",
    [
        ("bones", "--bone", "skull"),
        ("bones", "--turn", "round"),
        ("organs", "-n", 1),
        ("organs", "--from", "nothing.ply"),
        ("organs", "--from", __file__),
    ],
)
def test_wrong_options(homolog, tmp_path, wrong):
    assert homolog("synth", *wrong, "-o", tmp_path / "set").is_one_line_of_complaint()
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize(
    ("kind", "example"), [("bones", "--bone femur -n 100 -o femurs"), ("organs", "--from liver.ply -n 100 -o livers")]
)
def test_help_shows_examples(homolog, kind, example):
    assert f"homolog synth {kind} {example}" in homolog("synth", kind, "--help").out
    assert kind in homolog("synth", "--help").out
