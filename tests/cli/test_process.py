"""``homolog`` as a process of its own: exit codes, streams, signals."""

import json
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest

from homolog.matching import Match

pytestmark = pytest.mark.process

START = [sys.executable, "-m", "homolog"]
FILES = ("correspondence.npz", "source.ply", "target.ply", "report.json")

# A command that stops amid writing the maps, says so, and waits to be interrupted.
STUCK = """
import sys, time
import numpy as np

def half(file, **arrays):
    file.write(b"half")
    file.flush()
    print("writing", flush=True)
    time.sleep(120)

np.savez_compressed = half
from homolog.cli.main import main
main()
"""

# A command that stops while operators are computed.
STUCK_EARLY = """
import time
from homolog.pairs import Preprocessor

def forever(*args, **kwargs):
    print("working", flush=True)
    while True:
        time.sleep(0.1)

Preprocessor.operators = forever
from homolog.cli.main import main
main()
"""


def run(*arguments):
    command = [*START, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_match_from_files_to_files(files, tmp_path):
    ended = run("match", files.mesh, files.dirty, "-o", tmp_path / "out", "--method", "axiomatic")
    assert ended.returncode == 0, ended.stderr
    paths = [tmp_path / "out" / name for name in FILES]
    assert ended.stdout.splitlines() == list(map(str, paths))
    assert ended.stderr.startswith("Matched by axiomatic")
    with np.load(paths[0]) as stored:
        found = stored["source_to_target"]
        assert np.mean(found == np.arange(162)) > 0.9
        assert stored["target_to_source"][-1] == -1
    report = json.loads(paths[3].read_text())
    assert report["inputs"]["target"]["n_points"] == 165


def test_a_mistake_is_one_line_even_if_libraries_talk(files, tmp_path):
    """PyTorch warns about such a pickle on its own account."""
    (tmp_path / "odd.pth").write_bytes(pickle.dumps({"networks": 1}, protocol=4))
    ended = run("match", files.mesh, files.mesh, "--weights", tmp_path / "odd.pth", "-o", tmp_path / "out")
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert ended.stderr.startswith("Error: ")
    assert ended.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_unknown_command():
    ended = run("mach")
    assert ended.returncode == 2
    assert ended.stderr.startswith("Error: ")
    assert ended.stderr.count("\n") == 1
    assert "must be one of match, view, " in ended.stderr and "did you mean 'match'" in ended.stderr
    assert ended.stdout == ""
    ended = run("synth", "dinosaurs")
    assert ended.returncode == 2 and ended.stderr.count("\n") == 1
    assert "'homolog synth' is 'dinosaurs', but must be one of people, hands, heads, animals" in ended.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other pipes")
def test_a_reader_that_leaves_early_is_no_error(files):
    with subprocess.Popen(
        [*START, "info", *[files.mesh] * 3], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 1


def shown_on_a_terminal(*arguments):
    """What a command writes to a terminal that is its stderr, with control sequences, and to stdout."""
    import pty

    terminal, inside = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "120"}
    command = [*START, *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=inside, env=environment) as process:
        os.close(inside)
        shown = b""
        try:
            while part := os.read(terminal, 4096):
                shown += part
        except OSError:  # what Linux says at the end
            pass
        os.close(terminal)
        out = process.stdout.read().decode()
    return process.returncode, shown.decode(), out


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other terminals")
def test_the_progress_bar_and_the_lines_above_it_do_not_mix(files, tmp_path):
    """Of the warnings there is one, too: of weights that are not used."""
    options = ["--method", "axiomatic", "--weights", files.weights, "--verbose", "-o", tmp_path]
    code, shown, out = shown_on_a_terminal("match", files.mesh, files.other, *options)
    assert code == 0
    assert out.splitlines() == [str(tmp_path / name) for name in FILES]
    assert "━" in shown  # there was a bar
    lines = [
        "Warning: [^\\r\\n]*weights",
        *(f"{step} \\.\\.\\." for step in ("read source", "map", "write")),
    ]
    for line in lines:
        # Each begins on a line that is new, or from which the bar was just wiped, and is ended before the bar's return.
        assert re.search(rf"(^|\n|\x1b\[2K){line}[^━]*?\r?\n", shown), (line, shown)


def interrupted(program, number, arguments):
    """Start a program, wait for it to say that it is in the middle, and signal it."""
    command = [sys.executable, "-c", program, *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            said = process.stdout.readline()
            process.send_signal(number)
            out, err = process.communicate(timeout=120)
        finally:
            process.kill()
    return process.returncode, said + out, err


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(("program", "said"), [(STUCK, "writing\n"), (STUCK_EARLY, "working\n")])
def test_interrupts_leave_nothing_half_written(files, tmp_path, number, program, said):
    out = tmp_path / "out"
    code, shown, complaint = interrupted(program, number, ["match", files.mesh, files.other, "-o", out])
    assert (code, shown) == ({signal.SIGINT: 130, signal.SIGTERM: 143}[number], said)
    assert complaint == "Interrupted; nothing was left half-written.\n"
    assert not out.exists() or list(out.iterdir()) == []


# Ctrl-C while the commands are loaded, in a library that takes whatever is raised for a failure of its own.
INTERRUPTED_LOADING = """
import os
import signal
import sys


class Swallowing:
    def find_spec(self, name, path=None, target=None):
        if name == "homolog.cli.app":
            try:
                os.kill(os.getpid(), signal.SIGINT)
                sum(range(10))
            except BaseException:
                pass


sys.meta_path.insert(0, Swallowing())
sys.argv = ["homolog", "--version"]
from homolog.cli.main import main
main()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other signals")
def test_an_interrupt_while_libraries_are_loaded_ends_it():
    ended = subprocess.run(
        [sys.executable, "-c", INTERRUPTED_LOADING], capture_output=True, text=True, timeout=120, check=False
    )
    assert (ended.returncode, ended.stdout) == (130, "")
    assert ended.stderr == "Interrupted; nothing was left half-written.\n"


# A library that fails in its own way, or ends the process, while an interrupt lets it be put away.
FAILING_END = """
import os, signal, sys, time
from homolog.pairs import Preprocessor

def fail(*args, **kwargs):
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(60)
    finally:
        {end}

Preprocessor.operators = fail
from homolog.cli.main import main
main()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other signals")
@pytest.mark.parametrize("end", ["raise RuntimeError('no connection')", "sys.exit(1)", "1 / 0"])
def test_an_interrupt_stays_one_whatever_fails_after_it(files, tmp_path, end):
    command = [sys.executable, "-c", FAILING_END.format(end=end), "match", files.mesh, files.other]
    ended = subprocess.run(
        [*map(str, command), "-o", str(tmp_path / "out")], capture_output=True, text=True, timeout=120, check=False
    )
    assert (ended.returncode, ended.stdout) == (130, "")
    assert ended.stderr == "Interrupted; nothing was left half-written.\n"
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(sys.platform != "linux", reason="other systems' file names are UTF-8")
@pytest.mark.parametrize(
    ("encoding", "shown"), [("utf-8", b"b\xff\xc3\xa9"), ("ascii", b"b?\xc3\xa9"), ("latin-1", b"b\\udcff\xe9")]
)
def test_names_of_any_bytes_are_read_shown_and_printed(files, tmp_path, encoding, shown):
    """The library of the command line takes ASCII for a mistake, and writes UTF-8."""
    name = tmp_path / (os.fsdecode(b"b\xff\xc3\xa9") + files.mesh.suffix)
    shutil.copy(files.mesh, name)
    command = [*START, "match", name, files.other, "--method", "axiomatic", "--html", name.with_suffix(".html")]
    environment = {**os.environ, "PYTHONIOENCODING": encoding}
    ended = subprocess.run(
        [*command, "-o", tmp_path / "out"], capture_output=True, timeout=300, check=False, env=environment
    )
    assert (ended.returncode, ended.stdout.splitlines()[-1]) == (0, os.fsencode(tmp_path) + b"/" + shown + b".html")
    assert Match.load(tmp_path / "out").source.name == name.name
    page = name.with_suffix(".html").read_text(encoding="utf-8")
    assert "b?" in page


@pytest.mark.skipif(sys.platform == "win32", reason="Windows makes no such links")
def test_a_page_that_is_a_link_to_itself_is_one_line(files, tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    ended = run("match", files.mesh, files.other, "--html", tmp_path / "loop", "-o", tmp_path / "out")
    assert ended.returncode == 2 and ended.stderr.count("\n") == 1
    assert "is a link that leads to itself" in ended.stderr and not (tmp_path / "out").exists()
