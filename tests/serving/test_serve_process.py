"""``homolog serve`` as a process of its own: what it prints, how it ends, what it leaves."""

import os
import re
import signal
import subprocess
import sys
import urllib.request

import pytest
from serving_tools import TRIANGLE, Client, gone, until

pytest.importorskip("uvicorn", reason="uvicorn is missing; pip install 'homolog[serve]'")

from homolog.serving.folder import ServerFolder

pytestmark = pytest.mark.process

# A server one of whose matches has begun, waiting to be ended.
BUSY = """
import sys
import homolog.serving
from homolog.serving import MatchCommand

stuck = "import sys, time; open('pid', 'w').write(str(__import__('os').getpid())); time.sleep(600)"
homolog.serving.MatchCommand = lambda *given, **named: MatchCommand(program=(sys.executable, "-c", stuck))
from homolog.cli.main import main
main()
"""


@pytest.mark.process
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other signals")
@pytest.mark.parametrize(
    ("number", "code", "said"),
    [
        (signal.SIGINT, 0, "Serving until Ctrl-C.\n"),
        (signal.SIGTERM, 143, "Serving until Ctrl-C.\nInterrupted; nothing was left half-written.\n"),
    ],
)
def test_it_prints_its_address_and_leaves_nothing(tmp_path, number, code, said):
    """Not even where a match is under way."""
    command = [sys.executable, "-c", BUSY, "serve", "--port", "0", "--no-open", "--method", "axiomatic"]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        try:
            address = process.stdout.readline().strip()
            assert re.fullmatch(r"http://127\.0\.0\.1:\d+", address)
            with urllib.request.urlopen(address, timeout=60) as answer:
                assert b"<title>Homolog</title>" in answer.read()
            Client(address).match(("a.off", TRIANGLE), ("b.off", TRIANGLE))
            (file,) = until(lambda: list(tmp_path.glob("homolog-serve-*/*/*/pid")))
            pid = int(until(file.read_text))
            process.send_signal(number)
            out, err = process.communicate(timeout=120)
        finally:
            process.kill()
    assert (process.returncode, out, err) == (code, "", said)
    until(lambda: gone([pid]))
    assert list(tmp_path.iterdir()) == []


# A server that is gone before it could clean up.
KILLED = """
import os, signal
from homolog.serving.folder import ServerFolder

folder = ServerFolder()
(folder.path / "shape.off").touch()
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.process
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other signals")
def test_what_a_killed_server_left_goes_with_the_next_start(tmp_path, monkeypatch):
    """And nothing else: neither what a server holds, nor what is called like it, be it a folder, a file or a link."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    subprocess.run([sys.executable, "-c", KILLED], check=False, timeout=120)
    (left,) = tmp_path.glob("homolog-serve-*")
    assert (left / "matches" / "shape.off").is_file()
    with ServerFolder() as held:
        assert not left.exists()
        others = [tmp_path / f"homolog-serve-{name}" for name in ("folder", "file", "link")]
        (tmp_path / "elsewhere").mkdir()
        (tmp_path / "elsewhere" / "removed-if-not-locked").touch()
        others[0].mkdir()
        others[1].touch()
        others[2].symlink_to(tmp_path / "elsewhere")
        with ServerFolder() as second:
            assert held.is_dir() and second.is_dir() and held != second
        assert not second.exists() and all(other.exists() for other in others)
    assert {*tmp_path.iterdir()} == {*others, tmp_path / "elsewhere"}
