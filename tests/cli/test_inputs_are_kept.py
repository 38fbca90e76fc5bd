"""No command replaces what it reads: by the file's identity, whatever the output's name."""

import inspect
import shutil
from pathlib import Path
from typing import get_type_hints

import numpy as np
import pytest
import typer

from homolog import match, write_shape
from homolog.cli.app import app
from homolog.cli.lazy import OUTPUTS
from homolog.core.files import sha256
from homolog.matching import write_folder


def commands(group, words=()):
    """All commands with the words that call them."""
    context = typer.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if hasattr(command, "list_commands"):
            yield from commands(command, (*words, name))
        else:
            yield " ".join((*words, name)), command


READ = {
    *("source", "target", "result", "truth", "origin", "array", "labels", "landmarks", "template", "shapes"),
    *("data", "pairs", "maps", "clouds", "files", "file", "mask", "folder", "shape"),
    *("source_mask", "target_mask", "symmetry", "fragment", "model", "collection", "groups", "frames", "scan"),
    *("listed", "template_mask", "masks", "settings"),
}


def test_every_parameter_is_known_as_read_or_written():
    """A new one that names a file is taken for an input, unless it is one of OUTPUTS."""
    found = set()
    for _, command in commands(typer.main.get_command(app)):
        hints = get_type_hints(inspect.unwrap(command.callback))
        found |= {name for name, hint in hints.items() if "Path" in str(hint)}
    assert found - {"return"} == READ | {*OUTPUTS}


@pytest.fixture(scope="module")
def contents(tmp_path_factory, make):
    """A folder with two shapes, a set, a result, arrays and a recipe."""
    folder = tmp_path_factory.mktemp("contents")
    for name in ("a", "b"):
        write_shape(folder / f"{name}.ply", make.blob(2))
    (folder / "set" / "off").mkdir(parents=True)
    for name in ("a", "b"):
        write_shape(folder / "set" / "off" / f"{name}.off", make.blob(2))
    found = match(folder / "a.ply", folder / "b.ply", method="axiomatic")
    write_folder(folder / "result", found)
    np.save(folder / "values.npy", np.arange(make.blob(2).n_points))
    return folder


@pytest.fixture
def place(tmp_path, contents, monkeypatch):
    """A copy of that folder, to work in."""
    shutil.copytree(contents, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def linked(given, how):
    """Another name for a file."""
    other = Path("other.json")
    if how == "symbolic link":
        other.symlink_to(given)
    elif how == "hard link":
        other.hardlink_to(given)
    else:
        return given
    return other


# Each command, and the files of which none may change.
CALLS = [
    ("match a.ply b.ply --method axiomatic -o new --html {}", "a.ply"),
    ("match a.ply b.ply --method axiomatic -o new --picture {}", "b.ply"),
    ("match result/source.ply b.ply --method axiomatic -o result", "result/source.ply"),
    ("match a.ply result/alternative-2/source.ply --method axiomatic -o result", "result/alternative-2/source.ply"),
    ("view result --html {}", "result/report.json"),
    ("view result --picture {}", "result/target.ply"),
    ("transfer result --array result/values.npy -o result", "result/values.npy"),
    ("transfer result --array values.npy -o .", "values.npy"),
    ("export result --table result/a.csv --distances result/source.ply", "result/source.ply"),
    ("track frames/a.ply b.ply --method axiomatic -o .", "frames/a.ply"),
    ("evaluate set --method axiomatic --json {}", "set/off/a.off"),
    ("evaluate set --method axiomatic --csv {}", "set/off/b.off"),
    ("evaluate set --method axiomatic --plot {}", "set/off/b.off"),
    ("info a.ply b.ply --json {}", "b.ply"),
    ("reconstruct a.ply -o .", "a.ply"),
    ("collection a.ply b.ply --method axiomatic -o .", "b.ply"),
    ("synth part part/part.ply --kind cut -o part", "part/part.ply"),
    ("synth part part/cloud.ply --kind cut -o part", "part/cloud.ply"),
    ("volume surface a.ply -o {}", "a.ply"),
    ("volume slices a.ply -o {}", "a.ply"),
    ("train set -o set/off --resume", "set/off/report.json"),
    ("train set -o new --weights new/weights.safetensors --resume", "new/weights.safetensors"),
    ("synth views set -o set", "set/off/a.off"),
    ("synth meshings set -o set", "set/off/a.off"),
]


@pytest.mark.parametrize("how", ["itself", "symbolic link", "hard link"])
@pytest.mark.parametrize(("call", "kept"), CALLS)
def test_no_command_replaces_what_it_reads(place, homolog, call, kept, how):
    if "{}" not in call and how != "itself":
        pytest.skip("the output has the input's name")
    if not Path(kept).exists():
        Path(kept).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy("values.npy" if kept.endswith(".npy") else "a.ply", kept)
    before = {file: sha256(file) for file in place.rglob("*") if file.is_file()}
    ended = homolog(*call.format(linked(Path(kept), how)).split())
    assert ended.is_one_line_of_complaint(), ended.err
    # Folders of one's own are refused for what else they hold.
    assert "would be replaced" in ended.err or call.startswith(("collection", "synth views", "synth meshings"))
    after = {file: sha256(file) for file in before}
    assert after == before
