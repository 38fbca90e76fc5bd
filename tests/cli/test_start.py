"""What commands load before they do anything: no PyTorch for help, versions, lists and mistakes in arguments."""

import json
import os
import subprocess
import sys

import pytest
from typer.main import get_command

from homolog.cli.app import app

# Runs each command line within one process, and prints how it ended and which of the slow packages are loaded then.
PROGRAM = """
import contextlib, io, json, os, sys
from homolog.cli.main import main

slow = sys.argv[1].split(",")
for line in json.loads(sys.argv[2]):
    sys.argv = ["homolog", *line]
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
    loaded = [name for name in slow if name in sys.modules]
    print(json.dumps({"line": line, "code": code, "loaded": loaded, "out": out.getvalue(), "err": err.getvalue()}))
"""


def ended(slow, lines, environment=None):
    """How each command line ended; what one has loaded is loaded for those after it as well."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, ",".join(slow), json.dumps(lines)],
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, **(environment or {})},
        check=True,
    )
    return [json.loads(line) for line in done.stdout.splitlines()]


def command_names(group, before=()):
    """Each command of a group, and of the groups in it, by the words that call it."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from command_names(command, (*before, name))
        else:
            yield [*before, name]


COMMANDS = list(command_names(get_command(app)))


@pytest.mark.process
def test_the_version_loads_next_to_nothing():
    slow = ["torch", "numpy", "scipy", "trimesh", "rich", "jaxtyping", "safetensors", "homolog.cli.match"]
    (one,) = ended(slow, [["--version"]])
    assert (one["code"], one["loaded"]) == (0, [])


@pytest.mark.process
def test_help_lists_and_mistakes_load_no_torch(tmp_path):
    """All in one process: whatever one of them loads is seen."""
    (tmp_path / "a.off").write_text("OFF\n")
    there = str(tmp_path / "a.off")
    helped = [[], ["--help"], *([*words, "--help"] for words in COMMANDS), ["data"], ["synth", "--help"]]
    done = [["data", "list"], ["data", "show", "faust_r"], ["doctor"], ["reproduce", "--list"]]
    wrong = [
        ["mach"],
        ["match"],
        ["match", there],
        ["match", there, there, "--nothing"],
        ["match", there, there, "--method", "guess"],
        ["match", there, there, "--adapt", "-1"],
        ["match", there, there, "--partial-scale", "much"],
        ["match", there, there, "--weights", "of nobody"],
        ["reproduce", "nothing"],
        ["reproduce", "complete"],
        ["match", there, str(tmp_path / "gone.off")],
        ["match", there, there, "--partial-scale", "0.1"],
        ["match", there, there, "--settings", str(tmp_path / "gone.toml")],
        ["match", there, str(tmp_path)],
        ["evaluate", str(tmp_path), "--up", "w"],
        ["evaluate", str(tmp_path / "gone")],
        ["evaluate", str(tmp_path), "--plot", str(tmp_path / "x.jpg")],
        ["evaluate", str(tmp_path), "--dataset", "none_of_these"],
        ["evaluate", str(tmp_path), "--json", str(tmp_path / "gone" / "x.json")],
        ["collection", str(tmp_path / "gone.ply"), there],
        ["synth", "people", "-n", "none"],
        ["synth", "part", there, "--kind", "half"],
        ["serve", "--port", "-3"],
        ["transfer"],
        ["view"],
        ["train"],
    ]
    found = ended(["torch"], [*helped[1:], *done, *wrong, []], {"HOMOLOG_CACHE": str(tmp_path / "cache")})
    codes = {tuple(one["line"]): one["code"] for one in found}
    assert all(one["loaded"] == [] for one in found), next(one for one in found if one["loaded"])
    assert [line for line in done if codes[tuple(line)] != 0] == []
    assert [line for line in wrong if codes[tuple(line)] != 2] == []
    for one in found:
        if one["line"] in wrong:
            assert (one["out"], one["err"].count("\n")) == ("", 1) and one["err"].startswith("Error: "), one


@pytest.mark.process
def test_lists_load_nothing_that_reads_shapes():
    """A description is a TOML file."""
    (one,) = ended(["torch", "numpy", "scipy", "trimesh", "rich"], [["data", "list"]])
    assert (one["code"], one["loaded"]) == (0, [])
    assert "faust_r\t" in one["out"]


@pytest.mark.process
@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("homolog ma", "match"),
        ("homolog synth pe", "people"),
        ("homolog match --meth", "--method"),
        ("homolog match --method nea", "nearest-features"),
    ],
)
def test_shells_complete(typed, offered):
    words = typed.split(" ")
    told = {"_HOMOLOG_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(len(words) - 1)}
    done = subprocess.run(
        [sys.executable, "-m", "homolog"],
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, **told},
        check=True,
    )
    assert offered in done.stdout.splitlines()
