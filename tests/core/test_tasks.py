"""Many tasks in several processes, and what an interrupt does to these."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.process

# Each process that shares the work is interrupted while it loads the program, as by Ctrl-C in a terminal.
INTERRUPTED = """
import os
import signal
from functools import partial

from homolog.core.tasks import run_tasks

if __name__ != "__main__":
    os.kill(os.getpid(), signal.SIGINT)

if __name__ == "__main__":
    found = []
    tasks = [(str(number), partial(pow, number, 2)) for number in range(4)]
    run_tasks([tasks], processes=2, progress=lambda *told: None, told=found.append)
    print(found, signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other signals")
def test_processes_that_begin_hear_no_interrupt_and_the_first_one_does(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(INTERRUPTED)
    ended = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=300)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "[0, 1, 4, 9] False\n", "")
