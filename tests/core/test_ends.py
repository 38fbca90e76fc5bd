"""Processes that end in time, though Python cannot act: native code is at work for ever, and without Python's lock."""

import signal
import subprocess
import sys

import psutil
import pytest

pytestmark = [
    pytest.mark.process,
    pytest.mark.skipif(sys.platform == "win32", reason="Windows has other signals"),
]

# A program that writes a file and then waits in C for a mutex that it holds itself, which no signal interrupts.
STUCK = """
import ctypes, os, sys
from functools import partial
import homolog.cli.app
from homolog.cli import main as command
from homolog.core.files import atomic_path
from homolog.core.tasks import run_tasks


def stuck(path):
    library, mutex = ctypes.CDLL(None), ctypes.create_string_buffer(256)
    with atomic_path(path) as temporary:
        temporary.write_text("half")
        library.pthread_mutex_lock(mutex)
        os.write(1, b"working\\n")
        library.pthread_mutex_lock(mutex)


def app(**_):
    tasks = [(str(number), partial(stuck, f"{sys.argv[1]}/{number}.ply")) for number in range(2)]
    run_tasks([tasks], processes=int(sys.argv[2]), progress=lambda *_: None)


if __name__ == "__main__":
    command._PATIENCE_SECONDS, homolog.cli.app.app = 3.0, app
    command.main()
"""


@pytest.fixture(params=[1, 2])
def stuck(request, tmp_path):
    """A command of one process or two, all of which are stuck, its workers, and where it writes."""
    script, folder = tmp_path / "script.py", tmp_path / "out"
    script.write_text(STUCK)
    folder.mkdir()
    command = [sys.executable, script, folder, str(request.param)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        for _ in range(request.param):
            assert process.stdout.readline() == "working\n"
        yield process, psutil.Process(process.pid).children(recursive=True), folder
        process.kill()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_native_code_and_leave_nothing(stuck, number):
    process, workers, folder = stuck
    process.send_signal(number)
    _, complaint = process.communicate(timeout=120)
    assert process.returncode == 128 + number
    assert complaint == "Interrupted; nothing was left half-written.\n"
    assert psutil.wait_procs(workers, timeout=120)[1] == []
    assert list(folder.iterdir()) == []


def test_what_was_called_off_ends_nothing():
    """A process may run a command, and then hear signals of its own."""
    program = """
import os, signal, time
from homolog.core.ends import bound_end
descriptors = len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else 0
for _ in range(3):
    bound_end(0.1, os._exit)()
signal.signal(signal.SIGINT, lambda *_: None)
signal.raise_signal(signal.SIGINT)
time.sleep(1)
assert not descriptors or len(os.listdir("/proc/self/fd")) == descriptors
"""
    assert subprocess.run([sys.executable, "-c", program], check=False, timeout=100).returncode == 0


def test_workers_in_native_code_end_with_a_command_that_is_killed(stuck):
    process, workers, folder = stuck
    process.kill()
    process.communicate(timeout=120)
    assert psutil.wait_procs(workers, timeout=120)[1] == []
    assert len(list(folder.iterdir())) == (0 if workers else 1)  # the workers had time to remove theirs
