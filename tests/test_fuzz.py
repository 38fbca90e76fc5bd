"""A thousand damaged files: every reader gives a result or refuses in one line, within its bounds."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

FUZZ = Path(__file__).parents[1] / "tools" / "fuzz.py"


def fuzz(out: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(FUZZ), "--out", str(out), *options]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.skipif(sys.platform != "linux", reason="the memory of a worker is told on Linux")
@pytest.mark.slow
def test_a_thousand_mutants(tmp_path: Path) -> None:
    done = fuzz(tmp_path, "--mutants", "1000", "--seed", "7", "--seconds", "120")
    assert "1000 files in" in done.stdout, done.stdout + done.stderr
    assert done.returncode == 0, done.stdout


@pytest.mark.skipif(sys.platform != "linux", reason="the memory of a worker is told on Linux")
@pytest.mark.reference
@pytest.mark.process
def test_files_that_readers_once_failed_on(tmp_path: Path) -> None:
    """Bombs, headers that promise billions, endless work and damaged results, beside the checkout."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "cases" / "files"
    folder = Path(os.environ.get("HOMOLOG_CASES", beside)).parent / "hostile" / "inputs"
    if not folder.is_dir():
        pytest.skip(f"no files at {folder}; set HOMOLOG_CASES")
    inputs = [str(path) for kind in ("minimal", "fuzz") for path in sorted((folder / kind).iterdir())]
    done = fuzz(tmp_path, "--seconds", "120", "--files", *inputs)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 failures" in done.stdout


@pytest.mark.skipif(sys.platform != "linux", reason="the memory of a worker is told on Linux")
@pytest.mark.process
def test_a_failure_is_printed_and_its_file_kept(tmp_path: Path) -> None:
    """A reader that fails by intent: a crash, a traceback, a hang, much memory, and lines on the screen."""
    broken = tmp_path / "broken.py"
    broken.write_text(
        f"import sys; sys.path.insert(0, {str(FUZZ.parent)!r})\n"
        "import ctypes, os, time, fuzz, numpy as np\n"
        "def read(file):\n"
        "    kind = int(file.read_bytes()[:1])\n"
        "    [lambda: ctypes.string_at(0), lambda: 1 / 0, lambda: time.sleep(600), lambda: np.ones(50_000_000),\n"
        "     lambda: os.write(1, b'noise'), lambda: None][kind]()\n"
        "fuzz.READERS['shape'] = read\n"
        f"options = ['--out', {str(tmp_path / 'out')!r}, '--files', {str(tmp_path / 'in')!r}]\n"
        "sys.exit(fuzz.main(['--seconds', '40', *options]))\n"
    )
    (tmp_path / "in").mkdir()
    for kind in range(6):
        (tmp_path / "in" / f"{kind}.off").write_text(str(kind))
    done = subprocess.run([sys.executable, str(broken)], capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    kept = sorted(path.name for path in (tmp_path / "out" / "failures").iterdir())
    assert kept == ["crash-shape-0", "hang-shape-2", "memory-shape-3", "printed-shape-4", "traceback-shape-1"]
    assert (tmp_path / "out" / "failures" / "hang-shape-2" / "2.off").read_text() == "2"
    assert "5 failures" in done.stdout


@pytest.mark.skipif(sys.platform != "linux", reason="the memory of a worker is told on Linux")
@pytest.mark.process
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_the_campaign(tmp_path: Path, number: int) -> None:
    """A worker that would hang for ten minutes, of a campaign that is ended from outside."""
    (tmp_path / "hangs.py").write_text(
        f"import sys; sys.path.insert(0, {str(FUZZ.parent)!r})\n"
        "import os, time, fuzz\n"
        "def read(file):\n"
        f"    os.close(os.open({str(tmp_path)!r} + f'/{{os.getpid()}}.pid', os.O_CREAT))\n"
        "    time.sleep(600)\n"
        "fuzz.READERS['shape'] = read\n"
        f"fuzz.main(['--seconds', '600', '--out', {str(tmp_path / 'out')!r}, '--files', {str(tmp_path / 'a.off')!r}])\n"
    )
    (tmp_path / "a.off").write_text("OFF")
    (tmp_path / "temporary").mkdir()
    environment = {**os.environ, "TMPDIR": str(tmp_path / "temporary")}
    with subprocess.Popen([sys.executable, str(tmp_path / "hangs.py")], env=environment) as campaign:
        while not (told := list(tmp_path.glob("*.pid"))):
            assert campaign.poll() is None
            time.sleep(0.1)
        worker = psutil.Process(int(told[0].stem))
        campaign.send_signal(number)
    psutil.wait_procs([worker], timeout=60)
    assert not worker.is_running()
    if number == signal.SIGTERM:
        assert not any((tmp_path / "temporary").iterdir())
