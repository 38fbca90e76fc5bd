"""Many tasks in one process or several, and what failures, interrupts and kills do to these."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import psutil
import pytest

from homolog.core.errors import ArgumentError
from homolog.core.tasks import run_tasks

not_on_windows = pytest.mark.skipif(sys.platform == "win32", reason="Windows has other signals")


def squares(numbers):
    return [(str(number), partial(pow, number, 2)) for number in numbers]


def place_of(number, folder):
    """Says that a task has begun, and gives where."""
    Path(folder, f"begun {number}").touch()
    return os.getpid()


def fail(folder):
    place_of("failing", folder)
    raise ValueError("no")


def last_words():
    os._exit(3)


def run(phases, processes):
    """What the tasks gave, and what was said of progress."""
    given, said = [], []
    run_tasks(phases, processes=processes, progress=lambda *told: said.append(told), told=given.append)
    return given, said


@pytest.mark.parametrize("processes", [1, 2])
def test_results_come_in_the_order_of_the_tasks(processes):
    given, said = run([squares([3, 1, 2]), squares([5])], processes)
    assert given == [9, 1, 4, 25]
    assert said == [(0, 4, "3"), (1, 4, "1"), (2, 4, "2"), (3, 4, "5"), (4, 4, "done")]


@pytest.mark.parametrize("processes", [1, 2])
def test_a_phase_ends_before_the_next_begins(processes, tmp_path):
    begin = [(str(number), partial(place_of, number, tmp_path)) for number in range(3)]
    count = [("count", partial(len, Listed(tmp_path)))] * 2
    assert run([begin, count], processes)[0][3:] == [3, 3]


class Listed:
    """As long as a folder has files, at the time that one asks."""

    def __init__(self, folder):
        self.folder = folder

    def __len__(self):
        return len(list(self.folder.iterdir()))


def test_one_process_is_this_one(tmp_path):
    before = multiprocessing.active_children()
    assert run([[("here", partial(place_of, 0, tmp_path))]], 1)[0] == [os.getpid()]
    assert multiprocessing.active_children() == before


def test_several_processes_are_others(tmp_path):
    given, _ = run([[(str(number), partial(place_of, number, tmp_path)) for number in range(4)]], 2)
    assert os.getpid() not in given and len(set(given)) <= 2


@pytest.mark.parametrize("processes", [1, 2])
def test_after_a_failure_no_further_task_begins(processes, tmp_path):
    tasks = [("failing", partial(fail, tmp_path))]
    tasks += [(str(number), partial(place_of, number, tmp_path)) for number in range(400)]
    with pytest.raises(ValueError, match="no"):
        run([tasks], processes)
    assert len(list(tmp_path.iterdir())) < 200
    assert run([squares([2])], processes)[0] == [4]  # and others can be done after it


def test_a_process_that_is_ended_from_outside_is_one_line():
    with pytest.raises(ArgumentError, match=r"a process was ended from outside.*fewer --processes"):
        run([[("dying", last_words)] * 3], 2)
    assert run([squares([2, 3])], 2)[0] == [4, 9]


@pytest.mark.process
def test_cores_are_shared_unless_the_user_has_chosen(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(  # which several processes do not run again
        "import os\n"
        "from functools import partial\n"
        "from homolog.core.tasks import run_tasks\n"
        "asked = partial(os.getenv, 'OMP_NUM_THREADS')\n"
        "run_tasks([[('a', asked), ('b', asked)]], processes=2, progress=lambda *_: None, told=print)\n"
    )
    share = str(max(1, len(psutil.Process().cpu_affinity()) // 2)) if sys.platform == "linux" else None
    for chosen, expected in ((None, share), ("7", "7")):
        environment = {name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"}
        environment |= {} if chosen is None else {"OMP_NUM_THREADS": chosen}
        ended = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120, env=environment)
        assert ended.stderr == "" and (expected is None or ended.stdout == f"{expected}\n{expected}\n")


# Python runs it as it begins. Here each worker is interrupted before it has loaded anything, as by a terminal.
INTERRUPTED_LOADING = """
import os
import signal
import sys

if any("LokyProcess" in word for word in sys.orig_argv):
    os.kill(os.getpid(), signal.SIGINT)
"""
SQUARES = """
import signal
from functools import partial
from homolog.core.tasks import run_tasks

tasks = [(str(number), partial(pow, number, 2)) for number in range(4)]
run_tasks([tasks], processes=2, progress=lambda *_: None, told=print)
print(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))
"""


@pytest.mark.process
@not_on_windows
def test_workers_that_begin_hear_no_interrupt_and_the_command_does(tmp_path):
    (tmp_path / "sitecustomize.py").write_text(INTERRUPTED_LOADING)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    ended = subprocess.run(
        [sys.executable, "-c", SQUARES], capture_output=True, text=True, timeout=300, env=environment
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "0\n1\n4\n9\nFalse\n", "")


# The command's own way to end, around tasks that write files for ever.
STUCK = """
import sys
import time
from functools import partial
from pathlib import Path
from homolog.cli import main as command
from homolog.core.files import atomic_path
from homolog.core.tasks import run_tasks

folder = Path(sys.argv[1])


def write(number):
    with atomic_path(folder / f"file {number}") as temporary:
        temporary.write_text("half")
        (folder / f"begun {number}").touch()
        while True:
            time.sleep(0.01)


def app(**_):
    tasks = [(str(number), partial(write, number)) for number in range(40)]
    run_tasks([tasks], processes=2, progress=lambda *_: None)


if __name__ == "__main__":
    import homolog.cli.app
    homolog.cli.app.app = app
    command.main()
"""


def wait_for(condition):
    """Until it holds, for at most a minute."""
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def begun(folder):
    return sorted(path.name for path in folder.glob("begun *"))


@pytest.fixture
def stuck(tmp_path):
    """A command in a session of its own, once two of its tasks have begun, its workers, and where they write."""
    script, folder = tmp_path / "script.py", tmp_path / "out"
    script.write_text(STUCK)
    folder.mkdir()
    process = subprocess.Popen(
        [sys.executable, script, folder],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        wait_for(lambda: len(begun(folder)) == 2)
        workers = psutil.Process(process.pid).children(recursive=True)
        assert len(workers) >= 2
        yield process, workers, folder
    finally:
        process.kill()
        process.communicate()


@not_on_windows
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("whole_group", [True, False], ids=["as from a terminal", "to the command alone"])
def test_signals_end_all_at_once_and_leave_nothing(stuck, number, whole_group):
    process, workers, folder = stuck
    (os.killpg if whole_group else os.kill)(process.pid, number)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (128 + number, "")
    assert err == "Interrupted; nothing was left half-written.\n"
    assert psutil.wait_procs(workers, timeout=60)[1] == []
    assert sorted(path.name for path in folder.iterdir()) == begun(folder)  # nor temporary files
    assert len(begun(folder)) == 2  # no queued task was waited for


@not_on_windows
def test_workers_end_with_a_command_that_is_killed(stuck):
    process, workers, _ = stuck
    process.kill()
    process.communicate(timeout=60)
    assert psutil.wait_procs(workers, timeout=60)[1] == []
