"""Paths and files, on their own."""

import csv
import re
import subprocess
import sys
from pathlib import Path

import pytest

from homolog.core.errors import ArgumentError
from homolog.core.files import (
    _remove_abandoned,
    atomic_path,
    expanded,
    keeping,
    refuse_overwriting_inputs,
    remove,
    resolved,
    resuming,
    sha256,
    write_csv,
    write_json,
    written_together,
)


def written(path):
    with atomic_path(path):
        raise AssertionError("never reached")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows knows no ~name")
@pytest.mark.parametrize("use", [expanded, sha256, written])
def test_a_home_folder_that_is_not_there_is_named(use):
    with pytest.raises(ArgumentError, match=r"^~nobody-of-that-name/a\.off: there is no such user's home folder"):
        use("~nobody-of-that-name/a.off")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other permissions")
def test_who_may_read_a_file_is_not_for_the_library_that_writes_it_to_say(tmp_path):
    (tmp_path / "plain").touch()
    usual = (tmp_path / "plain").stat().st_mode
    old = tmp_path / "old"
    old.touch()
    old.chmod(0o640)
    for path, mode in ((tmp_path / "new", usual), (old, old.stat().st_mode)):
        with atomic_path(path) as temporary:
            temporary.write_text("content")
            temporary.chmod(0o600)
        assert path.stat().st_mode == mode
        assert path.read_text() == "content"


def test_no_cell_of_a_table_is_run_by_a_spreadsheet(tmp_path):
    asked = ["=1+1", "+x", "-x", "@x", "\tx", "a=1", "-0.5", "+1e-3", -0.5, 7, None, Path("-a.ply"), Path("a-b.ply")]
    write_csv(tmp_path / "table.csv", [asked])
    with (tmp_path / "table.csv").open(encoding="utf-8", newline="") as file:
        (found,) = csv.reader(file)
    harmless = ["'=1+1", "'+x", "'-x", "'@x", "'\tx", "a=1", "-0.5", "+1e-3", "-0.5", "7", "", "'-a.ply", "a-b.ply"]
    assert found == harmless


@pytest.mark.parametrize("way", ["itself", "relative", "symbolic link", "hard link", "linked folder"])
def test_outputs_are_no_inputs(tmp_path, monkeypatch, way):
    given = tmp_path / "data" / "source.ply"
    given.parent.mkdir()
    given.write_text("precious")
    output = {"itself": given, "relative": Path("data/../data/source.ply")}.get(way, tmp_path / "other")
    monkeypatch.chdir(tmp_path)
    if way == "symbolic link":
        output.symlink_to(given)
    elif way == "hard link":
        output.hardlink_to(given)
    elif way == "linked folder":
        output.symlink_to(given.parent)
        output = output / "source.ply"
    with pytest.raises(ArgumentError, match="is an input and would be replaced"):
        refuse_overwriting_inputs(["new.npz", output], [tmp_path / "absent", given])


def test_outputs_replace_no_file_of_an_input_folder(tmp_path):
    folder = tmp_path / "data"
    (folder / "off").mkdir(parents=True)
    (folder / "off" / "a.off").write_text("precious")
    refuse_overwriting_inputs([folder / "new.npz", tmp_path / "a.off"], [folder])
    (tmp_path / "link").symlink_to(folder / "off")
    for output in (folder / "off" / "a.off", tmp_path / "link" / "a.off"):
        with pytest.raises(ArgumentError, match="lies in the input"):
            refuse_overwriting_inputs([output], [folder])


def test_a_second_name_for_a_file_of_an_input_folder(tmp_path):
    """Its content is an input, wherever the name lies."""
    (tmp_path / "data" / "off").mkdir(parents=True)
    given = tmp_path / "data" / "off" / "a.off"
    given.write_text("precious")
    (tmp_path / "out.json").hardlink_to(given)
    with pytest.raises(ArgumentError, match="lies in the input"):
        refuse_overwriting_inputs([tmp_path / "out.json"], [tmp_path / "data"])


def test_nothing_that_is_kept_is_written_or_removed(tmp_path):
    """By whatever function writes it; what was written since may be written again."""
    (tmp_path / "data").mkdir()
    given, other = tmp_path / "data" / "a.json", tmp_path / "b.json"
    for file in (given, other):
        file.write_text("precious")
    with keeping([tmp_path / "data", other]):
        for file in (given, other):
            for change in (lambda file: write_json(file, {}), remove):
                with pytest.raises(ArgumentError, match="would be replaced"):
                    change(file)
        for _ in range(2):
            write_json(tmp_path / "data" / "new.json", {})
    assert given.read_text() == other.read_text() == "precious"
    remove(given)
    assert not given.exists()


def test_a_folder_that_is_resumed_is_its_own(tmp_path):
    """But the input folder itself is not."""
    run = tmp_path / "data" / "run"
    run.mkdir(parents=True)
    for folder in (run, run.parent):
        write_json(folder / "report.json", {})
    with keeping([tmp_path / "data"]), resuming(run):
        write_json(run / "report.json", {"step": 1})
        with pytest.raises(ArgumentError, match="would be replaced"):
            write_json(run.parent / "report.json", {})
    with keeping([tmp_path / "data"]), resuming(run.parent), pytest.raises(ArgumentError, match="would be replaced"):
        write_json(run.parent / "report.json", {})


# Writes a file and says where it has half of it; then waits.
WRITING = """
import sys, time
from homolog.core.files import (
    _remove_abandoned,
    atomic_path,
    expanded,
    refuse_overwriting_inputs,
    sha256,
    write_csv,
    write_json,
)
with atomic_path(sys.argv[1]) as temporary:
    temporary.write_text("half")
    print(temporary.name, flush=True)
    time.sleep(600)
"""


@pytest.fixture
def half_written(tmp_path):
    """A process that is amid writing a file, and the name of the temporary one."""
    command = [sys.executable, "-c", WRITING, tmp_path / "file.ply"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        yield process, process.stdout.readline().strip()
        process.kill()


@pytest.mark.process
def test_what_a_killed_process_leaves_the_next_one_removes(tmp_path, half_written):
    process, temporary = half_written
    for name in ("kept.ply", ".hidden.ply", ".homolog-notes"):
        (tmp_path / name).write_text("the user's")
    renumbered = re.sub(r"-(\d+)-(\d+)-", lambda found: f"-{found[1]}-{int(found[2]) - 1000}-", temporary)
    elsewhere = temporary.replace(temporary.split("-")[1], "0" * 8)
    for name in (renumbered, elsewhere):
        (tmp_path / name).write_text("half")
    theirs = {"kept.ply", ".hidden.ply", ".homolog-notes", elsewhere}  # of another machine nothing is known

    _remove_abandoned.cache_clear()
    write_json(tmp_path / "new.json", {})
    assert {path.name for path in tmp_path.iterdir()} == theirs | {"new.json", temporary}  # it is still at work

    process.kill()
    process.wait()
    _remove_abandoned.cache_clear()
    write_json(tmp_path / "new.json", {})
    assert {path.name for path in tmp_path.iterdir()} == theirs | {"new.json"}


@pytest.mark.skipif(sys.platform == "win32", reason="Windows makes no such links")
def test_a_link_to_itself_is_named(tmp_path):
    (tmp_path / "loop.ply").symlink_to("loop.ply")
    for use in (resolved, written):
        with pytest.raises(ArgumentError, match=r"loop\.ply is a link that leads to itself"):
            use(tmp_path / "loop.ply")
    assert (tmp_path / "loop.ply").is_symlink()


def test_names_that_are_no_utf_8_keep_their_bytes_in_tables(tmp_path):
    write_csv(tmp_path / "table.csv", [[Path("b\udcff.ply"), "é", 1]])
    assert (tmp_path / "table.csv").read_bytes() == b"b\xff.ply,\xc3\xa9,1\n"


def test_files_that_are_written_together_land_together_in_folders_that_are_made(tmp_path: Path) -> None:
    with written_together(tmp_path / "result", ["report.json", "frames/one.json"]) as paths:
        for path in paths:
            write_json(path, {})
        assert not any(path.exists() for path in paths)
    assert all(path.is_file() for path in paths)


def test_files_that_are_written_together_replace_no_input(tmp_path: Path) -> None:
    (tmp_path / "report.json").write_text("mine")
    inputs = [tmp_path / "report.json"]
    with (
        pytest.raises(ArgumentError, match="is an input"),
        written_together(tmp_path, ["map.npz", "report.json"], inputs),
    ):
        raise AssertionError("nothing is to be done")
    assert [path.name for path in tmp_path.iterdir()] == ["report.json"]
